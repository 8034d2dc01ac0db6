"""Tables that simulate champions, under networks too, in a planted ensemble."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from tasks.analysis.scores import Champion
from tasks.analysis.tables.exploiters import exploiters
from tasks.design import motors_off
from tasks.simulation import simulate
from tasks.world import TrueSlush

STEPS = {"n_settle": 50, "n_measure": 200, "engine": "reference"}


@dataclass
class PlantedStudy:
    """The study of the planted ensemble as analyses read it."""

    champions: list[Champion]
    planted: object

    settings = SimpleNamespace(learners={})

    def ensemble(self, champion=None):
        return self.planted

    def simulate(self, environment, designs, **options):
        return simulate(designs, environment, **STEPS, **options)

    def score(self, environment, designs):
        return self.simulate(environment, designs).displacement.T


@pytest.fixture(scope="module")
def planted(study):
    predicted = study.predicted.mean(axis=0)
    passive = simulate(motors_off(study.designs), TrueSlush(depth=9.0), **STEPS).displacement
    champions = [
        Champion("residual_slush", 9.0, k, 0, mu, mu, zero_shot=true, passive=off, design=study.designs[k : k + 1])
        for k, (mu, true, off) in enumerate(zip(predicted, study.true, passive, strict=True))
    ]
    return PlantedStudy(champions, study.planted)


def liar_of(study):
    return int((study.designs.length_scale > 2.5).any(axis=1).argmax())


def test_the_robot_of_a_planted_hallucination_is_ranked_first(study, planted):
    rows, liar = exploiters(planted), liar_of(study)
    assert [row.rank for row in rows] == list(range(1, 7)) and rows[0].trial == liar
    assert rows[0].excess > 0.15  # of a quarter of the members, in 200 steps
    assert all(row.excess == 0 for row in rows[1:])  # these predictions were true
    assert (rows[0].predicted, rows[0].disagreement) == (
        study.predicted[:, liar].mean(),
        study.predicted[:, liar].std(),
    )
    # Carried 5 m, with and without motors, by a current that the networks don't know: nothing of a prediction is true.
    carried = [replace(champion, zero_shot=5.0, passive=5.0) for champion in planted.champions]
    for row in exploiters(replace(planted, champions=carried)):
        assert row.excess == pytest.approx(row.predicted - max(row.passive_predicted, 0.0))
    unknown = [replace(champion, zero_shot=np.nan) for champion in planted.champions]
    rows = exploiters(replace(planted, champions=unknown))  # where the truth is unknown, disagreement ranks
    assert rows[0].trial == liar and np.isnan((rows[0].excess, rows[0].true)).all()
