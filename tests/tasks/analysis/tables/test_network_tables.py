"""Tables that simulate champions, under networks too, in a planted ensemble."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tasks.analysis.scores import Champion
from tasks.analysis.tables.exploiters import exploiters
from tasks.design import motors_off
from tasks.simulation import simulate
from tasks.world import TrueSlush

STEPS = {"n_settle": 50, "n_measure": 200, "engine": "reference"}


def ranked(champions, ensemble):
    study = SimpleNamespace(
        champions=champions,
        ensemble=lambda champion: ensemble,
        settings=SimpleNamespace(learners={}),
        score=lambda environment, designs: simulate(designs, environment, **STEPS).displacement.T,
    )
    return exploiters(study)


def test_the_robot_of_a_planted_hallucination_is_ranked_first(study):
    predicted, of_members = study.predicted.mean(axis=0), study.predicted[:, 3]
    passive = simulate(motors_off(study.designs), TrueSlush(depth=9.0), **STEPS).displacement
    champions = [
        Champion("residual_slush", 9.0, k, 0, mu, mu, zero_shot=true, passive=off, design=study.designs[k : k + 1])
        for k, (mu, true, off) in enumerate(zip(predicted, study.true, passive, strict=True))
    ]
    rows = ranked(champions, study.planted)
    assert [row.rank for row in rows] == list(range(1, 7)) and rows[0].trial == 3
    assert rows[0].excess > 0.15  # of a quarter of the members, in 200 steps
    assert all(row.excess == 0 for row in rows[1:])  # these predictions were true
    assert (rows[0].predicted, rows[0].disagreement) == (of_members.mean(), of_members.std())
    # Carried 5 m, with and without motors, by a current that the networks don't know: nothing of a prediction is true.
    carried = [replace(champion, zero_shot=5.0, passive=5.0) for champion in champions]
    for row in ranked(carried, study.planted):
        assert row.excess == pytest.approx(row.predicted - max(row.passive_predicted, 0.0))
    unknown = [replace(champion, zero_shot=np.nan) for champion in champions]
    rows = ranked(unknown, study.planted)  # where the truth is unknown, disagreement ranks
    assert rows[0].trial == 3 and np.isnan((rows[0].excess, rows[0].true)).all()
