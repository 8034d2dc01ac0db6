"""The commands of the containers in docker/, read from their files, so that tests run exactly these."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import yaml

DOCKER = Path(__file__).parents[2] / "docker"
COMPOSE = yaml.safe_load((DOCKER / "compose.yaml").read_text())
DOCKERFILE = (DOCKER / "Dockerfile").read_text()
KUBERNETES = {part["kind"]: part for part in yaml.safe_load_all((DOCKER / "kuberay.yaml").read_text())}

SMALL_MEMORY = {"--object-store-memory=500000000": "--object-store-memory=100000000"}
"""A replacement that leaves memory for other processes on this machine."""


def instructions(name: str) -> list[str]:
    """Return the arguments of every instruction of the image with that name."""
    return re.findall(rf"^{name} (.+)$", DOCKERFILE.replace("\\\n", " "), flags=re.M)


def words_of(service: str, changes: Mapping[str, str]) -> list[str]:
    """Return the command of a service of the compose file, with this machine's names instead of the containers'.

    Args:
        service: name in docker/compose.yaml.
        changes: replacements, by what they replace; all of that must be in the command.
    """
    words = [word.replace("$$", "$") for word in COMPOSE["services"][service]["command"]]  # as compose itself does
    for old, new in changes.items():
        assert any(old in word for word in words), f"{service}: expected {old!r} in its command, got {words}"
        words = [word.replace(old, new) for word in words]
    return words


def environment_of(service: str, changes: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a service, including the image's, with some values replaced."""
    of_image = dict(pair.split("=", 1) for line in instructions("ENV") for pair in line.split())
    environment = {**of_image, **COMPOSE["services"][service]["environment"]}
    assert set(changes) <= set(environment), f"{service}: expected {sorted(changes)}, got {sorted(environment)}"
    return environment | changes
