"""kill -9 at random moments, of a worker, the driver, the raylet or the GCS: the study ends in the same bytes.

The processes are real: drivers with their own Ray, one after the other on the same store, each of which loses workers,
dies itself, or loses its raylet or its GCS. The manifest of a committed item is never written again.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from quick_study import run_study, tree
from small_study import ON_DRY_LAND

from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store

pytestmark = pytest.mark.slow

VICTIMS = ["driver", "worker", "raylet", "worker", "worker", "gcs_server"]
"""Processes to kill, in turn; `make test` stops at the driver. A worker is replaced by another; the death of any other
ends the run."""
PATIENCE = 600.0  # longest time for a driver to notice that its cluster is dead, on a busy machine [s]

STUDY = parse(
    Settings,
    ON_DRY_LAND,
    name="kills",
    overrides=("grid.n_trials=4", "rollout.n_measure=100", "evolution={n_generations: 6, afpo: {population_size: 6}}"),
)
"""A study of about thirty work items of up to 0.1 s."""

DRIVER = """
import sys
from pathlib import Path
from quick_study import run_study
from pipeline.cluster import ray_cluster
from pipeline.config.loading import load
from pipeline.errors import PuddleError
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store

settings, root = load(Settings, Path(sys.argv[1])), Path(sys.argv[2])
try:
    store = Store.open(root, create=True)
    run_study(settings, store, stages=STAGES[:-1], open_cluster=lambda: ray_cluster(n_workers=2))
except PuddleError as error:
    sys.exit(f"stopped: {error}")
"""
"""`puddle study --workers 2` without MLflow and without the report, whose page contains the time."""


def serially(store: Path) -> dict[str, str]:
    """Run a study to its end in this process; return the digests of its files, except manifests."""
    run_study(STUDY, Store.open(store, create=True), stages=STAGES[:-1])
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
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
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
        sentences = ("Ray on this machine died", "Ray did not start on this machine", "Failed to connect to GCS")
        assert any(sentence in said for sentence in sentences), said  # the last is Ray's own, while it starts
    return driver.returncode == 0


@pytest.mark.timeout(3600)
def test_kill_9_at_random_moments(torture, tmp_path):
    settings = tmp_path / "kills.yaml"
    settings.write_text(STUDY.model_dump_json())
    undisturbed = serially(tmp_path / "undisturbed")
    store, committed, number = tmp_path / "0", {}, 0
    for number, rng in enumerate(torture.attempts(1, 200)):
        ended = drive_and_kill(settings, store, VICTIMS[number % len(VICTIMS)], rng)
        now = manifests(store)
        assert {path: now.get(path) for path in committed} == committed
        committed = now
        if ended:
            assert serially(store) == undisturbed
            store, committed = tmp_path / str(number + 1), {}
    assert serially(store) == undisturbed
