"""A full disk stops a study with a clear message; with room it continues."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from mounted import mounted
from quick_study import tree

ROOT = Path(__file__).parents[2]
ALONE = ("unshare", "--mount", "--map-root-user")  # runs a program where it may mount; it needs no privileges


def test_a_disk_of_any_size_that_fills(torture, tiny, new_folder):
    tiny.drive(undisturbed := new_folder() / "store")
    n_full = 0
    for rng in torture.attempts(6, 500):
        disk = new_folder()
        n_kilobytes = int(rng.integers(4, 1200)) if n_full else 4  # the first has room for the mark of a store alone
        with mounted(disk, f"size={n_kilobytes}k"):
            committed = []
            try:
                tiny.drive(disk / "store")
            except OSError as error:
                n_full += 1
                assert "No space left on device" in str(error) and str(disk) in str(error)
                committed = [path.parent.name for path in disk.glob("store/items/*/*/*/manifest.json")]
            subprocess.run(["mount", "-o", "remount,size=64m", "tmpfs", disk], check=True)
            after = tiny.drive(disk / "store")
            assert not set(after.computed) & set(committed)
            assert tree(disk / "store") == tree(undisturbed)
    assert n_full


def test_the_command_names_the_full_disk_and_exits_with_2(tmp_path):
    """The whole program, except MLflow's database and Ray."""
    script = f"mount -t tmpfs -o size=16k tmpfs {tmp_path} && exec {sys.executable} -m pipeline study --preset=smoke"
    command = [*ALONE, "sh", "-c", f"{script} --workers=0 --store {tmp_path}/store"]
    done = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    )
    if "unshare" in done.stderr or "mount" in done.stderr:
        pytest.skip(f"no namespace to mount a disk in: {done.stderr.strip()}")
    assert done.returncode == 2
    assert "No space left on device" in done.stderr and "run the same command again" in done.stderr
    assert "Traceback" not in done.stderr
