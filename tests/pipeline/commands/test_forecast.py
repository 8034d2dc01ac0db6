"""A forecast: costs are fitted to items of the store or of a calibration run, and added up."""

import json
import shutil
from dataclasses import replace

import pytest
from command_line import call, refused
from small_study import labelled

from pipeline.commands.cost_model import (
    Cost,
    DriverLimits,
    Sample,
    StageForecast,
    StudyForecast,
    forecast_stages,
    forecast_study,
    input_bytes_of,
    kind_of,
    remaining_chains,
)
from pipeline.commands.forecast_table import forecast_lines
from pipeline.config.loading import load, parse, preset_path
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store, StudyRecord
from tasks.residual.torch_descent import n_cuda_devices


def sample(size: float, seconds: float) -> Sample:
    return Sample(size, seconds, n_bytes=100.0 + size, input_bytes=1000.0)


class CalibrationStarted(Exception):  # noqa: N818
    pass


def stop_calibration(line: str) -> None:
    raise CalibrationStarted(line)


def test_a_cost_is_a_line_through_the_medians_of_two_sizes():
    # 3 s and 5 s at sizes 1 and 2; the item of 60 s waited for a compiler.
    cost = Cost.fit([sample(1, 3), sample(2, 5), sample(2, 60), sample(2, 4)])
    assert (cost.fixed_seconds, cost.seconds_per_unit) == (1, 2)
    assert (cost.fixed_bytes, cost.bytes_per_unit) == (100, 1)
    assert cost.traffic([1, 10]) == 2 * 1000 + 200 + 11
    assert cost.seconds([1, 10]) == 2 + 22


def test_a_cost_is_proportional_to_the_only_size():
    cost = Cost.fit([sample(4, 8)])
    assert (cost.fixed_seconds, cost.seconds_per_unit) == (0, 2)
    assert cost.n_bytes([40]) == 1040 and Cost.fit([sample(4, 8)], bytes_grow=False).n_bytes([40]) == 104


def test_noise_makes_no_cost_negative():
    assert Cost.fit([sample(1, 5), sample(2, 4)]).seconds([0, 10]) == 8  # no slope: 4 s each
    assert Cost.fit([sample(1, 1), sample(2, 4)]).fixed_seconds == 0  # a slope of 2 at most


def test_the_longest_chain_is_divided_by_the_batches_of_a_generation():
    """The paper's chains: 1,000 generations of 64 designs, in batches of 4 under networks only."""
    paper = load(Settings, preset_path("paper"))
    remaining = [one for one in remaining_chains(paper, {}) if one.stage.name == "evolve"]
    costs = {one.kind: Cost(0.0, 1.0 / one.chain.weight, 0.0, 0.0, 1e6) for one in remaining}
    evolve = {stage.stage: stage for stage in forecast_stages(paper, remaining, costs, {}, n_gpus=1)}["evolve"]
    assert evolve.n_units == evolve.core_seconds == pytest.approx(310_000)
    assert evolve.longest_chain_seconds == pytest.approx(1000)
    times = evolve.times(100, DriverLimits(seconds_per_item=0.1, bytes_per_second=1e6))
    assert times == pytest.approx({"cores": 3100, "longest chain": 1000, "driver": 1240, "network": 12_400})
    alone = [one for one in remaining if one.kind.of == "residual_slush"]
    (split,) = (stage for stage in forecast_stages(paper, alone, costs, {}, n_gpus=1) if stage.stage == "evolve")
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
    assert found.stage_seconds(train, 1000) == pytest.approx(train.core_seconds)  # one GPU, however many cores
    two = replace(train, n_gpus=2)
    assert two.times(1000, found.driver)["GPUs"] == pytest.approx(train.core_seconds / 2)
    *_, whole = (line for line in forecast_lines(found) if line.startswith("all"))
    on_cores = sum(stage.core_seconds for stage in found.stages) - train.core_seconds
    assert f"{on_cores:.0f} s" in whole and f"{train.core_seconds:.0f} s GPU" in "\n".join(forecast_lines(found))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--gpu-tflops", "20"], "--gpu-tflops: training.device is 'cpu', expected --set training.device=cuda"),
        (["--gpu-tflops", "0", "--set", "training.device=cuda"], "--gpu-tflops: expected a number above 0, got 0"),
        (["--set", "training.device=cuda"], "state the rate of one with --gpu-tflops"),
    ],
)
@pytest.mark.skipif(n_cuda_devices() > 0, reason="has a GPU")
def test_a_gpu_that_is_not_there_needs_a_rate(capsys, tmp_path, arguments, said):
    assert said in refused(capsys, "forecast", "--preset", "smoke", "--store", str(tmp_path), *arguments)


