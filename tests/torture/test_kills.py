"""kill -9 at random moments, of a worker, the driver, the raylet or the GCS: the study ends in the same bytes.

The processes are real: drivers with their own Ray, one after the other on the same store. Each loses some workers or
none, and then dies itself or loses its raylet or its GCS. When a study ends its bytes are compared, and the next study
begins. A committed item is never computed again: no driver submits it, and its manifest is never written twice.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import pytest
import yaml
from fork_server import TINY, QuietTerminal, logged, run_study, submissions_of, tree

from pipeline.cluster import serial_cluster
from pipeline.config.loading import load
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store

HERE = Path(__file__).parent
VICTIMS = ["worker", "worker", "raylet", "driver", "worker", "worker", "gcs_server"]
"""Processes to kill, in turn; `make test` stops at the driver. A worker is replaced by another; the death of any other
ends the run."""
IDLE = "ray::IDLE"
"""Name of a worker without work; a busy worker has the name of its work item."""
SECONDS_BEFORE_IDLE = 0.5
"""Time after which an idle worker may be killed, too."""
PATIENCE = 600.0
"""Longest time for a driver to notice that its cluster is dead, on a busy machine [s]."""
ALL_BUT_REPORT = STAGES[:-1]
"""All stages but the report, whose page contains the time and the version of the code."""

STUDY = TINY | {
    "grid": {"depths": [1.0], "environments": ["dry_land"], "single_member_depths": [], "n_trials": 6},
    "rollout": {"n_settle": 5, "n_measure": 100},
    "evolution": {"n_generations": 10, "afpo": {"population_size": 6}},
}
"""A study of about sixty work items of up to 0.1 s."""

DRIVER = """
import sys
from pathlib import Path
from fork_server import QuietTerminal, logged, run_study
from pipeline.cluster import ray_cluster
from pipeline.config.loading import load
from pipeline.errors import PuddleError
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store

settings, root = load(Settings, Path(sys.argv[1])), Path(sys.argv[2])
on_ray = lambda: logged(ray_cluster("local", 2), root)
try:
    store = Store.open(root, create=True)
    run_study(settings, store, QuietTerminal([]), stages=STAGES[:-1], open_cluster=on_ray)
except PuddleError as error:
    sys.exit(f"stopped: {error}")
"""
"""`puddle study --workers 2` without the report and without MLflow, which takes as long as all the rest."""


@pytest.fixture(scope="module")
def settings(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("settings") / "kills.yaml"
    path.write_text(yaml.safe_dump(STUDY))
    return path


def serially(settings: Path, store: Path) -> dict[str, str]:
    """Run a study to its end in this process; return the digests of its files, except manifests."""
    run_study(
        load(Settings, settings),
        Store.open(store, create=True),
        QuietTerminal([]),
        stages=ALL_BUT_REPORT,
        open_cluster=lambda: logged(serial_cluster(), store),
    )
    return {
        path: sha256
        for path, sha256 in tree(store).items()
        if path.startswith("items/") and not path.endswith("manifest.json")
    }


@dataclass
class Killed:
    """A study in a store, and the driver that runs it."""

    settings: Path
    store: Path
    driver: subprocess.Popen[str] | None = None
    committed: dict[Path, int] = field(default_factory=dict)
    """Time of each manifest."""
    submitted: list[str] = field(default_factory=list)
    """Keys of the work items that its drivers submitted, repeated if one died before the commit."""
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
        """Wait for a process of the driver, preferring busy workers; None if the driver ends."""
        deadline, idle_allowed = time.monotonic() + PATIENCE, time.monotonic() + SECONDS_BEFORE_IDLE
        while self.driver.poll() is None:
            assert time.monotonic() < deadline, f"no {victim}"
            with contextlib.suppress(psutil.Error):
                found = {process: process.name() for process in self.processes(victim)}
                at_work = [process for process, name in found.items() if name != IDLE]
                if at_work or (found and time.monotonic() > idle_allowed):
                    return next(iter(at_work or found))
            time.sleep(0.1)  # a look at every process costs as much as a work item
        return None

    def processes(self, victim: str) -> list[psutil.Process]:
        """List the processes that can be killed now."""
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
        """Kill a process ``wait`` seconds after it appears, unless the run ends first; return its name."""
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
        """Wait for the end of a driver that lost a process; check its output and its store."""
        _, said = self.driver.communicate(timeout=PATIENCE)
        code, self.driver = self.driver.returncode, None
        assert "Traceback" not in said, said
        if victim == "driver":
            assert code == -9, said
        else:
            assert code == 0 or "Ray on this machine died" in said or "Ray did not start on this machine" in said, said
        assert victim != "worker" or code == 0, said
        self.ended = code == 0
        self.check_commits()

    def check_commits(self) -> None:
        now = {path: path.stat().st_mtime_ns for path in self.store.glob("items/*/*/*/manifest.json")}
        assert {path: now.get(path) for path in self.committed} == self.committed
        self.committed = now
        if submissions_of(self.store).exists():  # or no driver got that far
            lines = [line.split() for line in submissions_of(self.store).read_text().splitlines()]
            assert [key for key, was in lines if was != "missing"] == []
            self.submitted = [key for key, _ in lines]


@pytest.mark.timeout(3600)  # Ray starts for every few kills
def test_kill_9_at_random_moments(torture, settings, tmp_path):
    undisturbed = serially(settings, tmp_path / "undisturbed")
    n_studies, study = 0, Killed(settings, tmp_path / "0")

    def finish() -> Killed:
        """Run the study to its end, compare its bytes, and begin another one."""
        assert serially(settings, study.store) == undisturbed
        study.check_commits()
        assert set(study.submitted) == {path.parent.name for path in study.committed}
        return Killed(settings, tmp_path / str(n_studies))

    try:
        for number, rng in enumerate(torture.attempts(4, 500)):
            victim = VICTIMS[number % len(VICTIMS)]
            mean = 3.0 if study.driver is None else 0.3
            while study.kill(victim, float(rng.exponential(mean))) is None:
                study.end(None)
                if study.ended:
                    n_studies += 1
                    study = finish()
            if victim != "worker":
                study.end(victim)
        if study.driver is not None:
            study.end("worker")
        finish()
    finally:
        if study.driver is not None:
            study.driver.kill()
            study.driver.communicate()
