"""A forecast: costs are fitted to items of the store or of a calibration run, and added up."""

import json
import shutil

import pytest
from command_line import call, refused

from pipeline.commands.cost_model import (
    Cost,
    Sample,
    StageForecast,
    StudyForecast,
    forecast_lines,
    forecast_stages,
    forecast_study,
    kind_of,
    remaining_chains,
)
from pipeline.config.loading import load, parse, preset_path
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store, StudyRecord
from tasks.residual.torch_descent import n_cuda_devices


def sample(size: float, seconds: float) -> Sample:
    return Sample(size, seconds, n_bytes=100.0 + size)


class CalibrationStarted(Exception):  # noqa: N818
    pass


def stop_calibration(line: str) -> None:
    raise CalibrationStarted(line)


def test_a_cost_is_a_line_through_the_medians_of_two_sizes():
    # 3 s and 5 s at sizes 1 and 2; the item of 60 s waited for a compiler.
    cost = Cost.fit([sample(1, 3), sample(2, 5), sample(2, 60), sample(2, 4)])
    assert (cost.fixed_seconds, cost.seconds_per_unit) == (1, 2)
    assert (cost.fixed_bytes, cost.bytes_per_unit) == (100, 1)
    assert cost.seconds([1, 10]) == 2 + 22


def test_a_cost_is_proportional_to_the_only_size():
    cost = Cost.fit([sample(4, 8)])
    assert (cost.fixed_seconds, cost.seconds_per_unit) == (0, 2)


def test_noise_makes_no_cost_negative():
    assert Cost.fit([sample(1, 5), sample(2, 4)]).seconds([0, 10]) == 8  # no slope: 4 s each
    assert Cost.fit([sample(1, 1), sample(2, 4)]).fixed_seconds == 0  # a slope of 2 at most


def test_the_longest_chain_is_divided_by_the_batches_of_a_generation():
    """The paper's chains: 1,000 generations of 64 designs, in batches of 4 under networks only."""
    paper = load(Settings, preset_path("paper"))
    remaining = [one for one in remaining_chains(paper, {}) if one.stage.name == "evolve"]
    costs = {one.kind: Cost(0.0, 1.0 / one.chain.weight, 0.0, 1.0 / one.chain.weight) for one in remaining}
    evolve = {stage.stage: stage for stage in forecast_stages(paper, remaining, costs, {})}["evolve"]
    assert evolve.n_units == evolve.core_seconds == pytest.approx(310_000)
    assert evolve.longest_chain_seconds == pytest.approx(1000)
    assert evolve.seconds(100) == pytest.approx(3100) and evolve.seconds(1000) == pytest.approx(1000)
    alone = [one for one in remaining if one.kind.environment == "residual_slush"]
    (split,) = (stage for stage in forecast_stages(paper, alone, costs, {}) if stage.stage == "evolve")
    assert split.longest_chain_seconds == pytest.approx(1000 / 16)


def test_a_finished_study_costs_nothing(study, settings):
    store, upstream = study
    assert remaining_chains(settings, upstream) == []
    *_, total, _ = forecast_lines(forecast_study(settings, store, (), say=stop_calibration))
    assert total.split() == ["all", "-", "-", "-"]


def test_items_of_another_study_are_samples_if_their_units_cost_the_same(study, settings, tmp_path):
    """No calibration run is needed for more trials and generations, only for other costs per unit."""
    store = Store.open(shutil.copytree(study[0].root, tmp_path / "store"), create=False)
    store.write_study(StudyRecord(settings.name, settings.model_dump(mode="json"), ()))
    more = ("name=more", "seed=7", "grid.n_trials=5", "evolution.n_generations=9", "work.generations_per_item=3")
    longer = parse(Settings, settings.model_dump_json(), name="longer", overrides=more)
    lines = list(forecast_lines(forecast_study(longer, store, (8,), say=stop_calibration)))
    assert "8 cores" in lines[1] and lines[2].endswith(" store") and "180 generations" in "\n".join(lines)
    larger = parse(Settings, settings.model_dump_json(), name="larger", overrides=["rollout.n_measure=40"])
    with pytest.raises(CalibrationStarted):
        forecast_study(larger, store, (), say=stop_calibration)


def test_a_calibration_run_forecasts_a_real_study(study, settings, tmp_path):
    """Bytes are compared, which do not depend on the machine; the seconds of a real study are in cost_model.py."""
    store, _ = study
    found = forecast_study(settings, None, (), say=lambda line: None)
    assert [stage.stage for stage in found.stages] == [stage.name for stage in STAGES] and found.store_bytes is None
    for stage in found.stages:
        assert stage.source == "calibration"
        copies = 2 if stage.stage == "report" else 1
        n_bytes = copies * sum(store.item_bytes(stage.stage, key) for key in store.keys(stage.stage))
        assert stage.n_bytes / 1e6 == pytest.approx(n_bytes / 1e6, rel=0.6, abs=0.51), stage.stage


