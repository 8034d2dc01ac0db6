"""Tables that simulate champions under networks: exploiters, errors of members, and films, in a planted ensemble."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from tasks.analysis.filmed import best_of, median_member
from tasks.analysis.hallucination import disagreement, link_states
from tasks.analysis.registry import Champion
from tasks.analysis.tables.exploiters import exploiters
from tasks.analysis.tables.filmed_links import filmed_links
from tasks.analysis.tables.member_errors import COMPONENTS, errors, member_errors
from tasks.analysis.tables.transfer_tests import transfer_tests
from tasks.residual import Throws, initial_states, simulate_throws
from tasks.residual.error_report import BANDS
from tasks.simulation import simulate
from tasks.world import LinkStates, Physics, ResidualSlush, Slush, TrueSlush

PHYSICS = Physics()
ROUNDING = 60 * 2**-17  # [m/s²], of the difference of two float32 velocities of up to 32 m/s, over a step of 1/60 s
STEPS = {"n_settle": 50, "n_measure": 200, "engine": "reference"}


@dataclass
class PlantedStudy:
    """The study of the planted ensemble as analyses read it."""

    champions: list[Champion]
    ensemble_of_all: object

    depths, deviation, physics, n_settle = (2.0, 9.0), "population", PHYSICS, 50

    def ensemble(self, champion=None):
        return self.ensemble_of_all

    def home(self, champion):
        return ResidualSlush(depth=champion.depth, ensemble=self.ensemble_of_all)

    def member(self, champion):
        return -1

    def true_slush(self, depth):
        return TrueSlush(depth=depth)

    def true_medium(self):
        return Slush()

    def throws(self, champion=None):
        made = simulate_throws(initial_states(Throws(n_throws=20), np.random.default_rng(0)), 20, Slush(), PHYSICS)
        return made, made

    def simulate(self, environment, designs, **options):
        return simulate(designs, environment, **STEPS, **options)


@pytest.fixture(scope="module")
def planted(study):
    predicted = study.predicted.mean(axis=0)
    champions = [
        Champion("residual_slush", 9.0, k, study.designs[k : k + 1], predicted[k], predicted[k], study.true[k])
        for k in range(len(study.true))
    ]
    return PlantedStudy(champions, study.planted)


def liar_of(study):
    return int((study.designs.length_scale > 2.5).any(axis=1).argmax())


def test_the_robot_of_a_planted_hallucination_is_ranked_first(study, planted):
    rows = exploiters(planted)
    assert [row.rank for row in rows] == list(range(1, 7)) and rows[0].trial == liar_of(study)
    assert rows[0].excess > 0.3  # of a quarter of the members, in 200 steps
    assert all(row.excess == 0 for row in rows[1:])  # these predictions were true
    assert rows[0].predicted == study.predicted[:, liar_of(study)].mean()
    assert rows[0].disagreement == study.predicted[:, liar_of(study)].std()


def test_where_the_truth_is_unknown_disagreement_ranks(study, planted):
    unknown = [replace(champion, zero_shot=np.nan) for champion in planted.champions]
    rows = exploiters(replace(planted, champions=unknown))
    assert rows[0].trial == liar_of(study) and rows[0].excess is None is rows[0].true


def test_champions_are_tested_at_every_depth(planted):
    rows = transfer_tests(planted)
    assert len(rows) == 2 * 6 and {row.tested for row in rows} == {2.0, 9.0}
    at_home = {row.trial: row.displacement for row in rows if row.tested == 9.0}
    assert at_home == {champion.trial: champion.zero_shot for champion in planted.champions}


def links_at(y, vx):
    """Upright links of 2 m × 0.5 m."""
    y, vx = (np.array(numbers, np.float32) for numbers in (y, vx))
    a, mass, inertia, cos, sin, zero = (np.full(len(y), v, np.float32) for v in (2.0, 1.0, 4.25 / 12, 1.0, 0.0, 0.0))
    return LinkStates(a, mass, inertia, y, cos, sin, vx, zero, zero)


def test_a_false_thrust_is_the_error_of_its_member_where_it_is(study):
    """Links at y of 5 (dry), 0.5 (partly in), -0.5 (partly in, and where the liar lies), -3 (submerged; it lies)."""
    planted = type(study.planted)(lies=lambda links: links.y < 0)
    found = list(errors(planted, Slush(), links_at([5, 0.5, -0.5, -3], [0.1, 1.0, 1.0, 20.0]), PHYSICS))
    assert len(found) == planted.n_members * len(COMPONENTS) * len(BANDS) * 4
    rows = {row[:4]: SimpleNamespace(n=row[4], bias=row[5], rmse=row[6]) for row in found}
    liar = planted.liar
    assert rows[liar, "vx", "all", "all"].bias == pytest.approx(planted.thrust / 2, abs=ROUNDING)
    assert rows[liar, "vx", "all", "all"].rmse == pytest.approx(planted.thrust / np.sqrt(2), abs=ROUNDING)
    assert rows[liar, "vx", "all", "partly"].n == 2
    assert rows[liar, "vx", "> 10", "submerged"].bias == pytest.approx(planted.thrust, abs=ROUNDING)
    assert (rows[liar, "vx", "< 0.5", "submerged"].n, rows[liar, "vx", "< 0.5", "submerged"].rmse) == (0, None)
    assert all(row.rmse == 0 for key, row in rows.items() if row.n and (key[0] != liar or key[1] != "vx"))


def test_the_truth_is_there_to_measure_errors_by(study):
    """Submerged at 20 m/s: k = ½ · 1.25 · 10, and v is divided by 1 + k |v| dt in a step; buoyancy is 1.25 g."""
    rows = {row[:4]: row[7] for row in errors(study.planted, Slush(), links_at([-3], [20.0]), PHYSICS)}
    divisor = 1 + 0.5 * 1.25 * 10 * 20 / 60
    assert rows[0, "vx", "all", "all"] == pytest.approx(60 * (20 - 20 / divisor), rel=1e-5)
    assert rows[0, "vy", "all", "all"] == pytest.approx(1.25 * 9.8, rel=1e-4)


def test_member_errors_are_along_the_champions_of_the_arm(study, planted):
    rows = member_errors(planted)
    whole = {row.member: row for row in rows if (row.component, row.band, row.immersion) == ("vx", "all", "all")}
    assert whole[0].n_rows == study.trace.shape[1] * 6 * 6 and whole[0].rmse == 0 < whole[study.planted.liar].rmse
    assert {(row.environment, row.depth) for row in rows} == {("residual_slush", 9.0)}


def test_the_best_champion_is_filmed_in_true_slush_and_where_it_evolved(study, planted):
    rows = filmed_links(planted)
    best = int(np.argmax(study.true))
    assert {row.trial for row in rows} == {best} and {row.seen_in for row in rows} == {"true_slush", "residual_slush"}
    in_slush = [row.disagreement for row in rows if row.seen_in == "true_slush"]
    expected = disagreement(study.designs[best : best + 1], study.trace[best : best + 1], study.planted, PHYSICS)
    assert np.array(in_slush) == pytest.approx(expected.ravel()) and rows[1].link == 1
    assert link_states(study.designs, study.trace, PHYSICS).y.shape[1] * 6 == len(in_slush)


def test_the_best_is_the_best_where_it_evolved_if_none_survives(planted):
    lost = [replace(champion, zero_shot=np.nan, fitness=float(k == 4)) for k, champion in enumerate(planted.champions)]
    assert best_of(lost).trial == 4
    assert median_member(np.array([3.0, np.nan, 1.0, 2.0])) == 3 and median_member(np.array([2.0, 1.0])) == 1
