"""`puddle doctor` on a machine where the tests run, and where something is wrong."""

from types import SimpleNamespace

import psutil
import pytest
from command_line import call
from small_study import ON_DRY_LAND

from pipeline.commands import doctor
from pipeline.config.loading import parse
from pipeline.config.settings import Settings


def test_every_check_passes_where_the_tests_run(options, capsys):
    assert call("doctor", "--workers", "0", *options) == 0
    found = [line.split()[:2] for line in capsys.readouterr().out.splitlines() if not line.startswith(" ")]
    assert [what for _, what in found] == ["versions:", "processor:", "memory:", "disk:"]
    assert {verdict for verdict, _ in found} <= {"ok", "warn"}


def test_problems_are_found_and_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(doctor, "_SPARE_BYTES", 1e18)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=2e9))  # enough for two workers
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: {"sse4.2": True})  # other low bits
    constraints = tmp_path / "constraints.txt"
    constraints.write_text("numpy==0.1\nBox2D==2.3.10\n")
    monkeypatch.setattr(doctor, "_CONSTRAINTS", constraints)
    assert call("doctor", "--preset", "smoke", "--store", str(tmp_path / "store"), "--workers", "8") == 1
    said = capsys.readouterr().out
    for found in (
        "warn  versions: numpy",
        "warn  processor: ",
        "fail  memory: 2.0 GB",
        "--workers 2.",
        "fail  disk: ",
        "`puddle gc`",
    ):
        assert found in said


def test_finished_work_needs_no_disk_space(store, tmp_path, monkeypatch):
    """Half of the space that a whole study needs is enough for the rest of one that is nearly done."""
    tiny = parse(Settings, ON_DRY_LAND, name="tiny")
    free = int(doctor._SPARE_BYTES + sum(one.n_bytes for one in doctor.forecast_stages(tiny)) / 2)
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda folder: SimpleNamespace(free=free))
    assert doctor._disk(tiny, tmp_path / "new").verdict == "fail"
    free = 0
    found = doctor._disk(tiny, store.root)
    assert found.verdict == "ok" and found.found.endswith("study tiny is done")


@pytest.mark.parametrize(
    ("asked", "verdict", "code"), [("training.device=cuda", "fail", 1), ("work.networks=gpu", "warn", 0)]
)
def test_a_gpu_is_looked_for_where_the_study_asks_for_one(asked, verdict, code, tmp_path, monkeypatch, capsys):
    given = ("doctor", "--preset", "smoke", "--set", asked, "--store", str(tmp_path), "--workers", "0")
    for n_devices, expected, found in ((0, verdict, "torch"), (2, "ok", "2 for torch")):
        monkeypatch.setattr("tasks.residual.torch_descent.n_cuda_devices", lambda n=n_devices: n)
        assert call(*given) == (code if n_devices == 0 else 0)
        said = capsys.readouterr().out
        assert f"{expected:<5} GPU: {found}" in said
        assert ("work.networks=local" in said) == (n_devices == 0)