def test_training_is_priced_for_a_stated_gpu(settings):
    """The paper's: 8 networks, 50,000 iterations of 262,144, 6 x 256 + 3 x 256 x 256 + 256 x 6 weights."""
    overrides = ["training.device=cuda", "training.batch_size=262144", "network.hidden_layers=4", "network.width=256"]
    study = parse(Settings, settings.model_dump_json(), name="gpu", overrides=overrides)
    found = forecast_study(study, None, (), gpu_tflops=20.0, say=lambda line: None)
    train = next(stage for stage in found.stages if stage.stage == "train")
    flop = 6 * (6 * 256 + 3 * 256 * 256 + 256 * 6) * 262_144 * train.n_units
    assert train.core_seconds == pytest.approx(flop / 20e12) and train.source == "stated rate"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--gpu-tflops", "20"], "--gpu-tflops: training.device is 'cpu', expected --set training.device=cuda"),
        (["--gpu-tflops", "0", "--set", "training.device=cuda"], "--gpu-tflops: expected a rate above 0, got 0"),
        (["--set", "training.device=cuda"], "state the rate of one with --gpu-tflops"),
    ],
)
@pytest.mark.skipif(n_cuda_devices() > 0, reason="has a GPU")
def test_a_gpu_that_is_not_there_needs_a_rate(capsys, tmp_path, arguments, said):
    assert said in refused(capsys, "forecast", "--preset", "smoke", "--store", str(tmp_path), *arguments)


def test_short_and_long_times_are_written_in_their_units():
    """0.00 h says nothing of 12 s."""
    stages = [
        StageForecast("collect", "throws", 500, 0.4, 0.4, 2e5, "store"),
        StageForecast("train", "iterations", 44_000, 24.0, 12.0, 3e6, "store"),
        StageForecast("evolve", "generations", 124_000, 40_000.0, 60.0, 2e10, "store and calibration"),
        StageForecast("transfer", "generations", 0.09, 600_000.0, 1.0, 1.0, "store"),
        StageForecast("assess", "designs", 0, 0.0, 0.0, 0.0, ""),
    ]
    forecast = StudyForecast("tiny", tuple(stages), (2, 64), 5_000_000)
    _, header, collect, train, evolve, transfer, assess, total, now = forecast_lines(forecast)
    assert header.split() == ["stage", "work", "core", "time", "2", "cores", "64", "cores", "disk", "cost", "from"]
    assert collect.split("  ")[-1] == "store" and "500 throws" in collect and collect.count("< 1 s") == 3
    assert "24 s" in train and train.count("12 s") == 2 and "3 MB" in train
    assert "11.1 h" in evolve and "5.6 h" in evolve and "10 min" in evolve and "20 GB" in evolve
    assert "< 1 unit" in transfer and "167 h" in transfer and "< 1 MB" in transfer
    assert assess.split() == ["assess", "done", "-", "-", "-", "-"]
    assert "0.00" not in "".join([collect, train, evolve, transfer, assess, total]) and now.endswith("5 MB now.")
    assert max(map(len, (header, collect, train, transfer, assess, total))) <= 80


def test_forecast_as_json(study, settings, tmp_path, capsys):
    (tmp_path / "tiny.yaml").write_text(settings.model_dump_json())
    chosen = ("--settings", str(tmp_path / "tiny.yaml"), "--store", str(study[0].root), "--cores", "8")
    assert call("forecast", "--json", *chosen) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["study"] == "tiny" and found["seconds"]["8"] == 0 and len(found["stages"]) == len(STAGES)
    assert found["stages"][3]["unit"] == "generations" and found["stages"][3]["core_seconds"] == 0


def test_kinds_tell_apart_what_costs_differ(settings):
    plans = {stage.name: {kind_of(stage, chain) for chain in stage.plan(settings)} for stage in STAGES}
    assert {kind.environment for kind in plans["evolve"]} == set(settings.grid.environments) | {"single_member"}
    assert {kind.environment for kind in plans["transfer"]} == {"true_slush"}
    assert len(plans["collect"]) == len(plans["train"]) == len(plans["assess"]) == 1
    assert len(plans["report"]) == 2  # the page, and films


def test_a_store_at_home_is_found(study, settings, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(study[0].root.parent))
    monkeypatch.setenv("PUDDLE_STORE", f"~/{study[0].root.name}")
    (tmp_path / "tiny.yaml").write_text(settings.model_dump_json())
    assert call("forecast", "--settings", str(tmp_path / "tiny.yaml")) == 0
    assert f"The store holds {study[0].size_bytes() / 1e6:.0f} MB" in capsys.readouterr().out
