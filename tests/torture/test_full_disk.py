"""A full disk stops a study with a clear message; with room it continues."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]

ALONE = ("unshare", "--mount", "--map-root-user")
"""Command that runs a program in its own namespace, where it may mount; it needs no privileges."""


@dataclass(frozen=True)
class Machine:
    """Where disks are mounted: here, or in the namespace of a fork server."""

    fork_server: Any
    undisturbed: dict[str, Any]
    """Answer of the fork server for an undisturbed study."""
    inside: tuple[str, ...] = ()
    """Command prefix that runs a program there."""
    top: Path = Path("/")
    """Root of its file system, as these tests see it."""

    def run(self, *words: str | Path, **execution: Any) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*self.inside, *words], capture_output=True, text=True, **execution)

    def mount(self, disk: Path, options: str, *words: str) -> None:
        done = self.run("mount", *words, "-o", options, "tmpfs", disk)
        if done.returncode:
            pytest.skip(f"cannot mount a disk here or in a namespace: {done.stderr.strip()}")

    def unmount(self, disk: Path) -> None:
        self.run("umount", disk, check=True)

    def committed(self, disk: Path) -> list[str]:
        """Return the keys of the items in a disk's store."""
        store = self.top / disk.relative_to("/") / "store"
        return [path.parent.name for path in store.glob("items/*/*/*/manifest.json")]


def may_mount(folder: Path, inside: tuple[str, ...]) -> bool:
    try:
        subprocess.run([*inside, "mount", "-t", "tmpfs", "tmpfs", folder], check=True, capture_output=True)
        if not inside:
            subprocess.run(["umount", folder], check=True)
    except (OSError, subprocess.CalledProcessError):
        return False
    return True


@pytest.fixture(scope="module")
def machine(request, start_fork_server, tmp_path_factory) -> Machine:
    folder = tmp_path_factory.mktemp("undisturbed")
    in_namespace = not may_mount(folder, ()) and may_mount(folder, ALONE)
    fork_server = start_fork_server(*ALONE) if in_namespace else request.getfixturevalue("fork_server")
    (undisturbed,) = fork_server.finish([folder / "store"])
    if not in_namespace:
        return Machine(fork_server, undisturbed)
    enter = ("nsenter", f"--target={fork_server.pid}", "--user", "--mount", "--preserve-credentials")
    return Machine(fork_server, undisturbed, enter, Path(f"/proc/{fork_server.pid}/root"))


def stopped(machine: Machine, disk: Path, why: str, **command) -> bool:
    """Drive a study that may be stopped; check that it says why. Return whether it was stopped."""
    answer = machine.fork_server.drive(disk / "store", **command)
    assert answer["status"] == 0, answer["traceback"]
    if "error" not in answer:
        assert answer["tree"] == machine.undisturbed["tree"]
        return False
    assert why in answer["error"] and str(disk) in answer["error"] and "Committed results are safe" in answer["error"]
    return True


def resumes(machine: Machine, disk: Path, committed: list[str]) -> None:
    (after,) = machine.fork_server.finish([disk / "store"])
    assert not set(after["computed"]) & set(committed)
    assert after["tree"] == machine.undisturbed["tree"]


def test_a_disk_of_any_size_that_fills(torture, machine, new_folder):
    n_full = 0
    for rng in torture.attempts(6, 500):
        disk = new_folder()
        n_kilobytes = int(rng.integers(4, 1200 if n_full else 64))  # the first is full in any case
        machine.mount(disk, f"size={n_kilobytes}k", "-t", "tmpfs")
        try:
            committed = []
            if stopped(machine, disk, "No space left on device"):
                n_full += 1
                committed = machine.committed(disk)
                machine.mount(disk, "remount,size=64m")
            resumes(machine, disk, committed)
        finally:
            machine.unmount(disk)
    assert n_full


def test_the_command_names_the_full_disk_and_exits_with_2(torture, machine, tmp_path):
    """The whole program, except MLflow's database and Ray."""
    machine.mount(tmp_path, "size=16k", "-t", "tmpfs")
    try:
        done = machine.run(
            sys.executable,
            "-m",
            "pipeline",
            "study",
            "--preset=smoke",
            "--workers=0",
            "--store",
            tmp_path / "store",
            env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        )
    finally:
        machine.unmount(tmp_path)
    assert done.returncode == 2
    assert "No space left on device" in done.stderr and "run the same command again" in done.stderr
    assert "Traceback" not in done.stderr
