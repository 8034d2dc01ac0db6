"""The containers' files keep to their schemas, and agree with the project: versions, files, commands, what is open.

The schemas come with two packages of the dev extra: the compose specification with check-jsonschema, Kubernetes' own
with kubernetes-validate. KubeRay's definition is in none; of a RayCluster, all but a few names is a Pod's template.
"""

import re
import shlex
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path

import kubernetes_validate
import pytest
import typer
import yaml

from pipeline.cli import app
from pipeline.configuration import PRESETS

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # Ray's, about pydantic
    from ray.scripts.scripts import cli as ray_cli

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text()
COMPOSE = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())
KUBERNETES = {part["kind"]: part for part in yaml.safe_load_all((ROOT / "docker" / "kuberay.yaml").read_text())}
CONSTRAINTS = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split() if "==" in line)


def instructions(name: str) -> list[str]:
    return re.findall(rf"^{name} (.+)$", DOCKERFILE.replace("\\\n", " "), flags=re.M)


def commands() -> list[list[str]]:
    """Give every command line that a container runs, those of shells taken apart."""
    given = [service["command"] for service in COMPOSE["services"].values() if "command" in service]
    given.append(KUBERNETES["Job"]["spec"]["template"]["spec"]["containers"][0]["command"])
    found = []
    for words in given:
        if words[0] == "sh":
            parts = words[2].replace("$$(cat /run/secrets/postgres_password)", "x").split("&&")
            found += [shlex.split(part.strip().removeprefix("exec ")) for part in parts]
        else:
            found.append(words)
    return found


def test_what_the_image_copies_is_there_and_not_ignored():
    allowed = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = [source.removeprefix("./") for line in instructions("COPY") for source in line.split()[:-1]]
    assert copied
    for source in copied:
        assert (ROOT / source).exists() and source in allowed
    assert allowed == set(copied)


def test_the_image_has_the_versions_that_were_tried_and_no_root():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (base,) = instructions("FROM")
    lowest, highest = re.findall(r"3\.(\d+)", project["requires-python"])
    assert int(lowest) <= int(re.search(r"python:3\.(\d+)", base)[1]) < int(highest)
    installs = [line for line in instructions("RUN") if "pip install" in line]
    assert all("constraints.txt" in line for line in installs)
    assert "TORCH_INDEX" in installs[0] and f"torch=={CONSTRAINTS['torch']}" in project["dependencies"]
    assert {re.match(r"[\w-]+", one)[0] for one in project["optional-dependencies"]["server"]} <= set(CONSTRAINTS)
    assert instructions("USER") == ["puddle"]
    assert KUBERNETES["RayCluster"]["spec"]["rayVersion"] == CONSTRAINTS["ray"]


def test_every_option_of_every_command_exists():
    known = {"ray": ray_cli, "puddle": typer.main.get_command(app)}
    checked = 0
    for program, *words in commands():
        if program not in known:
            assert program == "mlflow"
            continue
        command = known[program].commands[words[0]]
        options = {option for parameter in command.params for option in parameter.opts}
        for word in words[1:]:
            if word.startswith("--"):
                assert word.partition("=")[0] in options, word
                checked += 1
    assert checked > 15


