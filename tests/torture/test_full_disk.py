"""A disk that fills, a file-size limit and a disk that turns read-only stop a study clearly; with room it goes on."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def undisturbed(nursery, tmp_path_factory):
    (answer,) = nursery.finish([tmp_path_factory.mktemp("undisturbed") / "store"])
    return answer


def mount(place, options: str, *words: str) -> None:
    done = subprocess.run(["mount", *words, "-o", options, "tmpfs", str(place)], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"may not mount a disk here: {done.stderr.strip()}")


def stopped(nursery, disk, undisturbed, why: str, **command) -> bool:
    """Drive the study where it may not end; check that it says why, and that what it kept is whole."""
    told = nursery.drive(disk / "store", **command)
    assert told["status"] == 0, told["traceback"]
    if "error" not in told:
        assert told["tree"] == undisturbed["tree"]
        return False
    assert why in told["error"] and str(disk) in told["error"] and "kept before is safe" in told["error"]
    return True


def resumes(nursery, disk, undisturbed, committed) -> None:
    (after,) = nursery.finish([disk / "store"])
    assert not set(after["computed"]) & set(committed)
    assert after["tree"] == undisturbed["tree"]


def test_a_disk_of_any_size_that_fills(torture, nursery, undisturbed, place):
    n_full = 0
    for rng in torture.attempts(12, 500):
        disk = place()
        n_kilobytes = int(rng.integers(4, 1200))
        mount(disk, f"size={n_kilobytes}k", "-t", "tmpfs")
        try:
            kept = []
            if stopped(nursery, disk, undisturbed, "No space left on device"):
                n_full += 1
                kept = [path.parent.name for path in disk.glob("store/items/*/*/*/manifest.json")]
                mount(disk, "remount,size=64m")
            resumes(nursery, disk, undisturbed, kept)
        finally:
            subprocess.run(["umount", str(disk)], check=True)
    assert n_full
    torture.note(f"{n_full} disks of 4 kB to 1.2 MB were too small; each study went on once there was room")


def test_a_limit_on_the_size_of_files(torture, nursery, undisturbed, place):
    n_stopped = 0
    for rng in torture.attempts(6, 200):
        disk = place()
        kept = []
        if stopped(nursery, disk, undisturbed, "File too large", file_bytes=int(rng.integers(100, 40_000))):
            n_stopped += 1
            kept = [path.parent.name for path in disk.glob("store/items/*/*/*/manifest.json")]
        resumes(nursery, disk, undisturbed, kept)
        shutil.rmtree(disk)
    assert n_stopped
    torture.note(f"{n_stopped} limits stopped the study")


def test_a_disk_that_turns_read_only(torture, nursery, undisturbed, place):
    """A driver fills the disk half-way; then it is read-only, as a disk is after an error; then it can be written."""
    for rng in torture.attempts(3, 100):
        disk = place()
        mount(disk, "size=64m", "-t", "tmpfs")
        try:
            at = int(rng.integers(20, len(undisturbed["effects"]) - 1))
            died = nursery.drive(disk / "store", fault={"kind": "die", "at": at})
            mount(disk, "remount,ro")
            assert stopped(nursery, disk, undisturbed, "Read-only file system")
            mount(disk, "remount,rw")
            resumes(nursery, disk, undisturbed, died["committed"])
        finally:
            subprocess.run(["umount", str(disk)], check=True)


THROWS = """
name: throws
throws: {n_throws: 40, n_steps: 20}
work: {throws_per_item: 1}
"""
TURNS = """
import subprocess, sys
from pipeline import disk
from pipeline.cli import main

settings, store, undisturbed, at = sys.argv[1:]
n_effects, codes = 0, []

def collect(store):
    try:
        main(["collect", "--workers", "0", "--settings", settings, "--store", store])
    except SystemExit as end:
        codes.append(end.code or 0)

def turning(effect):
    def turned(*rest):
        global n_effects
        if n_effects == int(at):
            subprocess.run(["mount", "--bind", "-o", "ro", store, store], check=True)
        n_effects += 1
        effect(*rest)
    return turned

collect(undisturbed)
for name in ("write", "fsync", "rename", "mkdir"):
    setattr(disk, name, turning(getattr(disk, name)))
collect(store)
subprocess.run(["umount", store], check=True)
collect(store)
sys.exit(f"codes: {codes}")
"""
"""The command three times: elsewhere; on a disk that turns read-only before some effect; on the same, mended."""


def test_a_disk_that_turns_read_only_under_a_driver(torture, place):
    """The store's folder is mounted over itself in a namespace of the driver's own, which anybody may have."""
    (number,) = (int(rng.integers(20, 200)) for rng in torture.attempts(1, 1))
    folder = place()
    settings, store, undisturbed = (folder / name for name in ("throws.yaml", "store", "undisturbed"))
    settings.write_text(THROWS)
    store.mkdir()
    alone = ["unshare", "--mount", "--map-root-user"]
    if shutil.which("unshare") is None or subprocess.run([*alone, "mount", "--bind", store, store]).returncode:
        pytest.skip("no namespace to mount a disk in")
    ran = subprocess.run(
        [*alone, sys.executable, "-c", TURNS, settings, store, undisturbed, str(number)],
        capture_output=True, text=True, cwd=Path(__file__).parents[2], env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert ran.stderr.endswith("codes: [0, 2, 0]\n"), ran.stderr
    assert "Read-only file system" in ran.stderr and "kept before is safe" in ran.stderr
    assert "Traceback" not in ran.stderr
    found, expected = (
        {path.relative_to(root): path.read_bytes() for path in root.glob("items/*/*/*/*") if path.suffix != ".json"}
        for root in (store, undisturbed)
    )
    assert len(expected) == 40 and found == expected


def test_the_command_says_it_and_ends_with_2(torture, tmp_path):
    """The whole program: its settings, its store, MLflow's database and Ray apart."""
    torture.times(1, 1)
    mount(tmp_path, "size=16k", "-t", "tmpfs")
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pipeline", "study", "--preset=smoke", "--workers=0", "--store", tmp_path / "store"],
            capture_output=True, text=True, cwd=Path(__file__).parents[2], env={**os.environ, "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)
    assert done.returncode == 2
    assert "No space left on device" in done.stderr and "give the same command again" in done.stderr
    assert "Traceback" not in done.stderr
