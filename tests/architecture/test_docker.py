"""The container files conform to their schemas and agree with the project: versions, files, commands, open ports.

Ray's head, its workers and the driver are run with the commands of these files in tests/torture/test_two_machines.py,
MLflow's server in tests/pipeline/mlflow/test_server.py.
"""

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import kubernetes_validate
import pytest
from containers import COMPOSE, DOCKER, KUBERNETES, instructions, words_of

from pipeline.commands.app import command as puddle
from pipeline.commands.terminal import INCOMPLETE

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CONSTRAINTS = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split() if "==" in line)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # Ray's, about pydantic
def test_every_option_of_a_command_exists():
    from mlflow.cli import cli as mlflow  # both take seconds to load, which no other test needs to wait for
    from ray.scripts.scripts import cli as ray

    programs = {"ray": ray.commands.get, "puddle": puddle, "mlflow": mlflow.commands.get}
    given = [service["command"] for service in COMPOSE["services"].values() if "command" in service]
    given.append(KUBERNETES["Job"]["spec"]["template"]["spec"]["containers"][0]["command"])
    given.append(COMPOSE["services"]["head"]["healthcheck"]["test"][1:])
    for words in given:
        lines = [words]
        if words[0] == "sh":
            parts = words[2].replace("$$(cat /run/secrets/postgres_password)", "x").split("&&")
            lines = [shlex.split(part.strip().removeprefix("exec ")) for part in parts]
        for program, command, *rest in lines:
            options = {option for parameter in programs[program](command).params for option in parameter.opts}
            assert {word.partition("=")[0] for word in rest if word.startswith("--")} <= options, command


def test_the_image_has_the_tested_versions_and_files_and_does_not_run_as_root():
    (base,) = instructions("FROM")
    lowest, highest = re.findall(r"3\.(\d+)", PROJECT["requires-python"])
    assert int(lowest) <= int(re.search(r"python:3\.(\d+)", base)[1]) < int(highest)
    assert all("constraints.txt" in line for line in instructions("RUN") if "pip install" in line)
    assert instructions("USER") == ["puddle"]
    assert KUBERNETES["RayCluster"]["spec"]["rayVersion"] == CONSTRAINTS["ray"]
    allowed = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = {source.removeprefix("./") for line in instructions("COPY") for source in line.split()[:-1]}
    assert allowed == copied and all((ROOT / source).exists() for source in copied)


def test_kubernetes_runs_what_compose_runs():
    """The operator turns parameters into options; it sets --head or --address, --block and the port (6379) itself."""
    job = KUBERNETES["Job"]["spec"]
    (driver,) = job["template"]["spec"]["containers"]
    assert driver["command"] == words_of("driver", {"head:6379": "puddle-head-svc:6379", "${PRESET}": "$PRESET"})
    spec = KUBERNETES["RayCluster"]["spec"]
    for name, group in (("head", spec["headGroupSpec"]), ("worker", spec["workerGroupSpecs"][0])):
        given = {f"--{key}" + ("" if of == "true" else f"={of}") for key, of in group["rayStartParams"].items()}
        assert given <= set(COMPOSE["services"][name]["command"])
    (rule,) = job["podFailurePolicy"]["rules"]  # a study with failed items has ended; anything else is tried again
    assert rule["action"] == "FailJob" and rule["onExitCodes"]["values"] == [INCOMPLETE]


def test_compose_conforms_publishes_on_the_loopback_and_takes_secrets_from_files():
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    done = subprocess.run([*check, DOCKER / "compose.yaml"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    for service in COMPOSE["services"].values():
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", []))
        secret = [name for name in service.get("environment", {}) if re.search("TOKEN|PASSWORD", name)]
        assert all(name.endswith(("_PATH", "_FILE")) for name in secret)
    for name in ("head", "worker", "driver"):
        assert COMPOSE["services"][name]["environment"]["RAY_AUTH_MODE"] == "token"


@pytest.mark.parametrize("version", ["1.29", "1.37"])
def test_the_manifests_conform_to_the_schemas_of_kubernetes(version):
    """The schemas lack KubeRay's own definition, but almost all of a RayCluster is a Pod template."""
    spec = KUBERNETES["RayCluster"]["spec"]
    groups = [spec["headGroupSpec"], *spec["workerGroupSpecs"]]
    pods = [{"apiVersion": "v1", "kind": "PodTemplate", "template": group["template"]} for group in groups]
    for part in [part for kind, part in KUBERNETES.items() if kind != "RayCluster"] + pods:
        kubernetes_validate.validate(part, version, strict=True)
    for pod in (group["template"]["spec"] for group in groups):
        assert pod["securityContext"]["runAsNonRoot"]
        environments = [{one["name"]: one for one in container["env"]} for container in pod["containers"]]
        assert all(environment["RAY_AUTH_MODE"]["value"] == "token" for environment in environments)
