"""Shared by all tests: temporary folders in memory, one Ray cluster per session, a robot, and the torture options.

A torture test takes the fixture ``torture`` and loops over ``torture.attempts(small, large)``: a small number of
attempts in `make test`, a large one with ``--torture`` (`make torture`), where ``--minutes`` bounds the whole run. Each
attempt has its own generator, seeded by ``--seed``, the test and the attempt's number, so that every failure can be
reproduced with the seed that the table at the end shows.
"""

import gc
import os
import secrets
import shutil
import time
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from database_template import copied_databases

from pipeline.cluster import Cluster, ray_cluster
from tasks.design import N_LINKS, Designs

hypothesis.settings.register_profile("puddle", deadline=None)  # an example may compile a kernel, or wait for a core
hypothesis.settings.load_profile("puddle")

MEMORY = Path("/dev/shm")
ROOM_BYTES = 4e9
"""Room required in memory: ten times what the tests write, and Ray's shared memory."""

TOGETHER = {
    "local_ray": (
        "cluster/test_cluster.py",
        "workflow/test_study.py",
        "workflow/test_dispatcher.py",
        "torture/test_order.py",
    ),
    "fork_server": (
        "torture/test_processes.py",
        "torture/test_crash_points.py",
        "torture/test_corruption.py",
        "torture/test_full_disk.py",
    ),
    "study": (
        "commands/test_bad_input.py",
        "commands/test_by_name.py",
        "commands/test_compare_run.py",
        "commands/test_doctor.py",
        "commands/test_exit_codes.py",
        "commands/test_forecast.py",
        "commands/test_gc.py",
        "commands/test_recompute.py",
        "commands/test_score.py",
        "commands/test_status.py",
        "commands/test_verify.py",
        "fabrication/test_source.py",
        "results/test_export_folder.py",
        "results/test_notebook.py",
        "results/test_recorded_study.py",
        "results/test_results_file.py",
        "stages/test_analyse.py",
        "stages/test_pontoon.py",
        "stages/test_report.py",
        "stages/test_stages.py",
    ),
    "drawn": (
        "report/test_browser.py",
        "report/test_column_figures.py",
        "report/test_data.py",
        "report/test_figures.py",
        "report/test_page.py",
        "report/test_transfer_latex.py",
    ),
}
"""Files that one process runs, by an expensive fixture that they share."""

LONGEST_FIRST = (
    *TOGETHER["local_ray"],
    *TOGETHER["fork_server"],
    *TOGETHER["study"],
    "tracking/test_pages.py",
    "torture/test_kills.py",
    "cluster/test_slurm.py",
    "parity/test_batch_equals_pybox2d.py",
    "parity/test_bodies_equal_pybox2d.py",
    "fabrication/test_fabricate.py",
    "architecture/test_changes.py",
    "commands/test_app.py",
    *TOGETHER["drawn"],
    "fabrication/test_exports.py",
    "tracking/test_mirror.py",
    "architecture/test_wheel.py",
    "fabrication/test_findings.py",
    "networks/test_coupled.py",
    "tasks/test_compiled.py",
    "cluster/test_session.py",
    "fabrication/test_servos.py",
    "report/test_films.py",
    "tracking/test_server.py",
)
"""The slowest files run first, so that no process is left with one of them at the end."""


def write_to_memory() -> None:
    """Have pytest make its temporary folders in memory if there is room.

    On a disk the tests wait for thousands of flushes of milliseconds each: one per file of a store and per statement
    that makes a database. That the flushes are needed is tested with tests/torture/crash_consistency_disk.py.
    """
    if MEMORY.is_dir() and shutil.disk_usage(MEMORY).free > ROOM_BYTES:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))


