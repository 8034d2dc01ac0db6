"""The container files conform to their schemas and agree with the project: versions, files, commands, open ports.

The schemas come with two packages of the dev extra: check-jsonschema has the compose specification, kubernetes-validate
those of Kubernetes. Neither has KubeRay's definition, but almost all of a RayCluster is a Pod template.

Tests run the commands of these files without containers: Ray's head, its workers and the driver in
tests/torture/test_two_machines.py, MLflow's server in tests/pipeline/tracking/test_server.py. Tests in this file show
that Kubernetes runs the same commands. ONLY_PARSED lists the exceptions.
"""

import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path

import kubernetes_validate
import pytest
import typer
import yaml
from containers import COMPOSE, DOCKER, KUBERNETES, instructions, words_of
from sqlalchemy import make_url

from pipeline.commands.app import app
from pipeline.commands.exit_codes import INCOMPLETE
from pipeline.config.loading import PRESETS
from pipeline.workflow import dispatcher

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # Ray's, about pydantic
    from ray.scripts.scripts import cli as ray_cli

ROOT = Path(__file__).parents[2]
CONSTRAINTS = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split() if "==" in line)


ONLY_PARSED = {
    ("head", "healthcheck"): "Docker runs it: `ray health-check` is part of Ray, and its options are checked here",
    ("mlflow", "healthcheck"): "Docker runs it: the server's test sends more requests than the health check",
    ("postgres", "healthcheck"): "a program of PostgreSQL, which only its image contains",
    ("postgres", "command"): "the image's own; the server's test uses SQLite instead, and a test here checks that the "
    "image has the PostgreSQL driver that the server's address names",
}
"""Commands that no test runs, by service, each with the reason."""


def commands() -> list[list[str]]:
    """Return every command line that a container runs; those of shells are split."""
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


def test_files_that_the_image_copies_exist_and_are_not_ignored():
    allowed = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = [source.removeprefix("./") for line in instructions("COPY") for source in line.split()[:-1]]
    assert copied
    for source in copied:
        assert (ROOT / source).exists() and source in allowed
    assert allowed == set(copied)


def test_the_image_has_the_tested_versions_and_does_not_run_as_root():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (base,) = instructions("FROM")
    lowest, highest = re.findall(r"3\.(\d+)", project["requires-python"])
    assert int(lowest) <= int(re.search(r"python:3\.(\d+)", base)[1]) < int(highest)
    installs = [line for line in instructions("RUN") if "pip install" in line]
    assert all("constraints.txt" in line for line in installs)
    assert "TORCH_INDEX" in installs[0] and f"torch=={CONSTRAINTS['torch']}" in project["dependencies"]
    assert {re.match(r"[\w-]+", one)[0] for one in project["optional-dependencies"]["server"]} <= set(CONSTRAINTS)
    arguments = {argument.partition("=")[0] for argument in instructions("ARG")}
    assert all(set(s["build"]["args"]) == arguments for s in COMPOSE["services"].values() if "build" in s)
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


RUN_BY = {
    "head": "torture/test_two_machines.py",
    "worker": "torture/test_two_machines.py",
    "driver": "torture/test_two_machines.py",
    "mlflow": "pipeline/tracking/test_server.py",
}


def test_every_command_is_run_by_a_test_or_is_named_with_the_reason():
    for name, service in COMPOSE["services"].items():
        if (name, "command") not in ONLY_PARSED:
            text = (ROOT / "tests" / RUN_BY[name]).read_text()
            assert f'words_of("{name}"' in text or f'["{name}"]' in text  # read from the file, not repeated
        assert ("healthcheck" in service) == ((name, "healthcheck") in ONLY_PARSED)
    for name, kind in ONLY_PARSED:
        assert kind == "healthcheck" or kind not in COMPOSE["services"][name]


def test_health_checks_parse():
    program, *words = COMPOSE["services"]["head"]["healthcheck"]["test"][1:]
    options = {option for parameter in ray_cli.commands[words[0]].params for option in parameter.opts}
    assert program == "ray" and {word.partition("=")[0] for word in words[1:]} <= options
    program, option, code = COMPOSE["services"]["mlflow"]["healthcheck"]["test"][1:]
    assert (program, option) == ("python", "-c") and compile(code, "healthcheck", "exec")


