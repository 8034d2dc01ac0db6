"""How much of what robots do lies within the throws."""

import numpy as np
import pytest

from tasks.analysis.coverage import EVERYTHING, coverage, observed_states
from tasks.design import random_designs
from tasks.residual import OBSERVATION, Throws, initial_states, simulate_throws
from tasks.simulation import simulate
from tasks.world import DryLand, Physics, Slush

SCALE = np.array([0.6, 1.2, 0.7, 1.2, 1.2, 1.0])  # typical deviations of evolved robots in slush
DESIGNS = random_designs(24, np.random.default_rng(3))


def robots(environment):
    rollouts = simulate(DESIGNS, environment, trace=True)
    return observed_states(DESIGNS, rollouts, n_settle=200, rng=np.random.default_rng(0))


def thrown(throws):
    starts = initial_states(throws, np.random.default_rng(1))
    return simulate_throws(starts, throws.n_steps_of(Physics()), Slush(), Physics()).observation


@pytest.fixture(scope="module")
def movers():
    return robots(DryLand(depth=0.0))


@pytest.fixture(scope="module")
def designed():
    return thrown(Throws(design="robots", n_throws=2000, n_steps=None))


def outside(rows):
    return {row.component: row.share_outside for row in rows}


def test_a_state_is_outside_beyond_one_unit_of_its_nearest_throw():
    rng = np.random.default_rng(0)
    states, throws, scale = rng.normal(size=(40, 6)), rng.normal(size=(60, 6)), rng.uniform(0.5, 2, 6)
    apart = (states[:, None] - throws) / scale
    distance = np.linalg.norm(apart, axis=2)
    component = np.abs(apart[np.arange(40), distance.argmin(axis=1)]).argmax(axis=1)
    whole, *parts = coverage(states, throws, scale)
    assert (whole.median, whole.far) == pytest.approx(
        (np.median(distance.min(axis=1)), np.quantile(distance.min(1), 0.95))
    )
    outside = distance.min(axis=1) > 1
    assert [whole.share_outside, *(row.share_outside for row in parts)] == pytest.approx(
        [outside.mean(), *((outside & (component == k)).mean() for k in range(6))]
    )


def test_throws_for_robots_cover_them_better_than_the_papers(movers, designed):
    """With as many transitions as the paper's throws of the same study."""
    papers = thrown(Throws(n_throws=len(designed) // 200))
    shares = [outside(coverage(movers, throws, SCALE))[EVERYTHING] for throws in (designed, papers)]
    assert shares[0] < 0.5 * shares[1]


@pytest.mark.parametrize("component", ["vx", "vy", "omega"])
def test_a_planted_hole_is_found_by_name(movers, designed, component):
    """Without fast throws along one component, the states of fast robots are outside because of it."""
    k, scale = OBSERVATION.index(component), SCALE
    slow = np.abs(designed[:, k]) < 0.3 * scale[k]
    whole, holed = (outside(coverage(movers, throws, scale)) for throws in (designed, designed[slow]))
    gained = {name: holed[name] - whole[name] for name in OBSERVATION}
    beyond = np.abs(movers[:, k]) > 1.3 * scale[k]  # farther than 1 from every throw
    assert max(gained, key=gained.get) == component and holed[component] >= 0.9 * beyond.mean() > 0.01
    row = next(row for row in coverage(movers, designed[slow], scale) if row.component == component)
    assert max(abs(row.low), abs(row.high)) > 1.3 * scale[k]


def test_states_are_those_of_settled_links():
    rollouts = simulate(DESIGNS, DryLand(depth=0.0), trace=True)
    rows = robots(DryLand(depth=0.0))
    assert rows.shape == (24 * 6 * 60, 6) and np.isin(rows[:, 0], DESIGNS.length_scale.astype(np.float32)).all()
    settled = rollouts.trace[:, 200::20]
    assert np.isin(rows[:, 1], settled[..., 1]).all() and np.isin(rows[:, 5], settled[..., 5]).all()


def test_no_states_are_refused(designed):
    with pytest.raises(ValueError, match="0 states of robots and"):
        coverage(designed[:0], designed, np.ones(6))
