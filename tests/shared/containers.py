"""What the containers of docker/ run, read from their files: what tests run without containers is the same words."""

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
"""A change of words, for machines on which others are."""


def instructions(name: str) -> list[str]:
    """Give the arguments of every instruction of the image of that name."""
    return re.findall(rf"^{name} (.+)$", DOCKERFILE.replace("\\\n", " "), flags=re.M)


def words_of(service: str, changes: Mapping[str, str]) -> list[str]:
    """Give the words that a service of the compose file runs, with this machine's names in place of the containers'.

    Args:
        service: of docker/compose.yaml.
        changes: what to write in place of what; all of it must be in the command.
    """
    words = [word.replace("$$", "$") for word in COMPOSE["services"][service]["command"]]  # as compose itself does
    for old, new in changes.items():
        assert any(old in word for word in words), f"{service}: expected {old!r} in its command, came {words}"
        words = [word.replace(old, new) for word in words]
    return words


def environment_of(service: str, changes: Mapping[str, str]) -> dict[str, str]:
    """Give a service's environment likewise, the image's with it: what is not changed stays, and names no file."""
    of_image = dict(pair.split("=", 1) for line in instructions("ENV") for pair in line.split())
    environment = {**of_image, **COMPOSE["services"][service]["environment"]}
    assert set(changes) <= set(environment), f"{service}: expected {sorted(changes)}, came {sorted(environment)}"
    return environment | changes
