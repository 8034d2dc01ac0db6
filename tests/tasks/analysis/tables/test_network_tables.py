"""Tables that simulate champions under networks, and films of champions, in a planted ensemble."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tasks.analysis.filmed import NO_MEMBER, best_of, film_best, median_member
from tasks.analysis.registry import Champion
from tasks.analysis.tables.champion_coverage import champion_coverage
from tasks.analysis.tables.exploiters import exploiters
from tasks.analysis.tables.transfer_tests import transfer_tests
from tasks.residual import Throws, initial_states, simulate_throws
from tasks.simulation import simulate
from tasks.world import Physics, ResidualSlush, Slush, TrueSlush

STEPS = {"n_settle": 50, "n_measure": 200, "engine": "reference"}


@dataclass
class PlantedStudy:
    """The study of the planted ensemble as analyses read it."""

    champions: list[Champion]
    home_of_all: ResidualSlush

    depths, deviation, physics, n_settle = (2.0, 9.0), "population", Physics(), 50

    def ensemble(self, champion=None):
        return self.home_of_all.components[0].medium

    def home(self, champion):
        return self.home_of_all

    def member(self, champion):
        return -1

    def true_slush(self, depth):
        return TrueSlush(depth=depth)

    def throws(self, champion=None):
        starts = initial_states(Throws(n_throws=20), np.random.default_rng(0))
        made = simulate_throws(starts, 20, Slush(), Physics())
        return made, made

    def simulate(self, environment, designs, **options):
        return simulate(designs, environment, **STEPS, **options)

    def rng(self, *identity):
        return np.random.default_rng(0)


@pytest.fixture(scope="module")
def planted(study):
    predicted = study.predicted.mean(axis=0)
    champions = [
        Champion("residual_slush", 9.0, k, study.designs[k : k + 1], predicted[k], predicted[k], study.true[k])
        for k in range(len(study.true))
    ]
    return PlantedStudy(champions, ResidualSlush(depth=9.0, ensemble=study.planted))


def liar_of(study):
    return int((study.designs.length_scale > 2.5).any(axis=1).argmax())


def test_the_robot_of_a_planted_hallucination_is_ranked_first(study, planted):
    rows, liar = exploiters(planted), liar_of(study)
    assert [row.rank for row in rows] == list(range(1, 7)) and rows[0].trial == liar
    assert rows[0].excess > 0.3  # of a quarter of the members, in 200 steps
    assert all(row.excess == 0 for row in rows[1:])  # these predictions were true
    assert (rows[0].predicted, rows[0].disagreement) == (
        study.predicted[:, liar].mean(),
        study.predicted[:, liar].std(),
    )
    unknown = [replace(champion, zero_shot=np.nan) for champion in planted.champions]
    rows = exploiters(replace(planted, champions=unknown))  # where the truth is unknown, disagreement ranks
    assert rows[0].trial == liar and rows[0].excess is None is rows[0].true


def test_champions_are_tested_at_every_depth(planted):
    rows = transfer_tests(planted)
    assert len(rows) == 2 * 6 and {row.tested for row in rows} == {2.0, 9.0}
    at_home = {row.trial: row.displacement for row in rows if row.tested == 9.0}
    assert at_home == {champion.trial: champion.zero_shot for champion in planted.champions}


def test_shares_outside_the_throws_are_of_champions_that_evolved_in_networks(planted):
    rows = champion_coverage(planted)
    assert {(row.trial, row.component) for row in rows} >= {(k, "all") for k in range(6)} and len(rows) == 6 * 7
    whole = {row.trial: row.share_outside for row in rows if row.component == "all"}
    parts = [sum(row.share_outside for row in rows if row.trial == k and row.component != "all") for k in range(6)]
    assert parts == pytest.approx([whole[k] for k in range(6)])
    assert champion_coverage(replace(planted, home_of_all=TrueSlush(depth=9.0))) == []


def test_the_best_champion_is_filmed_in_true_slush_and_where_it_evolved(study, planted):
    there, home = film_best(planted, planted.champions)
    best = int(np.argmax(study.true))
    assert (there.champion.trial, there.seen_in, there.member) == (best, "true_slush", NO_MEMBER)
    assert (there.trace[0] == study.trace[best]).all() and there.displacement == study.true[best]
    assert home.seen_in == "residual_slush" and home.displacement == study.predicted[home.member, best]
    lost = [replace(champion, zero_shot=np.nan, fitness=float(k == 4)) for k, champion in enumerate(planted.champions)]
    assert best_of(lost).trial == 4  # the best where it evolved, if none survives True Slush
    assert median_member(np.array([3.0, np.nan, 1.0, 2.0])) == 3 and median_member(np.array([2.0, 1.0])) == 1
