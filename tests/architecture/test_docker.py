"""The container files conform to their schemas and agree with the project: versions, files, commands, open ports.

Ray's head, its workers and the driver are run with the commands of these files in tests/torture/test_two_machines.py,
MLflow's server in tests/pipeline/tracking/test_server.py.
"""

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
from containers import COMPOSE, DOCKER, KUBERNETES, instructions, words_of
from mlflow.cli import cli as mlflow_cli
from sqlalchemy import make_url

from pipeline.commands.app import app
from pipeline.commands.exit_codes import INCOMPLETE
from pipeline.config.loading import PRESETS

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # Ray's, about pydantic
    from ray.scripts.scripts import cli as ray_cli

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CONSTRAINTS = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split() if "==" in line)
PROGRAMS = {"ray": ray_cli, "puddle": typer.main.get_command(app), "mlflow": mlflow_cli}


def commands() -> list[list[str]]:
    """Return every command line that a container runs; those of shells are split."""
    given = [service["command"] for service in COMPOSE["services"].values() if "command" in service]
    given.append(KUBERNETES["Job"]["spec"]["template"]["spec"]["containers"][0]["command"])
    given.append(COMPOSE["services"]["head"]["healthcheck"]["test"][1:])
    found = []
    for words in given:
        if words[0] == "sh":
            parts = words[2].replace("$$(cat /run/secrets/postgres_password)", "x").split("&&")
            found += [shlex.split(part.strip().removeprefix("exec ")) for part in parts]
        else:
            found.append(words)
    return found


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_every_option_of_a_command_exists(words):
    program, command, *rest = words
    options = {option for parameter in PROGRAMS[program].commands[command].params for option in parameter.opts}
    assert {word.partition("=")[0] for word in rest if word.startswith("--")} <= options


def test_the_image_has_the_tested_versions_and_does_not_run_as_root():
    (base,) = instructions("FROM")
    lowest, highest = re.findall(r"3\.(\d+)", PROJECT["requires-python"])
    assert int(lowest) <= int(re.search(r"python:3\.(\d+)", base)[1]) < int(highest)
    assert all("constraints.txt" in line for line in instructions("RUN") if "pip install" in line)
    assert instructions("USER") == ["puddle"]
    assert KUBERNETES["RayCluster"]["spec"]["rayVersion"] == CONSTRAINTS["ray"]
    (mlflow,) = [words for words in commands() if words[0] == "mlflow"]
    driver = make_url(mlflow[mlflow.index("--backend-store-uri") + 1]).get_dialect().driver
    assert f"{driver}-binary" in PROJECT["optional-dependencies"]["server"]  # SQLAlchemy decides what postgresql: means


def test_files_of_the_image_exist_are_not_ignored_and_their_links_lead_inside(tmp_path):
    allowed = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = []
    for line in instructions("COPY"):
        *sources, target = line.split()
        copied += [source.removeprefix("./") for source in sources]
        for source in map(ROOT.__truediv__, sources):
            if source.is_dir():  # COPY copies its content, and links as they are
                shutil.copytree(source, tmp_path / target, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                (tmp_path / target).mkdir(parents=True, exist_ok=True)
                shutil.copy(source, tmp_path / target)
    assert allowed == set(copied)
    for link in (path for path in tmp_path.rglob("*") if path.is_symlink()):
        assert link.exists() and link.resolve().is_relative_to(tmp_path), link


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
    for file in ("compose.yaml", "kuberay.yaml"):
        (preset,) = re.findall(r"PRESET:-(\w+)|name: PRESET, value: (\w+)", (DOCKER / file).read_text())
        assert (PRESETS / f"{''.join(preset)}.yaml").exists()


def test_compose_conforms_to_the_specification(tmp_path):
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    done = subprocess.run([*check, DOCKER / "compose.yaml"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_compose_publishes_on_the_loopback_and_takes_secrets_from_files():
    for service in COMPOSE["services"].values():
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", []))
        secret = [name for name in service.get("environment", {}) if re.search("TOKEN|PASSWORD", name)]
        assert all(name.endswith(("_PATH", "_FILE")) for name in secret)
    for name in ("head", "worker", "driver"):
        assert COMPOSE["services"][name]["environment"]["RAY_AUTH_MODE"] == "token"
    assert "/docker/secrets/" in (ROOT / ".gitignore").read_text().splitlines()


@pytest.mark.parametrize("version", ["1.29", "1.37"])
def test_the_manifests_conform_to_the_schemas_of_kubernetes(version):
    """The schemas lack KubeRay's own definition, but almost all of a RayCluster is a Pod template."""
    spec = KUBERNETES["RayCluster"]["spec"]
    groups = [spec["headGroupSpec"], *spec["workerGroupSpecs"]]
    pods = [{"apiVersion": "v1", "kind": "PodTemplate", "template": group["template"]} for group in groups]
    known = [part for kind, part in KUBERNETES.items() if kind != "RayCluster"]
    for part in known + pods:
        kubernetes_validate.validate(part, version, strict=True)
    for pod in (group["template"]["spec"] for group in groups):
        assert pod["securityContext"]["runAsNonRoot"]
        for container in pod["containers"]:
            environment = {one["name"]: one for one in container["env"]}
            assert environment["RAY_AUTH_MODE"]["value"] == "token"
