"""kill -9 at random moments, of a worker, the driver, the raylet or the GCS: the study ends in the same bytes.

The processes are real: drivers with their own Ray, one after the other on the same store, each of which loses workers,
dies itself, or loses its raylet or its GCS. A committed item is never submitted again, nor its manifest written twice.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
import yaml
from quick_study import TINY, logged, run_study, submissions_of, tree

from pipeline.cluster import serial_cluster
from pipeline.config.loading import load
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store

HERE = Path(__file__).parent
VICTIMS = ["worker", "raylet", "driver", "worker", "worker", "gcs_server"]
"""Processes to kill, in turn; `make test` stops at the driver. A worker is replaced by another; the death of any other
ends the run."""
PATIENCE = 600.0
"""Longest time for a driver to notice that its cluster is dead, on a busy machine [s]."""

STUDY = TINY | {
    "grid": {"depths": [1.0], "environments": ["dry_land"], "single_member_depths": [], "n_trials": 6},
    "rollout": {"n_settle": 5, "n_measure": 100},
    "evolution": {"n_generations": 10, "afpo": {"population_size": 6}},
}
"""A study of about sixty work items of up to 0.1 s."""

DRIVER = """
import sys
from pathlib import Path
from quick_study import logged, run_study
from pipeline.cluster import ray_cluster
from pipeline.config.loading import load
from pipeline.errors import PuddleError
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store

settings, root = load(Settings, Path(sys.argv[1])), Path(sys.argv[2])
on_ray = lambda: logged(ray_cluster(n_workers=2), root)
try:
    store = Store.open(root, create=True)
    run_study(settings, store, stages=STAGES[:-1], open_cluster=on_ray)
except PuddleError as error:
    sys.exit(f"stopped: {error}")
"""
"""`puddle study --workers 2` without MLflow and without the report, whose page contains the time."""


def serially(settings: Path, store: Path) -> dict[str, str]:
    """Run a study to its end in this process; return the digests of its files, except manifests."""
    run_study(
        load(Settings, settings),
        Store.open(store, create=True),
        stages=STAGES[:-1],
        open_cluster=lambda: logged(serial_cluster(), store),
    )
    items = {path: sha256 for path, sha256 in tree(store).items() if path.startswith("items/")}
    return {path: sha256 for path, sha256 in items.items() if not path.endswith("manifest.json")}


def manifests(store: Path) -> dict[Path, int]:
    """Return the time of each manifest."""
    return {path: path.stat().st_mtime_ns for path in store.glob("items/*/*/*/manifest.json")}


def find(victim: str, driver: subprocess.Popen[str]) -> psutil.Process | None:
    """Wait for a process of a driver; None if the driver ends first."""
    end = time.monotonic() + PATIENCE
    while driver.poll() is None:
        assert time.monotonic() < end, f"no {victim}"
        with contextlib.suppress(psutil.Error):
            process = psutil.Process(driver.pid)
            if victim == "driver":
                return process
            for child in process.children(recursive=True):
                name = child.name()
                if name == victim or (victim == "worker" and name.startswith("ray::") and "Agent" not in name):
                    return child
        time.sleep(0.1)
    return None


def drive_and_kill(settings: Path, store: Path, victim: str, rng: np.random.Generator) -> bool:
    """Run a driver that loses a process at a random moment; return whether its study ended all the same."""
    driver = subprocess.Popen(
        [sys.executable, "-c", DRIVER, str(settings), str(store)],
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": f"{HERE}{os.pathsep}{HERE.parents[1]}"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    try:
        find(victim, driver)
        time.sleep(float(rng.exponential(2.0)))
        if (prey := find(victim, driver)) is not None:
            with contextlib.suppress(psutil.NoSuchProcess):
                prey.kill()
        _, said = driver.communicate(timeout=PATIENCE)
    finally:
        driver.kill()
    assert "Traceback" not in said, said
    if prey is None or victim == "worker":
        assert driver.returncode == 0, said
    elif victim != "driver":
        assert "Ray on this machine died" in said or "Ray did not start on this machine" in said, said
    return driver.returncode == 0


@pytest.mark.timeout(3600)
def test_kill_9_at_random_moments(torture, tmp_path):
    settings = tmp_path / "kills.yaml"
    settings.write_text(yaml.safe_dump(STUDY))
    undisturbed = serially(settings, tmp_path / "undisturbed")
    store, committed, number = tmp_path / "0", {}, 0
    for number, rng in enumerate(torture.attempts(3, 200)):
        ended = drive_and_kill(settings, store, VICTIMS[number % len(VICTIMS)], rng)
        now = manifests(store)
        assert {path: now.get(path) for path in committed} == committed
        committed = now
        if ended:
            assert serially(settings, store) == undisturbed
            store, committed = tmp_path / str(number + 1), {}
    assert serially(settings, store) == undisturbed
    for log in map(submissions_of, (path for path in tmp_path.iterdir() if path.is_dir())):
        submitted = [line.split()[1] for line in log.read_text().splitlines()] if log.exists() else []
        assert set(submitted) <= {"missing"}


def test_a_driver_killed_at_random_moments_resumes_to_the_same_bytes(torture, full, new_folder):
    """Drivers of one store, each a process of its own, killed again and again until one ends the study."""
    full.drive(reference := new_folder() / "store")
    undisturbed, root, n_killed = tree(reference), new_folder() / "store", 0
    for rng in torture.attempts(20, 200):
        if (driver := os.fork()) == 0:
            with contextlib.suppress(BaseException):
                full.drive(root)
                os._exit(0)
            os._exit(1)
        time.sleep(float(rng.exponential(0.1)))
        os.kill(driver, signal.SIGKILL)
        _, status = os.waitpid(driver, 0)
        assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
        n_killed += os.WIFSIGNALED(status)
        if not os.WIFSIGNALED(status):
            assert tree(root) == undisturbed
            root = new_folder() / "store"
    full.drive(root)
    assert tree(root) == undisturbed and n_killed
