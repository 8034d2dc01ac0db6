"""`puddle doctor` on a machine where the tests run, and where something is wrong."""

import contextlib
import json
from types import SimpleNamespace

import psutil
import pytest
from command_line import call
from small_study import ON_DRY_LAND

from pipeline.cluster import Done, TaskFailed, Ticket
from pipeline.commands import examination
from pipeline.config.loading import parse
from pipeline.config.settings import Settings


def tiny() -> Settings:
    return parse(Settings, ON_DRY_LAND, name="tiny")


def test_every_check_passes_where_the_tests_run(options, capsys):
    assert call("doctor", "--workers", "0", *options) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith(("ok ", "warn ", "      ")) for line in lines)
    for what in ("versions", "processor", "memory", "disk", "engine"):
        assert any(what in line for line in lines), what


def test_problems_are_found_and_named_in_json(store, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(examination, "_SPARE_BYTES", 1e18)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=2e9))  # enough for two workers
    monkeypatch.setattr(examination, "_ray", lambda: ("ok", "not asked", ""))
    constraints = tmp_path / "constraints.txt"
    constraints.write_text("numpy==0.1\nBox2D==2.3.10\n")
    monkeypatch.setattr(examination, "_CONSTRAINTS", constraints)
    for key in store.keys("report"):  # a study that is done needs no space
        store.discard("report", key)
    assert call("doctor", "tiny", "--store", str(store.root), "--workers", "8", "--json") == 1
    said = json.loads(capsys.readouterr().out)
    found = {check["what"]: check for check in said["checks"]}
    assert not said["ok"]
    assert found["disk"]["verdict"] == "fail" and "puddle gc" in found["disk"]["advice"]
    assert found["memory"]["verdict"] == "fail" and "--workers 2" in found["memory"]["advice"]
    assert found["versions"]["verdict"] == "warn" and "numpy" in found["versions"]["found"]


def test_finished_work_needs_no_disk_space(store, tmp_path, monkeypatch):
    """Half of the space that a whole study needs is enough for the rest of one that is nearly done."""
    free = int(examination._SPARE_BYTES + sum(one.n_bytes for one in examination.forecast_stages(tiny())) / 2)
    monkeypatch.setattr(examination.shutil, "disk_usage", lambda folder: SimpleNamespace(free=free))
    assert examination._disk(tiny(), tmp_path / "new")[0] == "fail"
    assert examination._disk(tiny(), store.root)[0] == "ok"
    free = 0
    assert examination._disk(tiny(), store.root)[1].endswith("study tiny is done")
    for key in store.keys("report"):  # the page: most of such a small study
        store.discard("report", key)
    assert examination._disk(tiny(), store.root)[0] == "fail"


@pytest.mark.parametrize(
    ("done", "verdict"),
    [
        ((Ticket(0, "getpid"), Done(7)), "ok"),
        ((Ticket(0, "getpid"), TaskFailed("getpid", "WorkerCrashedError: it died")), "fail"),
        (None, "fail"),
    ],
)
def test_ray_passes_if_a_worker_answers(done, verdict, monkeypatch):
    @contextlib.contextmanager
    def cluster(*_, **__):
        yield SimpleNamespace(submit=lambda function: None, next_done=lambda timeout: done)

    monkeypatch.setattr(examination, "ray_cluster", cluster)
    assert examination._ray()[0] == verdict


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
    assert examination._processor(n_workers)[0] == verdict
