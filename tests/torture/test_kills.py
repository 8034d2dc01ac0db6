"""kill -9 at random moments: a worker, the driver, the raylet, the GCS. The study ends in the same bytes.

Real processes: drivers with a Ray of their own, one after the other on the same store. Each loses some workers or none,
then itself, its raylet or its GCS; a study that comes to its end is compared, and the next one begins. No item that was
committed is ever computed again: no driver submits it, and its manifest is never written twice.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import pytest
import yaml
from nursery import TINY, Quiet, noted, run_study, submitted_to, tree

from pipeline.cluster import serial_cluster
from pipeline.config.loading import load
from pipeline.config.settings import Settings
from pipeline.stages import STAGES

HERE = Path(__file__).parent
VICTIMS = ["worker", "worker", "raylet", "driver", "worker", "worker", "gcs_server"]
"""In turn. The worker's place is taken by another; with the others, the run is over."""
IDLE = "ray::IDLE"
"""Name of a worker without a piece; of one with, it is the piece's."""
PATIENCE_WITH_IDLE = 0.5
"""Seconds that pass before a worker without a piece is killed, too."""
PATIENCE = 600.0
"""Seconds that a driver has to notice that its cluster is dead, on a machine that has much else to do."""
ALL_BUT_THE_PAGE = STAGES[:-1]
"""The page says which code made it, and when."""

STUDY = TINY | {
    "grid": {"depths": [1.0], "environments": ["dry_land"], "single_member_depths": [], "n_trials": 6},
    "rollout": {"n_settle": 5, "n_measure": 200},
    "evolution": {"n_generations": 10, "afpo": {"population_size": 6}},
}
"""Some sixty pieces of up to a tenth of a second."""

DRIVER = """
import sys
from pathlib import Path
from nursery import Quiet, noted, run_study
from pipeline.cluster import ray_cluster
from pipeline.config.loading import load
from pipeline.errors import PuddleError
from pipeline.config.settings import Settings
from pipeline.stages import STAGES

settings, store = load(Settings, Path(sys.argv[1])), Path(sys.argv[2])
on_ray = lambda: noted(ray_cluster("local", 2), store)
try:
    run_study(settings, store, Quiet([]), stages=STAGES[:-1], open_cluster=on_ray)
except PuddleError as error:
    sys.exit(f"stopped: {error}")
"""
"""`puddle study --workers 2`, but for the page and for MLflow, which costs as much as all the rest."""


