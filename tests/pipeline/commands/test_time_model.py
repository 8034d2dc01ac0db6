"""The time and disk that a study takes: by what the store measured, or else by the table of constants."""

import statistics

import pytest
from command_line import call

from pipeline.commands.time_model import StageForecast, forecast_stages
from pipeline.config.loading import load, preset_names, preset_path
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.stages.cost import seconds_of_rollout


@pytest.mark.parametrize("name", preset_names())
def test_every_stage_has_a_time(name):
    forecast = forecast_stages(load(Settings, preset_path(name)))
    assert [one.stage for one in forecast] == [stage.name for stage in STAGES]
    assert all(0 <= one.longest_chain_seconds <= one.core_seconds for one in forecast)


@pytest.mark.parametrize(("n_cores", "seconds"), [(0.5, 100.0), (1.0, 100.0), (2.0, 50.0), (8.0, 30.0)])
def test_cores_shorten_a_stage_down_to_its_longest_chain(n_cores, seconds):
    one = StageForecast("evolve", "generations", 10, 100.0, longest_chain_seconds=30.0, n_bytes=0.0, source="table")
    assert one.seconds(n_cores) == seconds


def test_a_medium_in_numpy_costs_more_than_one_with_a_law(monkeypatch):
    settings = load(Settings, preset_path("smoke"), ["target=flowing_slush", "grid.environments=[flowing_slush]"])
    slow = settings.model_copy(update={"work": settings.work.model_copy(update={"engine": "reference"})})
    dry, slow_dry = (seconds_of_rollout(one, "dry_land", 9.0) for one in (settings, slow))
    assert seconds_of_rollout(settings, "flowing_slush", 9.0) == dry  # which has a law
    monkeypatch.setattr("pipeline.stages.cost.is_compiled", lambda medium: False)
    assert seconds_of_rollout(settings, "flowing_slush", 9.0) > dry
    assert seconds_of_rollout(slow, "flowing_slush", 9.0) == slow_dry  # there the slush is in NumPy, too


def test_a_simulated_fluid_costs_what_it_says():
    """Two trials of 60 generations of 16 designs, each 800 steps of 3 ms, or of 6 ms where it is twice as deep."""
    for depth, step in ((4.0, 3e-3), (8.0, 6e-3)):
        settings = load(Settings, preset_path("fluid"), [f"grid.depths=[{depth}]"])
        evolve = next(one for one in forecast_stages(settings) if one.stage == "evolve")
        assert 2 * 60 * 16 * 800 * step < evolve.core_seconds < 2 * 2 * 60 * 16 * 800 * step


def test_what_is_done_costs_nothing(study, settings):
    left = forecast_stages(settings, study[0])
    assert all(one.n_units == one.core_seconds == one.n_bytes == 0 and not one.source for one in left)


def test_what_is_left_takes_the_median_time_of_what_the_store_has(study, settings):
    store, upstream = study
    grid = settings.grid.model_copy(update={"n_trials": settings.grid.n_trials + 1})
    more = settings.model_copy(update={"grid": grid})
    evolve = next(stage for stage in STAGES if stage.name == "evolve")
    costs: dict[str, list[float]] = {}
    for chain in evolve.plan(settings):
        for manifest, units in zip(upstream["evolve"].done[chain.identity], chain.units, strict=True):
            costs.setdefault(chain.spec.environment, []).append(manifest.record["seconds"] / (units * chain.weight))
    added = [chain for chain in evolve.plan(more) if chain.identity not in upstream["evolve"].done]
    expected = sum(
        statistics.median(costs[chain.spec.environment]) * chain.weight * sum(chain.units) for chain in added
    )
    left = {one.stage: one for one in forecast_stages(more, store)}["evolve"]
    assert left.source == "store" and left.n_units == sum(sum(chain.units) for chain in added)
    assert left.core_seconds == pytest.approx(expected)


def test_the_command_prints_a_table(tmp_path, capsys):
    given = ("forecast", "--preset", "paper", "--store", str(tmp_path / "none"), "--cores", "64")
    assert call(*given) == 0
    out = capsys.readouterr().out
    assert "study paper: the rest of the work on 64 cores" in out
    assert [line.split()[0] for line in out.splitlines()[2:10]] == [stage.name for stage in STAGES]


def test_no_time_is_told_of_a_gpu_that_nothing_was_measured_on(tmp_path, capsys):
    given = ["training.device=cuda", "work.networks=gpu"]
    left = {one.stage: one for one in forecast_stages(load(Settings, preset_path("paper"), given))}
    for stage in ("train", "assess"):
        assert left[stage].source == "unmeasured on a GPU" and left[stage].core_seconds == 0 and left[stage].n_units
    on_cores = {one.stage: one for one in forecast_stages(load(Settings, preset_path("paper")))}
    for stage in ("evolve", "transfer"):
        assert left[stage].source == "table and unmeasured on a GPU"
        assert 0 < left[stage].core_seconds < 0.5 * on_cores[stage].core_seconds
    assert left["adapt"] == on_cores["adapt"]
    assert call("forecast", "--preset", "paper", "--store", str(tmp_path / "none"), "--set", given[0]) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith("without what is unmeasured on a GPU")
