"""`puddle doctor` on a machine where the tests run, and where something is wrong."""

import contextlib
import errno
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import call
from small_study import ON_DRY_LAND

from pipeline import kernels
from pipeline.cluster import Done, TaskFailed, Ticket
from pipeline.commands import examination
from pipeline.commands.examination import Check, examine_store
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.store.store import Store


@pytest.fixture
def store(options) -> Store:
    return Store.open(Path(options[-1]), create=False)


def examined(store: Path, n_workers: int = 0) -> dict[str, Check]:
    settings = parse(Settings, ON_DRY_LAND, name="tiny")
    return {check.what: check for check in examination.examine(settings, store, n_workers=n_workers)}


def test_checks_as_json(options, capsys, monkeypatch):
    found = [Check("ok", "disk", "1 GB free"), Check("fail", "ray", "no answer", "Use --workers 0.")]
    monkeypatch.setattr(examination, "examine", lambda settings, store, *, n_workers: iter(found))
    assert call("doctor", "--json", *options) == 1
    said = json.loads(capsys.readouterr().out)
    assert not said["ok"] and said["checks"][1] == {
        "verdict": "fail",
        "what": "ray",
        "found": "no answer",
        "advice": "Use --workers 0.",
    }


def test_every_check_passes_where_the_tests_run(options, capsys):
    assert call("doctor", "--workers", "0", *options) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith(("ok ", "warn ", "      ")) for line in lines)
    for what in (
        "python",
        "versions",
        "processor",
        "memory",
        "disk",
        "store",
        "temporary",
        "loopback",
        "kernels",
        "engine",
    ):
        assert any(what in line for line in lines), what


def test_problems_are_found(store, tmp_path, monkeypatch):
    monkeypatch.setattr(examination, "_SPARE_BYTES", 1e18)
    monkeypatch.setattr(examination, "_BYTES_PER_WORKER", 1e15)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://head:5000")
    constraints = tmp_path / "constraints.txt"
    constraints.write_text("numpy==0.1\nBox2D==2.3.10\n")
    monkeypatch.setattr(examination, "_CONSTRAINTS", constraints)
    monkeypatch.setattr(examination, "_ray", lambda: Check("ok", "ray", "not asked"))
    for key in store.keys("report"):  # a study that is done needs no space
        store.discard("report", key)
    with store.lock_study("tiny"):
        found = examined(store.root, n_workers=1)
    assert found["disk"].verdict == "fail" and "puddle gc" in found["disk"].advice
    assert found["memory"].verdict == "fail" and "--workers 0" in found["memory"].advice
    assert found["versions"].verdict == "warn" and "numpy" in found["versions"].found
    assert found["ports"].verdict == "warn" and "MLFLOW_TRACKING_URI=http://head:5000" in found["ports"].found
    assert "study tiny is driven by process" in found["store"].found


def doubled(x):
    return 2 * x


def test_damaged_kernels_are_reported(store, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    kernels.cache_folder.cache_clear()
    assert examined(store.root)["kernels"].found.startswith(f"none compiled yet in {tmp_path}")
    kernels.cache_folder().mkdir()
    (kernels.cache_folder() / "some.nbi").write_bytes(b"not listed")
    found = examined(store.root)["kernels"]
    assert found.verdict == "warn" and found.found.endswith(", damaged")
    kernels.cache_folder.cache_clear()


def test_a_disk_without_working_locks_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(examination.disk, "try_lock", lambda path: 0)
    assert examined(tmp_path)["store"].verdict == "fail"


def test_a_store_without_write_permission_fails(store, tmp_path, monkeypatch):
    """The error is injected: permissions do not stop root."""

    def refuse(*, prefix: str, dir: Path) -> None:  # noqa: A002
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(dir / prefix))

    monkeypatch.setattr(examination, "tempfile", SimpleNamespace(TemporaryDirectory=refuse))
    settings = parse(Settings, ON_DRY_LAND, name="tiny")
    for place, existing in ((store.root, store.root), (tmp_path / "new" / "store", tmp_path)):
        _, found = examine_store(place, settings)
        assert (found.verdict, found.what) == ("fail", "store")
        assert found.found.startswith(f"{existing}: a file can't be committed there: ")
        assert "Permission denied" in found.found and "permission to write: --store" in found.advice


@contextlib.contextmanager
def as_unprivileged() -> Iterator[None]:
    """Drop root's rights for a moment: permissions do not stop root."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_an_unreadable_folder_is_named(tmp_path):
    closed = tmp_path / "closed"
    closed.mkdir(mode=0)
    with as_unprivileged():
        (found,) = examine_store(closed / "store", parse(Settings, ON_DRY_LAND, name="tiny"))
    closed.chmod(0o700)
    assert (found.verdict, found.what) == ("fail", "store")
    assert found.found.startswith(f"{closed / 'store'}: looking for the store's disk failed: Permission denied")
    assert "choose another folder" in found.found


def test_finished_work_needs_no_disk_space(store, tmp_path):
    """Half of the space that a whole study needs is enough for the rest of one that is nearly done."""
    settings = parse(Settings, ON_DRY_LAND, name="tiny")
    free = int(examination._SPARE_BYTES + sum(one.n_bytes for one in examination.forecast_stages(settings)) / 2)

    def disk_of(root: Path) -> Check:
        found = examine_store(root, settings, free_bytes=lambda folder: free)
        return next(check for check in found if check.what == "disk")

    assert disk_of(tmp_path / "new").verdict == "fail"
    assert disk_of(store.root).verdict == "ok"
    free = 0
    assert disk_of(store.root).verdict == "ok" and disk_of(store.root).found.endswith("study tiny is done")
    for key in store.keys("report"):  # the page: most of such a small study
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
def test_ray_passes_if_a_worker_answers(done, verdict):
    @contextlib.contextmanager
    def cluster(*_, **__):
        yield SimpleNamespace(submit=lambda function: None, next_done=lambda timeout: done)

    found = examination._ray(cluster)
    assert (found.verdict, found.what) == (verdict, "ray")
    assert ("it died" in found.found) == (done is not None and isinstance(done[1], TaskFailed))


def test_memory_limits_the_number_of_workers():
    found = examination._memory(8, free=2e9)
    assert found.verdict == "fail" and "2.0 GB free" in found.found and "--workers 2" in found.advice
    assert examination._memory(2, free=2e9).verdict == "ok"


def test_a_limited_address_space_is_named(monkeypatch):
    """Under `ulimit -v` libraries can't be loaded, or end the process."""
    limited = SimpleNamespace(RLIMIT_AS=0, RLIM_INFINITY=-1, getrlimit=lambda what: (4_000_000 * 1024, -1))
    monkeypatch.setattr(examination, "resource", limited)
    found = examination._memory(2, free=20e9)
    assert found.verdict == "fail" and "4.1 GB" in found.found and "ulimit -v" in found.advice


def test_a_processor_with_other_low_bits_is_a_warning(monkeypatch):
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0))
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: {"avx2": True, "fma": True})
    assert examination._processor(8, 2).verdict == "ok"
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: {"sse4.2": True})
    found = examination._processor(8, 2)
    assert found.verdict == "warn" and "use one kind for a study" in found.advice


def test_a_taken_port_is_a_warning(monkeypatch):
    for name in ("RAY_ADDRESS", "MLFLOW_TRACKING_URI"):
        monkeypatch.delenv(name, raising=False)
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):  # another process has it already, which serves as well
            taken.bind(("127.0.0.1", 5000))
            taken.listen()
        found = examination._loopback()
    assert (found.verdict, found.what) == ("warn", "ports")
    assert "5000 is taken" in found.found and "--port" in found.advice