@pytest.fixture(scope="module")
def settings(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("settings") / "kills.yaml"
    path.write_text(yaml.safe_dump(STUDY))
    return path


def serially(settings: Path, store: Path) -> dict[str, str]:
    """Bring a study to its end in this process; give the digests of its files, manifests apart."""
    run_study(
        load(Settings, settings),
        store,
        Quiet([]),
        stages=ALL_BUT_THE_PAGE,
        open_cluster=lambda: noted(serial_cluster(), store),
    )
    return {
        path: sha256
        for path, sha256 in tree(store).items()
        if path.startswith("items/") and not path.endswith("manifest.json")
    }


@dataclass
class Killed:
    """A study in a store, and the driver that is at it."""

    settings: Path
    store: Path
    driver: subprocess.Popen[str] | None = None
    kept: dict[Path, int] = field(default_factory=dict)
    """When each manifest was written."""
    submitted: list[str] = field(default_factory=list)
    """Keys of the pieces that its drivers submitted, again where one died before it was kept."""
    ended: bool = False

    def start(self) -> None:
        self.driver = subprocess.Popen(
            [sys.executable, "-c", DRIVER, str(self.settings), str(self.store)],
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": f"{HERE}{os.pathsep}{HERE.parents[1]}"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )

    def find(self, victim: str) -> psutil.Process | None:
        """Wait for a process of the driver's, a worker with a piece before an idle one; None where the driver ends."""
        deadline, idle_will_do = time.monotonic() + PATIENCE, time.monotonic() + PATIENCE_WITH_IDLE
        while self.driver.poll() is None:
            assert time.monotonic() < deadline, f"no {victim}"
            with contextlib.suppress(psutil.Error):
                found = {process: process.name() for process in self.processes(victim)}
                at_work = [process for process, name in found.items() if name != IDLE]
                if at_work or (found and time.monotonic() > idle_will_do):
                    return next(iter(at_work or found))
            time.sleep(0.02)
        return None

    def processes(self, victim: str) -> list[psutil.Process]:
        """List what can be a victim just now."""
        driver = psutil.Process(self.driver.pid)
        if victim == "driver":
            return [driver]
        found = []
        for process in driver.children(recursive=True):
            with contextlib.suppress(psutil.Error):
                name = process.name()
                if name == victim or (victim == "worker" and name.startswith("ray::") and "Agent" not in name):
                    found.append(process)
        return found

    def kill(self, victim: str, wait: float) -> str | None:
        """Kill one, so many seconds after there is one, if the run lasts so long; return its name."""
        if self.driver is None:
            self.start()
        while self.find(victim) is not None:
            time.sleep(wait)
            if (prey := self.find(victim)) is not None:
                with contextlib.suppress(psutil.NoSuchProcess):
                    name = prey.name()
                    prey.kill()
                    return name
        return None

    def end(self, victim: str | None) -> None:
        """Wait for the end of the driver, who lost something; look at what it said and left."""
        _, said = self.driver.communicate(timeout=PATIENCE)
        code, self.driver = self.driver.returncode, None
        assert "Traceback" not in said, said
        if victim == "driver":
            assert code == -9, said
        else:
            assert code == 0 or "Ray on this machine died" in said or "Ray did not start on this machine" in said, said
        assert victim != "worker" or code == 0, said
        self.ended = code == 0
        self.look()

    def look(self) -> None:
        now = {path: path.stat().st_mtime_ns for path in self.store.glob("items/*/*/*/manifest.json")}
        assert {path: now.get(path) for path in self.kept} == self.kept
        self.kept = now
        if submitted_to(self.store).exists():  # or no driver came so far
            lines = [line.split() for line in submitted_to(self.store).read_text().splitlines()]
            assert [key for key, was in lines if was != "missing"] == []
            self.submitted = [key for key, _ in lines]


@pytest.mark.share(30)
@pytest.mark.timeout(3600)  # Ray starts for every few kills
def test_kill_9_at_random_moments(torture, settings, tmp_path):
    undisturbed = serially(settings, tmp_path / "undisturbed")
    n_of, n_at_work, n_studies, n_again, study = Counter(), 0, 0, 0, Killed(settings, tmp_path / "0")

    def finish() -> Killed:
        """Bring the study to its end, compare, and begin another."""
        nonlocal n_again
        assert serially(settings, study.store) == undisturbed
        study.look()
        assert set(study.submitted) == {path.parent.name for path in study.kept}
        n_again += len(study.submitted) - len(study.kept)
        return Killed(settings, tmp_path / str(n_studies))

    try:
        for number, rng in enumerate(torture.attempts(20, 500)):
            victim = VICTIMS[number % len(VICTIMS)]
            mean = 3.0 if study.driver is None else 0.3
            while (name := study.kill(victim, float(rng.exponential(mean)))) is None:
                study.end(None)
                if study.ended:
                    n_studies += 1
                    study = finish()
            n_of[victim] += 1
            n_at_work += victim == "worker" and name != IDLE
            if victim != "worker":
                study.end(victim)
        if study.driver is not None:
            study.end("worker")
        finish()
    finally:
        if study.driver is not None:
            study.driver.kill()
            study.driver.communicate()
    killed = ", ".join(f"{victim} {number:,} times" for victim, number in n_of.items())
    torture.note(f"{killed}; {n_studies + 1} studies, the same bytes each time")
    torture.note(f"{n_at_work:,} of the workers had a piece")
    torture.note(f"{n_again:,} pieces submitted again, of which none had been kept; no item written twice")
