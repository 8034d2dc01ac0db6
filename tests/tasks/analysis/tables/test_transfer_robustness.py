"""Scores of champions in other conditions, in the reference engine and by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tasks.analysis.estimates import Estimate
from tasks.analysis.scores import Champion, ScoredTrial
from tasks.analysis.tables.transfer_robustness import CONDITIONS, N_STARTS, robustness
from tasks.design import motors_off, random_designs
from tasks.simulation import Conditions, simulate
from tasks.world import Physics, TrueSlush

STEPS = {"n_settle": 20, "n_measure": 60}
ARMS = (("true_slush", 0), ("true_slush", 1), ("dry_land", 0), ("dry_land", 1))


def rolled_out(designs, depth, conditions=Conditions()):  # noqa: B008 (frozen)
    physics, designs = conditions.of_physics(Physics()), conditions.of_designs(designs)
    steps = {name: n * conditions.n_substeps for name, n in STEPS.items()}
    return simulate(designs, TrueSlush(depth=depth), engine="reference", physics=physics, **steps).displacement


@pytest.fixture(scope="module")
def study():
    designs, champions = random_designs(4, np.random.default_rng(3)), []
    for depth in (2.0, 0.0):
        scores, passive = (rolled_out(of, depth) for of in (designs, motors_off(designs)))
        for k, (environment, trial) in enumerate(ARMS):
            known = {"zero_shot": scores[k], "passive": passive[k], "status": "ok", "design": designs[k]}
            champions.append(Champion(environment, depth, trial, 0, **known))
    return SimpleNamespace(
        trials=[*champions, ScoredTrial("residual_slush", 2.0, 0, 0, status="no champion")],
        champions=champions,
        target="true_slush",
        at_target=lambda depth: TrueSlush(depth=depth),
        score_under=lambda conditions, environment, made: rolled_out(made, environment.depth, conditions),
        rng=lambda *identity: np.random.default_rng([len(str(part)) for part in identity]),
    )


def test_every_column_is_the_mean_over_champions_in_its_conditions(study):
    rows = robustness(study)
    assert [(row.environment, row.depth, row.n) for row in rows] == [
        ("true_slush", 2.0, 2),
        ("dry_land", 2.0, 2),
        ("residual_slush", 2.0, 0),
        ("true_slush", 0.0, 2),
        ("dry_land", 0.0, 2),
    ]
    land = rows[1]
    own = [champion for champion in study.champions if (champion.environment, champion.depth) == ("dry_land", 2.0)]
    designs = random_designs(4, np.random.default_rng(3))[2:]
    assert land.one.value == pytest.approx(np.mean([champion.zero_shot for champion in own]))
    assert land.passive.value == pytest.approx(np.mean([champion.passive for champion in own]))
    starts = [rolled_out(designs, 2.0, one) for one in CONDITIONS["starts"]]
    assert len(starts) == N_STARTS and land.starts.value == pytest.approx(np.mean(starts))
    finer = simulate(
        designs, TrueSlush(depth=2.0), n_settle=80, n_measure=240, physics=Physics(time_step=1 / 240), engine="batch"
    )
    assert land.quarter_steps.value == pytest.approx(finer.displacement.mean())
    assert rows[2].one.value is None is rows[2].share.value


def test_continuous_collision_is_scored_at_the_least_depth_alone(study):
    deep, _, _, *ground = robustness(study)
    assert deep.continuous.value is None
    assert all(row.continuous.value != row.one.value for row in ground)


def test_shares_are_of_the_targets_own_champions_in_the_same_conditions(study):
    """With scores that are all positive, so that every share is known."""
    champions = [replace(champion, zero_shot=abs(champion.zero_shot) + 5) for champion in study.champions]
    positive = {
        "trials": champions,
        "champions": champions,
        "score_under": lambda *asked: np.abs(study.score_under(*asked)) + 4 + asked[0].n_substeps,
    }
    e, land, *_ = robustness(SimpleNamespace(**vars(study) | positive))
    assert e.share == e.quarter_share == e.gain_share == Estimate(1.0)
    assert land.share.value == pytest.approx(land.one.value / e.one.value)
    assert land.quarter_share.value == pytest.approx(land.quarter_steps.value / e.quarter_steps.value)
    gain = (land.one.value - land.passive.value) / (e.one.value - e.passive.value)
    assert land.gain_share.value == pytest.approx(gain)