@pytest.fixture(scope="session", autouse=True)
def empty_databases(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Spare MLflow the making of a database per store, but in tests/pipeline/tracking."""
    with copied_databases(tmp_path_factory.mktemp("empty-database")):
        yield


@pytest.fixture(scope="session")
def local_ray() -> Iterator[Cluster]:
    """A Ray cluster of two cores. Tests that share it leave nothing running on it."""
    with ray_cluster("local", n_workers=2) as cluster:
        yield cluster


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


# -- torture ---------------------------------------------------------------------------------------------------------


@dataclass
class Row:
    """A test in the table at the end."""

    name: str
    attempt: int = -1
    """Number of the current or last attempt."""
    n_planned: int = 0
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0
    outcome: str = "interrupted"


@dataclass
class Session:
    """The torture options and records of one pytest session."""

    large: bool
    seed: int
    end: float
    """Time at which the session should end, on the monotonic clock [s]."""
    shares_left: float = 0.0
    """Shares of the tests that have not ended."""
    rows: dict[str, Row] = field(default_factory=dict)


_SESSION = pytest.StashKey[Session]()
_ROW = "torture"
_SHOWN: dict[str, Row] = {}
"""Rows of the table at the end, by the name of the test."""


class Torture:
    """The number of attempts of a test, their random generators, and its notes for the table."""

    def __init__(self, session: Session, row: Row, share: float) -> None:
        self.large, self.seed = session.large, session.seed
        self._row = row
        now = time.monotonic()
        self._end = now + (session.end - now) * share / session.shares_left if session.large else np.inf

    def attempts(self, small: int, large: int) -> Iterator[np.random.Generator]:
        """Yield the generator of each attempt; with --torture, stop when the share of the time is used up.

        Time that the test leaves unused goes to the tests after it.
        """
        self._row.n_planned = large if self.large else small
        for attempt in range(self._row.n_planned):
            if attempt and time.monotonic() > self._end:
                return
            self._row.attempt = attempt
            yield np.random.default_rng([self.seed, zlib.crc32(self._row.name.encode()), attempt])

    def times(self, small: int, large: int) -> int:
        """Return a number of attempts, which are all made regardless of the time."""
        self._row.n_planned = large if self.large else small
        self._row.attempt = self._row.n_planned - 1
        return self._row.n_planned

    def rng(self) -> np.random.Generator:
        """Return a generator of the test, apart from those of its attempts."""
        return np.random.default_rng([self.seed, zlib.crc32(self._row.name.encode())])

    def note(self, words: str) -> None:
        """Add a line to the table."""
        self._row.notes.append(words)


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("torture")
    group.addoption("--torture", action="store_true", help="make many attempts in each torture test")
    group.addoption("--minutes", type=float, default=60.0, help="time limit of --torture (default: 60)")
    group.addoption(
        "--seed", type=int, default=None, help="seed of the torture tests (default: a random one, which is shown)"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "share(n): share of the time of --torture; the default is 1")
    seed = getattr(config, "workerinput", {}).get("torture_seed", config.getoption("--seed"))
    config.stash[_SESSION] = Session(
        large=config.getoption("--torture"),
        seed=secrets.randbits(32) if seed is None else seed,
        end=time.monotonic() + 60 * config.getoption("--minutes"),
    )
    write_to_memory()
    gc.set_threshold(20_000)  # as in pipeline/__main__.py


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Give the processes of pytest-xdist the same seed."""
    node.workerinput["torture_seed"] = node.config.stash[_SESSION].seed


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give files that share an expensive fixture to one process of pytest-xdist, and every other file to any."""
    from xdist.scheduler import LoadFileScheduling

    class ByFixture(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return next((fixture for fixture, files in TOGETHER.items() if file.endswith(files)), file)

    return ByFixture(config, log) if config.getoption("dist") == "loadfile" else None


def pytest_collection_finish() -> None:
    gc.freeze()  # modules and tests stay: a collection need not look at a million objects each time


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    order = {file: number for number, file in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: order.get("/".join(item.path.parts[-2:]), len(order)))
    session = config.stash[_SESSION]
    tests = [item for item in items if "torture" in getattr(item, "fixturenames", ())]
    session.shares_left = sum(map(_share, tests))
    if session.large:
        items.sort(key=_share)  # long tests use the time that short ones leave
        for item in tests:
            item.add_marker(pytest.mark.timeout(60 * config.getoption("--minutes") + 300))


def _share(item: pytest.Item) -> float:
    marker = item.get_closest_marker("share")
    return float(marker.args[0]) if marker else 1.0


@pytest.fixture
def torture(request: pytest.FixtureRequest) -> Iterator[Torture]:
    session = request.config.stash[_SESSION]
    row = session.rows.setdefault(request.node.nodeid, Row(request.node.nodeid))
    start, share = time.monotonic(), _share(request.node)
    yield Torture(session, row, share)
    row.seconds = time.monotonic() - start
    session.shares_left -= share


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]):
    report = yield
    session = item.config.stash[_SESSION]
    row = session.rows.get(item.nodeid)
    if row is not None and report.when == "call":
        row.outcome = report.outcome
        if report.failed:
            again = f"--seed {session.seed}{' --torture' if session.large else ''}"
            report.sections.append(("torture", f"attempt {row.attempt} (from 0); again: pytest {again} '{row.name}'"))
        if report.skipped and isinstance(report.longrepr, tuple):
            row.attempt = -1
            row.notes.append(report.longrepr[2].removeprefix("Skipped: "))
    if row is not None and report.when == "teardown":
        report.user_properties.append((_ROW, asdict(row)))
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Collect a row, possibly from another process."""
    for name, row in report.user_properties:
        if name == _ROW:
            _SHOWN[row["name"]] = Row(**row)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    session = config.stash[_SESSION]
    if not _SHOWN:
        return
    terminalreporter.section(f"torture, seed {session.seed}")
    for row in _SHOWN.values():
        file, _, test = row.name.partition("::")
        n_tried = row.attempt + 1
        tried = f"{n_tried:,}" if n_tried >= row.n_planned else f"{n_tried:,} of {row.n_planned:,}"
        outcome = "time was up" if row.outcome == "passed" and n_tried < row.n_planned else row.outcome
        what = f"{file.rpartition('/')[2].removeprefix('test_').removesuffix('.py')}: {test.removeprefix('test_')}"
        terminalreporter.line(f"{what.replace('_', ' '):<84} {tried:>15} {row.seconds:6.0f} s  {outcome}")
        for note in row.notes:
            terminalreporter.line(f"    {note}")
