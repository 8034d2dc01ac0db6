"""Scores of champions from many starts, in the reference engine and by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from tasks.analysis.scores import Champion, ScoredTrial
from tasks.analysis.tables.transfer_luck import N_STARTS, luck, moved_joints
from tasks.design import random_designs, rest_pose
from tasks.simulation import simulate
from tasks.world import TrueSlush

STEPS = {"n_settle": 20, "n_measure": 60}


@pytest.fixture(scope="module")
def study():
    designs, champions = random_designs(4, np.random.default_rng(3)), []
    scores = simulate(designs, TrueSlush(depth=2.0), **STEPS).displacement
    arms = ("true_slush", 0), ("true_slush", 1), ("dry_land", 0), ("dry_land", 1)
    for k, (environment, trial) in enumerate(arms):
        champions.append(Champion(environment, 2.0, trial, 0, zero_shot=scores[k], status="ok", design=designs[k]))
    return SimpleNamespace(
        trials=[*champions, ScoredTrial("residual_slush", 2.0, 0, 0, status="no champion")],
        champions=champions,
        target="true_slush",
        at_target=lambda depth: TrueSlush(depth=depth),
        score=lambda environment, made: simulate(made, environment, **STEPS).displacement[:, None],
        rng=lambda *identity: np.random.default_rng([len(str(part)) for part in identity]),
    )


def test_every_joint_is_a_millimetre_and_a_milliradian_off(study):
    champion = study.champions[0]
    moved, one = moved_joints(study, champion), champion.design
    assert len(moved) == N_STARTS
    np.testing.assert_allclose(np.abs(moved.rest_angle - one.rest_angle)[:, 1:], 1e-3, atol=1e-12)
    np.testing.assert_allclose(
        np.abs(moved.child_attachment - one.child_attachment) * one.length_scale / 2,
        [[0] + [1e-3] * 5] * N_STARTS,
        atol=1e-12,
    )
    x, y, _ = rest_pose(moved)
    # A joint moves by 1 mm on either link, and what hangs on it turns by 1 mrad: at most 5 joints, links of up to 3 m.
    assert np.hypot(x - rest_pose(one)[0], y - rest_pose(one)[1]).max() < 5 * (2e-3 + 5e-3 * 3)


def test_luck_is_one_start_minus_the_mean_over_many(study):
    best, land, none = luck(study)
    assert [(row.environment, row.n) for row in (best, land, none)] == [
        ("true_slush", 2),
        ("dry_land", 2),
        ("residual_slush", 0),
    ]
    again = [
        simulate(moved_joints(study, champion), TrueSlush(depth=2.0), engine="reference", **STEPS).displacement.mean()
        for champion in study.champions
    ]
    one = [champion.zero_shot for champion in study.champions]
    assert best.again.value == pytest.approx(np.mean(again[:2]))
    assert land.luck.value == pytest.approx(np.mean(one[2:]) - np.mean(again[2:]))
    assert land.luck.low < land.luck.value < land.luck.high
    assert none.again.value is None is none.luck.value
