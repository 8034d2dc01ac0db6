"""Shared by all tests: temporary folders in memory, one Ray cluster per session, a robot, and the torture options.

A torture test takes the fixture ``torture`` and loops over ``torture.attempts(small, large)``: a small number of
attempts in `make test`, a large one with ``--torture`` (`make torture`), where ``--minutes`` bounds each test.
"""

import gc
import os
import secrets
import shutil
import time
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from database_template import copied_databases

from pipeline.cluster import Cluster, ray_cluster, serial_cluster
from pipeline.cluster.on_ray import LOCAL_ENVIRONMENT
from pipeline.store.store import Store
from tasks.design import N_LINKS, Designs

hypothesis.settings.register_profile("puddle", deadline=None, max_examples=50)  # an example may compile a kernel
hypothesis.settings.load_profile("puddle")

os.environ.update(LOCAL_ENVIRONMENT)  # ray reads it on import, which a test may do before the first cluster

MEMORY = Path("/dev/shm")
ROOM_BYTES = 4e9  # required in memory: ten times what the tests write, and Ray's shared memory


@pytest.fixture(scope="session", autouse=True)
def empty_databases(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Spare MLflow the making of a database per store, but in tests/pipeline/mlflow."""
    with copied_databases(tmp_path_factory.mktemp("empty-database")):
        yield


@pytest.fixture(scope="session")
def local_ray() -> Iterator[Cluster]:
    """A Ray cluster of two cores. Tests that share it leave nothing running on it."""
    with ray_cluster(n_workers=2) as cluster:
        yield cluster


@pytest.fixture(scope="session")
def serial_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Store, dict[str, Any]]:
    """A store with the study of one trial, computed in this process, and the results of each stage."""
    from small_study import one_trial, run  # all stages: the process that only starts others need not load them

    store = Store.open(tmp_path_factory.mktemp("serial") / "store", create=True)
    with serial_cluster() as cluster:
        return store, run(one_trial(), store, cluster)


@pytest.fixture(scope="session")
def crane() -> Designs:
    """A design of the physical variant that is easy to compute by hand: links of 2 m, 140 × 35 mm on the bench.

    Part 1 is a cross at the origin (links 0, 1). At its top is joint 2: link 2 goes on upward and link 3 from its end
    to the right (part 2). At its right is joint 4: link 4 goes on to the right and link 5 from its end down (part 3).
    """
    return Designs(
        length_scale=np.full((1, N_LINKS), 2.0),
        parent=np.array([[-1, 0, 0, 2, 1, 4]]),
        parent_attachment=np.array([[0.0, 0.0, 1.0, 1.0, 1.0, 1.0]]),
        child_attachment=np.array([[0.0, 0.0, -1.0, -1.0, -1.0, -1.0]]),
        rest_angle=np.array([[0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, -np.pi / 2]]),
        phase=np.array([[0.0, 0.0, 0.0, 0.0, 1.0, 0.0]]),
        motion_range=np.array([[0.0, 0.2, 0.5, 0.2, 0.8, 0.2]]),
        motor_on=np.array([[False, False, True, False, True, False]]),
        frequency=np.array([0.2]),
    )


@pytest.fixture(scope="session")
def kit(crane: Designs) -> Any:
    """Its kit."""
    from tasks.bench.fabrication.kit import build_kit  # CAD takes seconds to load
    from tasks.bench.fabrication.kit_settings import KitSettings

    return build_kit(crane, KitSettings())


class Torture:
    """The attempts of a torture test and their random generators; a failure shows how to repeat it."""

    def __init__(self, config: pytest.Config, name: str) -> None:
        self.large, self._seed, self._name = config.getoption("--torture"), config.getoption("--seed"), name
        self._end = time.monotonic() + 60 * config.getoption("--minutes") if self.large else np.inf

    def rng(self, *attempt: int) -> np.random.Generator:
        """Return the generator of an attempt, or one of the test."""
        return np.random.default_rng([self._seed, zlib.crc32(self._name.encode()), *attempt])

    def attempts(self, small: int, large: int) -> Iterator[np.random.Generator]:
        """Yield the generator of each attempt, until the time is up."""
        for attempt in range(large if self.large else small):
            if attempt and time.monotonic() > self._end:
                return
            print(f"attempt {attempt}; again: pytest --seed {self._seed}{' --torture' * self.large} '{self._name}'")
            yield self.rng(attempt)


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("torture")
    group.addoption("--torture", action="store_true", help="make many attempts in each torture test")
    group.addoption("--minutes", type=float, default=5.0, help="time limit of each test with --torture (default: 5)")
    group.addoption("--seed", type=int, default=secrets.randbits(32), help="seed of the torture tests")


def pytest_configure() -> None:
    """Have pytest make its temporary folders in memory if there is room.

    On a disk the tests wait for thousands of flushes of milliseconds each: one per file of a store and per statement
    that makes a database. That the flushes are needed is tested with tests/torture/crash_consistency_disk.py.
    """
    if MEMORY.is_dir() and shutil.disk_usage(MEMORY).free > ROOM_BYTES:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))
    gc.set_threshold(20_000)  # as in pipeline/__main__.py


@pytest.fixture
def torture(request: pytest.FixtureRequest) -> Torture:
    return Torture(request.config, request.node.nodeid)


def pytest_collection_finish() -> None:
    gc.freeze()  # modules and tests stay: a collection need not look at a million objects each time


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the slow files, so that no process of pytest-xdist, which runs whole files, ends alone with one."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)
    for item in items if config.getoption("--torture") else ():
        item.add_marker(pytest.mark.timeout(60 * config.getoption("--minutes") + 600))


def pytest_unconfigure(config: pytest.Config) -> None:
    """Name, in the last line, what was skipped for want of a program or a privilege."""
    terminal = config.pluginmanager.get_plugin("terminalreporter")
    if terminal is None:
        return
    reasons = Counter(str(report.longrepr[2]) for report in terminal.stats.get("skipped", []))
    lacking = {reason.removeprefix("Skipped: "): n for reason, n in reasons.items() if "--torture" not in reason}
    if lacking:
        terminal.line("skipped: " + "; ".join(f"{n} ({reason})" for reason, n in lacking.items()))