def test_kubernetes_runs_what_compose_runs():
    """The operator turns parameters into options; it sets --head or --address, --block and the port (6379) itself."""
    (driver,) = KUBERNETES["Job"]["spec"]["template"]["spec"]["containers"]
    assert driver["command"] == words_of("driver", {"head:6379": "puddle-head-svc:6379", "${PRESET}": "$PRESET"})
    spec = KUBERNETES["RayCluster"]["spec"]
    for name, group in (("head", spec["headGroupSpec"]), ("worker", spec["workerGroupSpecs"][0])):
        given = {
            f"--{option}" + ("" if value == "true" else f"={value}")
            for option, value in group["rayStartParams"].items()
        }
        by_compose = set(COMPOSE["services"][name]["command"])
        assert given <= by_compose
        lacking = by_compose - given - {"ray", "start", "--head", "--block", "--port=6379", "--address=head:6379"}
        assert lacking == {"--object-store-memory=500000000"}  # a Pod uses Ray's default, a share of its memory


def test_mlflows_options_exist():
    from mlflow.cli import cli

    (words,) = [words for words in commands() if words[0] == "mlflow"]
    options = {option for parameter in cli.commands["server"].params for option in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= options


def test_the_image_has_the_driver_of_the_servers_database():
    """SQLAlchemy decides which driver `postgresql:` means: psycopg2 before 2.1, psycopg since."""
    (words,) = [words for words in commands() if words[0] == "mlflow"]
    driver = make_url(words[words.index("--backend-store-uri") + 1]).get_dialect().driver
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"{driver}-binary" in project["optional-dependencies"]["server"]


def test_presets_that_they_name_exist():
    names = re.findall(r"PRESET:-(\w+)", (DOCKER / "compose.yaml").read_text())
    names += re.findall(r"name: PRESET, value: (\w+)", (DOCKER / "kuberay.yaml").read_text())
    assert len(names) == 2
    assert all((PRESETS / f"{name}.yaml").exists() for name in names)


def test_compose_conforms_to_the_specification(tmp_path):
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    done = subprocess.run([*check, DOCKER / "compose.yaml"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    slip = tmp_path / "compose.yaml"
    slip.write_text((DOCKER / "compose.yaml").read_text().replace("retries: 24", "retrys: 24", 1))
    assert subprocess.run([*check, slip], capture_output=True).returncode == 1


VARIABLES = {"PRESET": "paper", "TORCH_INDEX": "https://an.example/index"}
"""Variables of docker/compose.yaml, each with a value other than its default."""


def test_docker_compose_accepts_it(tmp_path):
    """`docker compose config` also substitutes the variables; it needs no daemon."""
    compose = [shutil.which("docker") or "docker", "compose"]
    try:
        asked = subprocess.run([*compose, "version"], capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip("no docker here")
    if asked.returncode or not re.search(r"v?([2-9]|\d\d)\.\d", asked.stdout):
        said = (asked.stderr or asked.stdout).strip().splitlines()
        pytest.skip(f"no `docker compose` of version 2 or later here: {said[0] if said else 'no answer'}")
    file = DOCKER / "compose.yaml"
    given = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    for variables in ({}, VARIABLES):
        done = subprocess.run([*compose, "-f", file, "config"], capture_output=True, text=True, env=given | variables)
        assert done.returncode == 0 and "not set" not in done.stderr, done.stderr
        read = yaml.safe_load(done.stdout)["services"]
        assert set(read) == set(COMPOSE["services"])
        for name, service in COMPOSE["services"].items():
            assert read[name].get("command") == service.get("command")  # it writes $$ for a $ of the shell
        preset = read["driver"]["environment"]["PRESET"]
        assert preset == variables.get("PRESET", preset) and preset in {path.stem for path in PRESETS.glob("*.yaml")}
        index = variables.get("TORCH_INDEX", "")
        assert all(read[name]["build"]["args"]["TORCH_INDEX"] == index for name in read if "build" in read[name])
    slip = tmp_path / "compose.yaml"
    slip.write_text(file.read_text().replace("networks: [cluster]", "networks: [clutser]", 1))
    assert subprocess.run([*compose, "-f", slip, "config"], capture_output=True).returncode != 0


def test_compose_exposes_no_port_or_secret_and_refers_to_what_it_defines():
    """Rules that the schema cannot express."""
    taken = set(re.findall(r"(?<!\$)\$\{?(\w+)", (DOCKER / "compose.yaml").read_text()))
    assert taken == set(VARIABLES)  # any other $ in a command belongs to the shell, and is doubled
    for service in COMPOSE["services"].values():
        assert "$" not in " ".join(service.get("command", ())).replace("$$", "")
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", []))
        assert set(service["networks"]) <= set(COMPOSE["networks"])
        assert set(service.get("secrets", ())) <= set(COMPOSE["secrets"])
        assert all(mount.partition(":")[0] in COMPOSE["volumes"] for mount in service.get("volumes", []))
        for needed, condition in service.get("depends_on", {}).items():
            assert condition == {"condition": "service_healthy"} and "healthcheck" in COMPOSE["services"][needed]
        secret = [name for name in service.get("environment", {}) if re.search("TOKEN|PASSWORD", name)]
        assert all(name.endswith(("_PATH", "_FILE")) for name in secret)  # the name of a file, never its content
    for ray_node in ("head", "worker", "driver"):
        service = COMPOSE["services"][ray_node]
        assert service["environment"]["RAY_AUTH_MODE"] == "token"
        assert service["environment"]["RAY_AUTH_TOKEN_PATH"] == "/run/secrets/ray_token"
        assert "ray_token" in service["secrets"]
    assert COMPOSE["services"]["driver"]["restart"] == "no"


def test_secrets_are_not_committed():
    assert "/docker/secrets/" in (ROOT / ".gitignore").read_text().splitlines()
    for secret in COMPOSE["secrets"].values():
        assert secret["file"].startswith("secrets/")


KUBERNETES_VERSIONS = ("1.29", "1.37")
"""The oldest and the newest version that the manifests are checked against."""


@pytest.mark.parametrize("version", KUBERNETES_VERSIONS)
def test_the_manifests_conform_to_the_schemas_of_kubernetes(version):
    """The check is strict: unknown fields are refused."""
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
def test_a_ray_cluster_has_the_fields_that_its_definition_requires(group):
    """The required fields are those of ray-operator/apis/ray/v1/raycluster_types.go without `omitempty`."""
    cluster = KUBERNETES["RayCluster"]
    assert cluster["apiVersion"] == "ray.io/v1" and cluster["metadata"]["name"] == "puddle"
    spec = cluster["spec"]
    known = {"rayVersion", "headGroupSpec", "workerGroupSpecs", "enableInTreeAutoscaling", "autoscalerOptions"}
    assert set(spec) <= known
    groups = [spec["headGroupSpec"]] if group == "head" else spec["workerGroupSpecs"]
    for one in groups:
        own = {"serviceType"} if group == "head" else {"groupName", "replicas", "minReplicas", "maxReplicas"}
        assert set(one) == {"rayStartParams", "template"} | own
        assert all(isinstance(value, str) for value in one["rayStartParams"].values())  # a map of strings
        options = {option for parameter in ray_cli.commands["start"].params for option in parameter.opts}
        assert {f"--{name}" for name in one["rayStartParams"]} <= options
        secured(one["template"]["spec"], of_autoscaler=group == "head")
        (ray,) = one["template"]["spec"]["containers"]
        address = "localhost" if group == "head" else "puddle-head-svc"
        words = [w.replace("head:", f"{address}:") for w in COMPOSE["services"]["head"]["healthcheck"]["test"][1:]]
        for probe in ("livenessProbe", "readinessProbe"):  # the operator's own probes need Ray's dashboard
            assert ray[probe]["exec"]["command"] == words
        if group == "worker":
            assert one["groupName"] and 0 <= one["minReplicas"] <= one["replicas"] <= one["maxReplicas"]


def test_the_driver_is_a_job_on_the_cluster_that_is_defined():
    job = KUBERNETES["Job"]["spec"]["template"]["spec"]
    assert KUBERNETES["Job"]["apiVersion"] == "batch/v1"
    secured(job)
    (driver,) = job["containers"]
    assert "puddle-head-svc:6379" in driver["command"][2]  # KubeRay names the head's service after the cluster
    assert {mount["name"] for mount in driver["volumeMounts"]} == {volume["name"] for volume in job["volumes"]}
    (claim,) = [v["persistentVolumeClaim"]["claimName"] for v in job["volumes"] if "persistentVolumeClaim" in v]
    assert claim == KUBERNETES["PersistentVolumeClaim"]["metadata"]["name"]


def test_the_job_ends_when_the_study_has_ended_and_is_retried_otherwise():
    """Rules about exit codes require that the kubelet does not restart containers by itself."""
    job = KUBERNETES["Job"]["spec"]
    (driver,) = job["template"]["spec"]["containers"]
    assert job["template"]["spec"]["restartPolicy"] == "Never" and job["backoffLimit"] > 0
    (rule,) = job["podFailurePolicy"]["rules"]
    assert rule == {
        "action": "FailJob",
        "onExitCodes": {"containerName": driver["name"], "operator": "In", "values": [INCOMPLETE]},
    }


@pytest.mark.parametrize(("there", "study", "code"), [(False, 0, 2), (True, 0, 0), (True, INCOMPLETE, INCOMPLETE)])
def test_a_cluster_that_does_not_answer_yet_does_not_end_the_job(tmp_path, there, study, code):
    """`ray start` then exits with 1, as a study with failed work items does."""
    for program, ends in (("ray", 0 if there else 1), ("puddle", study)):
        (tmp_path / program).write_text(f"#!/bin/sh\nexit {ends}\n")
        (tmp_path / program).chmod(0o755)
    (driver,) = KUBERNETES["Job"]["spec"]["template"]["spec"]["containers"]
    environment = {"PATH": f"{tmp_path}:/usr/bin:/bin", "PRESET": "smoke"}
    assert subprocess.run(driver["command"], env=environment).returncode == code


def secured(pod: dict, *, of_autoscaler: bool = False) -> None:
    """Check that a Pod's Ray asks for the token, and that only the autoscaler's Pod may speak to Kubernetes."""
    assert pod["securityContext"]["runAsNonRoot"] and pod["automountServiceAccountToken"] is of_autoscaler
    for container in pod["containers"]:
        has_the_token(container)


def has_the_token(container: dict) -> None:
    environment = {one["name"]: one for one in container["env"]}
    assert environment["RAY_AUTH_MODE"]["value"] == "token"
    assert environment["RAY_AUTH_TOKEN"]["valueFrom"]["secretKeyRef"] == {"name": "puddle-token", "key": "token"}


def test_workers_come_and_go_with_the_work():
    """The operator adds `ray kuberay-autoscaler` to the head's Pod; its options become that container's."""
    spec = KUBERNETES["RayCluster"]["spec"]
    assert spec["enableInTreeAutoscaling"] is True
    options = spec["autoscalerOptions"]
    assert set(options) == {"idleTimeoutSeconds", "env", "resources"} and options["idleTimeoutSeconds"] >= 60
    has_the_token(options)  # it is a client of Ray's head
    container = {
        "name": "autoscaler",
        "image": "puddle:latest",
        "env": options["env"],
        "resources": options["resources"],
    }
    pod = {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": "head"}, "spec": {"containers": [container]}}
    kubernetes_validate.validate(pod, KUBERNETES_VERSIONS[-1], strict=True)
    command = ray_cli.commands["kuberay-autoscaler"]
    assert {"--cluster-name", "--cluster-namespace"} <= {one for part in command.params for one in part.opts}
    importlib.import_module("ray.autoscaler._private.kuberay.run_autoscaler")  # Ray's minimal installation has it
    (workers,) = spec["workerGroupSpecs"]
    assert workers["minReplicas"] < workers["replicas"] < workers["maxReplicas"]
    # It scales by the work that waits in Ray, so a study must submit more than the cores can take.
    assert dispatcher._QUEUED_PER_CORE > 1


def test_links_of_the_image_lead_to_what_it_copies(tmp_path):
    """Presets and constraints lie in the package as links to the checkout's own; COPY copies links as they are."""
    for line in instructions("COPY"):
        *sources, target = line.split()
        for source in map(ROOT.__truediv__, sources):
            if source.is_dir():  # COPY copies its content
                shutil.copytree(source, tmp_path / target, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                (tmp_path / target).mkdir(parents=True, exist_ok=True)
                shutil.copy(source, tmp_path / target)
    links = [path for path in tmp_path.rglob("*") if path.is_symlink()]
    assert {str(path.relative_to(tmp_path)) for path in links} >= {"pipeline/presets", "pipeline/constraints.txt"}
    for link in links:
        assert link.exists() and link.resolve().is_relative_to(tmp_path), link
