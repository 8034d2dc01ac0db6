"""Schedules that can be worked out by hand, and the paper's own on a thousand cores."""

import json
from pathlib import Path

import pytest

from benchmarks.engines import N_DESIGNS, N_STEPS
from benchmarks.readme import RESULTS
from pipeline.commands.cost_model import schedule, schedule_lines
from pipeline.commands.rates import Rates
from pipeline.commands.schedule import TASK_SECONDS, Work, play
from pipeline.config.loading import load, preset_path
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.stages.evolve import EVOLVE

CLUSTER_PAGE = (Path(__file__).parents[3] / "docs" / "cluster.md").read_text()

QUIET = Rates(
    throw=0.01,
    iteration=10.0,
    simulation={"true_slush": 0.008, "dry_land": 0.01, "residual_slush": 8.5, "single_member": 0.598},
    selection={"evolve": 0.002, "transfer": 0.002},
    population_size=64,
    picture=0.007,
    look=0.2,
)
"""Core-seconds of the paper's generation and the like on the README's machine: what `make bench` measures of them,
rounded, and the rest as `puddle forecast` found it there (of a picture 0.02, times the 0.36 that drawing it once for
both formats takes of that on another machine)."""

NEAR = 0.3
"""How far, relatively, a run of `make bench` may be from these rates: the machine's runs differ by a sixth."""


def test_the_rates_are_those_of_the_readmes_machine():
    measured = {figure["name"]: figure["median"] for figure in json.loads(RESULTS.read_text())["figures"]}
    robots_and_steps = 1e-6 * N_DESIGNS * N_STEPS
    assert QUIET.simulation == pytest.approx(
        {
            "residual_slush": measured["a generation, 8 members of 4 × 256"],
            "dry_land": measured["batch engine, d = 0"] * robots_and_steps,
            "true_slush": measured["batch engine, d = 1"] * robots_and_steps,
            "single_member": QUIET.simulation["single_member"],  # has no benchmark
        },
        rel=NEAR,
    )


def test_one_core_does_one_thing_after_another():
    played = play([[Work(1, 1, 10.0)] * 2, [Work(1, 1, 5.0)]], 1, driver_seconds=0.0)
    assert played.seconds == pytest.approx(25 + 3 * TASK_SECONDS)
    assert played.critical_seconds == 20
    assert played.busy == pytest.approx(1, abs=1e-3)


def test_no_number_of_cores_gets_below_the_longest_chain():
    chains = [[Work(1, 1, 10.0)] * 3] * 4
    played = play(chains, 1000, driver_seconds=0.5)
    # Four results at a time queue for the driver: the last waits for the other three, round after round.
    assert played.seconds == pytest.approx(3 * (10 + TASK_SECONDS) + 0.5 * 6, abs=0.01)
    assert played.busy == pytest.approx(120 / (1000 * played.seconds))
    assert played.driver_busy == pytest.approx(6 / played.seconds)


def test_a_split_piece_uses_as_many_cores_as_it_has_batches():
    whole, split = Work(1, 1, 100 * 8.0), Work(100, 8, 1.0, 0.1)
    assert whole.core_seconds == split.core_seconds
    assert play([[whole]], 8, driver_seconds=0.0).busy == pytest.approx(1 / 8, rel=1e-3)
    played = play([[split]], 8, driver_seconds=0.0)
    assert played.busy == pytest.approx(1 / 1.1, rel=1e-2)  # the selections between are nobody's
    assert played.critical_seconds == pytest.approx(110)
    beside = play([[split], [split]], 8, driver_seconds=0.0)
    assert beside.busy > 0.97  # where one selects, the other's batches run


def test_the_heaviest_chain_goes_first():
    light, heavy = [Work(1, 1, 1.0)] * 3, [Work(1, 1, 10.0)] * 3
    assert play([light, light, heavy], 2, driver_seconds=0.0).seconds == pytest.approx(30, abs=1.1)


def test_the_papers_evolution_keeps_a_thousand_cores_busy_in_the_grain_of_its_preset():
    paper = load(Settings, preset_path("paper"), ())
    whole = paper.model_copy(update={"work": paper.work.model_copy(update={"designs_per_batch": None})})
    played = schedule(paper, EVOLVE, {}, QUIET, 1000, 0.02)
    coarse = schedule(whole, EVOLVE, {}, QUIET, 1000, 0.02)
    # The play draws nothing: these hold to the digit until the preset, the policy or the stages change.
    assert (played.busy, coarse.busy) == pytest.approx((0.985, 0.101), abs=1e-3)
    assert (played.seconds, coarse.seconds) == pytest.approx((872.5, 8522.7), abs=0.5)
    # A thousand generations of the ensemble's sixteenth and a selection; whole, of the ensemble and a selection.
    assert played.critical_seconds == pytest.approx(1000 * (8.5 / 16 + 0.002))
    assert coarse.critical_seconds == pytest.approx(1000 * (8.5 + 0.002))
    assert played.driver_busy == pytest.approx(310 * 40 * 0.02 / 872.5, abs=1e-3)  # 28 %
    advice = schedule_lines(whole, {}, QUIET, 1000, 0.02)[-1]
    assert "310 trials alone keep 10% of 1,000 cores busy" in advice
    assert f"--set work.designs_per_batch={paper.work.designs_per_batch}" in advice
    lines = schedule_lines(paper, {}, QUIET, 1000, 0.02)
    assert f"work.designs_per_batch={paper.work.designs_per_batch} is right here" in lines[-1]
    assert [line.split()[0] for line in lines[3:9]] == [stage.name for stage in STAGES][:6]


def test_the_page_on_clusters_shows_the_papers_schedule():
    """The very lines, so that whatever changes them changes the page."""
    lines = schedule_lines(load(Settings, preset_path("paper"), ()), {}, QUIET, 1000, 0.02)
    assert "\n".join(lines[1:]) in CLUSTER_PAGE


def test_the_page_tells_the_schedule_in_words():
    paper = load(Settings, preset_path("paper"), ())
    whole = paper.model_copy(update={"work": paper.work.model_copy(update={"designs_per_batch": None})})
    fine, coarse = (schedule(one, EVOLVE, {}, QUIET, 1000, 0.02) for one in (paper, whole))
    told = " ".join(CLUSTER_PAGE.split())
    for words in (
        f"{QUIET.simulation['residual_slush']:g} s for a generation under the networks",
        f"whole trials keep {100 * coarse.busy:.0f} % of 1,000 cores busy and take {coarse.seconds:,.0f} s",
        f"they keep {100 * fine.busy:.0f} % busy and end after {fine.seconds:.0f} s",
        f"which no number of cores gets below, is then {fine.critical_seconds:.0f} s",
        f"divided by a thousand: {fine.busy * fine.seconds:.0f} s",
        f"The driver is busy for {100 * fine.driver_busy:.0f} % of evolution",
        f"within {100 * NEAR:.0f} %",
    ):
        assert words in told