def test_short_and_long_times_are_written_in_their_units():
    """0.00 h says nothing of 12 s."""
    stages = [
        StageForecast("collect", "throws", 500, 1, 0.4, 0.4, 2e5, 2e5, "store"),
        StageForecast("train", "iterations", 44_000, 2, 24.0, 12.0, 3e6, 4e6, "store"),
        StageForecast("evolve", "generations", 124_000, 1240, 40_000.0, 60.0, 2e10, 3e10, "store and calibration"),
        StageForecast("transfer", "generations", 0.09, 1, 600_000.0, 1.0, 1.0, 1.0, "store"),
        StageForecast("assess", "designs", 0, 0, 0.0, 0.0, 0.0, 0.0, ""),
    ]
    forecast = StudyForecast("tiny", tuple(stages), (2, 64), 5_000_000, DriverLimits())
    _, header, collect, train, evolve, transfer, assess, total, *_, now = forecast_lines(forecast)
    assert header.split() == ["stage", "work", "core", "time", "2", "cores", "64", "cores", "disk", "cost", "from"]
    assert collect.split("  ")[-1] == "store" and "500 throws" in collect and collect.count("< 1 s") == 3
    assert "24 s" in train and train.count("12 s") == 2 and "3 MB" in train
    assert "11.1 h" in evolve and "5.6 h" in evolve and "10 min" in evolve and "20 GB" in evolve
    assert "< 1 unit" in transfer and "167 h" in transfer and "< 1 MB" in transfer
    assert assess.split() == ["assess", "done", "-", "-", "-", "-"]
    assert "0.00" not in "".join([collect, train, evolve, transfer, assess, total]) and now.endswith("5 MB now.")
    assert max(map(len, (header, collect, train, transfer, assess, total))) <= 80


def test_what_limits_the_time_is_named():
    """4,000 core-seconds are 4 s on 1,000 cores; 250 items of 20 ms take the driver 5 s, and 100 MB of results 1.8 s;
    the network takes 16 s for 2 GB.
    """
    evolve = StageForecast("evolve", "generations", 25_000, 250, 4000.0, 2.0, 1e8, 0.0, "store")
    stages = (
        evolve,
        replace(evolve, stage="transfer", traffic=2e9),
        replace(evolve, stage="train", n_items=8, longest_chain_seconds=30.0),
        replace(evolve, stage="report", n_items=1, core_seconds=0.2, longest_chain_seconds=0.2, n_bytes=0.0),
    )
    forecast = StudyForecast("tiny", stages, (2, 64, 1000), None, DriverLimits.stated(20.0, None))
    assert [forecast.stage_seconds(stage, 1000) for stage in stages] == pytest.approx([6.8, 16.0, 30.0, 0.2])
    assert forecast.limit(stages[1], 2) == "cores"  # this machine's own cores need no network
    _, header, *_, driver, few, many = forecast_lines(forecast)
    assert header.endswith("64 cores 1,000 cores     disk  cost from")
    assert driver == "driver: 509 items at 20 ms and 18 ms/MB; at most 2000 MB to and from workers at 1 Gbit/s"
    assert few == "64 cores: limited by cores (evolve, transfer, train)"
    # The report takes too little time to be named.
    assert many == "1,000 cores: limited by driver (evolve); network (transfer); longest chain (train)"


@pytest.mark.parametrize("option", ["--driver-ms", "--network-gbit"])
@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_limits_of_the_driver_are_above_0(capsys, tmp_path, option, value):
    said = refused(capsys, "forecast", "--preset", "smoke", "--store", str(tmp_path), option, value)
    assert f"{option}: expected a number above 0, got {float(value):g}" in said


def test_inputs_are_the_files_that_an_item_reads(study, settings):
    """A trial's second segment reads the first one's population; in Residual Slush the first one reads the ensemble."""
    _, upstream = study
    (stage,) = (stage for stage in STAGES if stage.name == "evolve")
    chains = {chain.identity.label: chain for chain in stage.plan(settings)}
    done = labelled(upstream["evolve"].done)
    sent = {}
    for label in ("dry_land/1m/trial-0", "residual_slush/1m/trial-0"):
        for index, before in enumerate([None, done[label][0]]):
            sent[label, index] = input_bytes_of(stage.item(settings, chains[label], index, before, upstream))
    population = done["dry_land/1m/trial-0"][0].files["population.safetensors"].n_bytes
    weights = sum(
        entry.n_bytes
        for (member,) in upstream["train"].done.values()
        for name, entry in member.files.items()
        if name == "weights.safetensors"
    )
    assert sent["dry_land/1m/trial-0", 0] == 0 and sent["dry_land/1m/trial-0", 1] == population
    assert sent["residual_slush/1m/trial-0", 0] == weights > 0


def test_forecast_as_json(study, settings, tmp_path, capsys):
    (tmp_path / "tiny.yaml").write_text(settings.model_dump_json())
    chosen = ("--settings", str(tmp_path / "tiny.yaml"), "--store", str(study[0].root), "--cores", "8")
    assert call("forecast", "--json", *chosen) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["study"] == "tiny" and found["seconds"]["8"] == 0 and len(found["stages"]) == len(STAGES)
    assert found["stages"][3]["unit"] == "generations" and found["stages"][3]["core_seconds"] == 0
    assert found["stages"][3]["limit"] == dict.fromkeys(found["seconds"], "cores")


def test_kinds_tell_apart_what_costs_differ(settings):
    plans = {stage.name: {kind_of(stage, chain) for chain in stage.plan(settings)} for stage in STAGES}
    assert {kind.of for kind in plans["evolve"]} == set(settings.grid.environments) | {"single_member"}
    assert {kind.of for kind in plans["transfer"]} == {"true_slush"}
    assert len(plans["collect"]) == len(plans["train"]) == len(plans["assess"]) == 1
    assert len(plans["report"]) == 2  # the page, and the film


def test_a_store_at_home_is_found(study, settings, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(study[0].root.parent))
    monkeypatch.setenv("PUDDLE_STORE", f"~/{study[0].root.name}")
    (tmp_path / "tiny.yaml").write_text(settings.model_dump_json())
    assert call("forecast", "--settings", str(tmp_path / "tiny.yaml")) == 0
    assert f"The store holds {study[0].size_bytes() / 1e6:.0f} MB" in capsys.readouterr().out