def test_mlflows_options_exist():
    from mlflow.cli import cli

    (words,) = [words for words in commands() if words[0] == "mlflow"]
    options = {option for parameter in cli.commands["server"].params for option in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= options


def test_presets_that_they_name_exist():
    names = re.findall(r"PRESET:-(\w+)", (ROOT / "docker" / "compose.yaml").read_text())
    names += re.findall(r"name: PRESET, value: (\w+)", (ROOT / "docker" / "kuberay.yaml").read_text())
    assert len(names) == 2
    assert all((PRESETS / f"{name}.yaml").exists() for name in names)


def test_compose_keeps_to_the_specification(tmp_path):
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    done = subprocess.run([*check, ROOT / "docker" / "compose.yaml"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    slip = tmp_path / "compose.yaml"
    slip.write_text((ROOT / "docker" / "compose.yaml").read_text().replace("retries: 24", "retrys: 24", 1))
    assert subprocess.run([*check, slip], capture_output=True).returncode == 1


def test_compose_is_closed_and_whole():
    """What a schema can't say."""
    for service in COMPOSE["services"].values():
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", []))
        assert set(service["networks"]) <= set(COMPOSE["networks"])
        assert set(service.get("secrets", ())) <= set(COMPOSE["secrets"])
        assert all(mount.partition(":")[0] in COMPOSE["volumes"] for mount in service.get("volumes", []))
        for needed, condition in service.get("depends_on", {}).items():
            assert condition == {"condition": "service_healthy"} and "healthcheck" in COMPOSE["services"][needed]
        secret = [name for name in service.get("environment", {}) if re.search("TOKEN|PASSWORD", name)]
        assert all(name.endswith(("_PATH", "_FILE")) for name in secret)  # a file's name, never what is in it
    for ray_node in ("head", "worker", "driver"):
        service = COMPOSE["services"][ray_node]
        assert service["environment"]["RAY_AUTH_MODE"] == "token"
        assert service["environment"]["RAY_AUTH_TOKEN_PATH"] == "/run/secrets/ray_token"
        assert "ray_token" in service["secrets"]
    assert COMPOSE["services"]["driver"]["restart"] == "no"


def test_secrets_are_not_kept():
    assert "/docker/secrets/" in (ROOT / ".gitignore").read_text().splitlines()
    for secret in COMPOSE["secrets"].values():
        assert secret["file"].startswith("secrets/")


KUBERNETES_VERSIONS = ("1.29", "1.37")
"""The oldest and the newest that they are checked against."""


@pytest.mark.parametrize("version", KUBERNETES_VERSIONS)
def test_kubernetes_keeps_to_its_schemas(version):
    """Strictly: no field that Kubernetes does not know."""
    cluster = KUBERNETES["RayCluster"]
    groups = [cluster["spec"]["headGroupSpec"], *cluster["spec"]["workerGroupSpecs"]]
    pods = [{"apiVersion": "v1", "kind": "PodTemplate", "template": group["template"]} for group in groups]
    known = [part for kind, part in KUBERNETES.items() if kind != "RayCluster"]
    assert len(pods) == len(known) == 2
    for part in known + pods:
        kubernetes_validate.validate(part, version, strict=True)
    slip = {**pods[0], "template": {"spec": {**pods[0]["template"]["spec"], "hostNetwrok": True}}}
    with pytest.raises(kubernetes_validate.ValidationError, match="hostNetwrok"):
        kubernetes_validate.validate(slip, version, strict=True)


@pytest.mark.parametrize("group", ["head", "worker"])
def test_kuberay_has_what_its_definition_requires(group):
    """ray-operator/apis/ray/v1/raycluster_types.go, its fields without `omitempty`."""
    cluster = KUBERNETES["RayCluster"]
    assert cluster["apiVersion"] == "ray.io/v1" and cluster["metadata"]["name"] == "puddle"
    spec = cluster["spec"]
    assert set(spec) <= {"rayVersion", "headGroupSpec", "workerGroupSpecs"}
    groups = [spec["headGroupSpec"]] if group == "head" else spec["workerGroupSpecs"]
    for one in groups:
        own = {"serviceType"} if group == "head" else {"groupName", "replicas", "minReplicas", "maxReplicas"}
        assert set(one) == {"rayStartParams", "template"} | own
        assert all(isinstance(value, str) for value in one["rayStartParams"].values())  # a map of strings
        options = {option for parameter in ray_cli.commands["start"].params for option in parameter.opts}
        assert {f"--{name}" for name in one["rayStartParams"]} <= options
        secured(one["template"]["spec"])
        if group == "worker":
            assert one["groupName"] and 0 <= one["minReplicas"] <= one["replicas"] <= one["maxReplicas"]


def test_the_driver_is_a_job_on_the_cluster_that_is_defined():
    job = KUBERNETES["Job"]["spec"]["template"]["spec"]
    assert KUBERNETES["Job"]["apiVersion"] == "batch/v1" and job["restartPolicy"] in ("OnFailure", "Never")
    secured(job)
    (driver,) = job["containers"]
    assert "puddle-head-svc:6379" in driver["command"][2]  # KubeRay names the head's service after the cluster
    assert {mount["name"] for mount in driver["volumeMounts"]} == {volume["name"] for volume in job["volumes"]}
    (claim,) = [v["persistentVolumeClaim"]["claimName"] for v in job["volumes"] if "persistentVolumeClaim" in v]
    assert claim == KUBERNETES["PersistentVolumeClaim"]["metadata"]["name"]


def secured(pod: dict) -> None:
    assert pod["securityContext"]["runAsNonRoot"] and pod["automountServiceAccountToken"] is False
    for container in pod["containers"]:
        environment = {one["name"]: one for one in container["env"]}
        assert environment["RAY_AUTH_MODE"]["value"] == "token"
        assert environment["RAY_AUTH_TOKEN"]["valueFrom"]["secretKeyRef"] == {"name": "puddle-token", "key": "token"}
