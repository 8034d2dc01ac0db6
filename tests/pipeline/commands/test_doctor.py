"""`puddle doctor` as a person uses it, on a store with a study that is done."""

import contextlib
import errno
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import call
from small_study import ON_DRY_LAND

from pipeline.cluster import Done, TaskFailed, Ticket
from pipeline.commands import doctor
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.store.store import Store


@pytest.fixture
def store(options) -> Store:
    return Store.open(Path(options[-1]), create=False)


def verdicts(store: Path, **execution) -> dict[str, doctor.Finding]:
    settings = parse(Settings, ON_DRY_LAND, name="tiny")
    return {
        finding.what: finding for finding in doctor.examine(settings, store, n_workers=execution.get("n_workers", 0))
    }


def test_the_doctor_examines_a_machine_on_which_the_tests_run(options, capsys):
    assert call("doctor", "--workers", "0", *options) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith(("ok ", "warn ", "      ")) for line in lines)
    for what in ("python", "versions", "processor", "memory", "disk", "store", "temporary", "loopback", "engine"):
        assert any(what in line for line in lines), what


def test_the_doctor_finds_what_is_wrong(store, tmp_path, monkeypatch):
    monkeypatch.setattr(doctor, "SPARE_BYTES", 1e18)
    monkeypatch.setattr(doctor, "BYTES_PER_WORKER", 1e15)
    monkeypatch.setenv("RAY_ADDRESS", "head:6379")
    constraints = tmp_path / "constraints.txt"
    constraints.write_text("numpy==0.1\nBox2D==2.3.10\n")
    monkeypatch.setattr(doctor, "CONSTRAINTS", constraints)
    monkeypatch.setattr(doctor, "_ray", lambda: doctor.Finding("ok", "ray", "not asked"))
    with store.lock_study("tiny"):
        found = verdicts(store.root, n_workers=1)
    assert found["disk"].verdict == "fail" and "puddle gc" in found["disk"].advice
    assert found["memory"].verdict == "fail" and "--workers 0" in found["memory"].advice
    assert found["versions"].verdict == "warn" and "numpy" in found["versions"].found
    assert found["ports"].verdict == "warn" and "RAY_ADDRESS=head:6379" in found["ports"].found
    assert "study tiny is driven by process" in found["store"].found


def test_the_doctor_refuses_a_disk_whose_locks_do_not_lock(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor.disk, "try_lock", lambda path: 0)
    assert verdicts(tmp_path)["store"].verdict == "fail"


def test_the_doctor_finds_a_store_that_may_not_be_written_to(store, tmp_path, monkeypatch):
    """Permissions alone would not keep root out."""

    def refuse(*, prefix: str, dir: Path) -> None:  # noqa: A002
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(dir / prefix))

    monkeypatch.setattr(doctor, "tempfile", SimpleNamespace(TemporaryDirectory=refuse))
    settings = parse(Settings, ON_DRY_LAND, name="tiny")
    for place, existing in ((store.root, store.root), (tmp_path / "new" / "store", tmp_path)):
        _, found = doctor._store(place, settings)
        assert (found.verdict, found.what) == ("fail", "store")
        assert found.found.startswith(f"{existing}: a file can't be kept there for good: ")
        assert "Permission denied" in found.found and "permission to write: --store" in found.advice


@contextlib.contextmanager
def as_nobody() -> Iterator[None]:
    """Be nobody for a moment: nothing keeps root out."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_the_doctor_says_where_it_may_not_look(tmp_path):
    closed = tmp_path / "closed"
    closed.mkdir(mode=0)
    with as_nobody():
        (found,) = doctor._store(closed / "store", parse(Settings, ON_DRY_LAND, name="tiny"))
    closed.chmod(0o700)
    assert (found.verdict, found.what) == ("fail", "store")
    assert found.found.startswith(f"{closed / 'store'}: looking for the store's disk failed: Permission denied")
    assert "choose another place" in found.found


def test_the_doctor_asks_for_no_room_for_what_is_kept_already(store, tmp_path, monkeypatch):
    """A disk with half of the room that a study takes in all holds the rest of one that is nearly done."""
    settings = parse(Settings, ON_DRY_LAND, name="tiny")
    free = int(doctor.SPARE_BYTES + doctor.bytes_left_of_study(settings, {}) / 2)
    monkeypatch.setattr(doctor, "shutil", SimpleNamespace(disk_usage=lambda path: SimpleNamespace(free=free)))

    def disk_of(root: Path) -> doctor.Finding:
        return next(found for found in doctor._store(root, settings) if found.what == "disk")

    assert disk_of(tmp_path / "new").verdict == "fail"
    assert disk_of(store.root).verdict == "ok"
    for key in store.keys("report"):  # the page: most of so small a study
        store.discard("report", key)
    assert disk_of(store.root).verdict == "fail"


@pytest.mark.parametrize(
    ("done", "verdict"),
    [
        ((Ticket(0, "getpid"), Done(7)), "ok"),
        ((Ticket(0, "getpid"), TaskFailed("getpid", "WorkerCrashedError: it died", "", True)), "fail"),
        (None, "fail"),
    ],
)
def test_the_doctor_says_that_ray_is_well_where_it_worked(monkeypatch, done, verdict):
    @contextlib.contextmanager
    def cluster(*_, **__):
        yield SimpleNamespace(submit=lambda function: None, next_done=lambda timeout: done)

    monkeypatch.setattr(doctor, "ray_cluster", cluster)
    found = doctor._ray()
    assert (found.verdict, found.what) == (verdict, "ray")
    assert ("it died" in found.found) == (done is not None and isinstance(done[1], TaskFailed))


def test_the_doctor_judges_memory_by_what_is_free_in_the_container(monkeypatch):
    monkeypatch.setattr(doctor, "free_memory", lambda: 2 * 10**9)
    found = doctor._memory(8)
    assert found.verdict == "fail" and "2.0 GB free" in found.found and "--workers 2" in found.advice
    assert doctor._memory(2).verdict == "ok"


def test_the_doctor_finds_that_a_port_is_taken(monkeypatch):
    for name in ("RAY_ADDRESS", "MLFLOW_TRACKING_URI"):
        monkeypatch.delenv(name, raising=False)
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):  # somebody has it already: so much the better
            taken.bind(("127.0.0.1", 5000))
            taken.listen()
        found = doctor._loopback()
    assert (found.verdict, found.what) == ("warn", "ports")
    assert "5000 is taken" in found.found and "--port" in found.advice
