"""`puddle doctor` on a machine where the tests run, and where something is wrong."""

import contextlib
import errno
import json
import os
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
from command_line import call
from small_study import ON_DRY_LAND

from pipeline.cluster import Done, TaskFailed, Ticket
from pipeline.commands import examination
from pipeline.commands.examination import Check, examine_store
from pipeline.config.loading import parse
from pipeline.config.settings import Settings


def tiny() -> Settings:
    return parse(Settings, ON_DRY_LAND, name="tiny")


def test_every_check_passes_where_the_tests_run(options, capsys):
    assert call("doctor", "--workers", "0", *options) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith(("ok ", "warn ", "      ")) for line in lines)
    for what in ("versions", "processor", "memory", "disk", "store", "engine"):
        assert any(what in line for line in lines), what


def test_problems_are_found_and_named_in_json(store, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(examination, "_SPARE_BYTES", 1e18)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=2e9))  # enough for two workers
    constraints = tmp_path / "constraints.txt"
    constraints.write_text("numpy==0.1\nBox2D==2.3.10\n")
    monkeypatch.setattr(examination, "_CONSTRAINTS", constraints)
    monkeypatch.setattr(examination, "_ray", lambda: Check("ok", "ray", "not asked"))
    for key in store.keys("report"):  # a study that is done needs no space
        store.discard("report", key)
    with store.lock_study("tiny"):
        assert call("doctor", "tiny", "--store", str(store.root), "--workers", "8", "--json") == 1
    said = json.loads(capsys.readouterr().out)
    found = {check["what"]: check for check in said["checks"]}
    assert not said["ok"]
    assert found["disk"]["verdict"] == "fail" and "puddle gc" in found["disk"]["advice"]
    assert found["memory"]["verdict"] == "fail" and "--workers 2" in found["memory"]["advice"]
    assert found["versions"]["verdict"] == "warn" and "numpy" in found["versions"]["found"]
    assert "study tiny is driven by process" in found["store"]["found"]


def refuse(*, prefix: str, dir: Path) -> None:  # noqa: A002
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(dir / prefix))


def test_a_disk_without_working_locks_and_a_store_without_write_permission_fail(store, tmp_path, monkeypatch):
    """The error is injected: permissions do not stop root."""
    with monkeypatch.context() as briefly:
        briefly.setattr(examination.disk, "try_lock", lambda path: 0)
        assert [check.verdict for check in examine_store(tmp_path, tiny())] == ["ok", "fail"]
    monkeypatch.setattr(examination, "tempfile", SimpleNamespace(TemporaryDirectory=refuse))
    for place, existing in ((store.root, store.root), (tmp_path / "new" / "store", tmp_path)):
        _, found = examine_store(place, tiny())
        assert (found.verdict, found.what) == ("fail", "store")
        assert str(existing) in found.found and "Permission denied" in found.found and "--store" in found.advice


def test_finished_work_needs_no_disk_space(store, tmp_path):
    """Half of the space that a whole study needs is enough for the rest of one that is nearly done."""
    free = int(examination._SPARE_BYTES + sum(one.n_bytes for one in examination.forecast_stages(tiny())) / 2)

    def disk_of(root: Path) -> Check:
        found = examine_store(root, tiny(), free_bytes=lambda folder: free)
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
        ((Ticket(0, "getpid"), TaskFailed("getpid", "WorkerCrashedError: it died")), "fail"),
        (None, "fail"),
    ],
)
def test_ray_passes_if_a_worker_answers(done, verdict):
    @contextlib.contextmanager
    def cluster(*_, **__):
        yield SimpleNamespace(submit=lambda function: None, next_done=lambda timeout: done)

    assert examination._ray(cluster).verdict == verdict


@pytest.mark.parametrize(
    ("n_workers", "features", "verdict"),
    [
        (2, {"avx2": True, "fma": True}, "ok"),
        (100_000, {"avx2": True, "fma": True}, "warn"),  # too many for its cores
        (2, {"sse4.2": True}, "warn"),  # its last bits may differ
    ],
)
def test_a_processor_that_is_shared_or_has_other_low_bits_is_a_warning(n_workers, features, verdict, monkeypatch):
    monkeypatch.setattr(examination, "number_of_cores", lambda: 8)
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: features)
    assert examination._processor(n_workers).verdict == verdict
