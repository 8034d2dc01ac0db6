"""Which throws to make next."""

import numpy as np
import pytest

from tasks.residual import OBSERVATION, robot_ranges, suggest_throws
from tasks.residual.ensemble import Ensemble
from tasks.residual.suggestion import ThrowLimits
from tasks.residual.support import distances
from tasks.world import Physics

RANGES = robot_ranges(Physics())


def states(n, seed, most_spin=4.0):
    rng = np.random.default_rng(seed)
    columns = (rng.uniform(1, 3, n), *rng.uniform(-2, 2, (1, n)), rng.uniform(-1, 1, n), *rng.uniform(-3, 3, (2, n)))
    return np.column_stack((*columns, rng.uniform(-most_spin, most_spin, n))).astype(np.float32)


def ensemble(seed=0, n_members=3):
    rng = np.random.default_rng(seed)
    weights = [rng.normal(size=(n_members, a, b)).astype(np.float32) for a, b in ((6, 8), (8, 3))]
    return Ensemble(tuple(weights), tuple(np.zeros((n_members, b), np.float32) for b in (8, 3)))


def suggested(n=40, pilots=None, thrown=None, members=None, seed=5):
    pilots = states(2000, 1) if pilots is None else pilots
    thrown = states(2000, 2, most_spin=1.0) if thrown is None else thrown  # a hole: no throw with |ω| > 1
    return suggest_throws(n, pilots, thrown, members or ensemble(), np.random.default_rng(seed))


def test_half_of_them_cover_the_range_and_half_fill_the_hole():
    starts = suggested()
    omega = np.abs(starts.state[:, 5])
    assert np.mean(omega[20:] > 1) > 0.9 and len(starts) == 40 and starts.throw.tolist() == [*range(40)]
    for column, reach in ((1, RANGES.y_reach), (3, RANGES.max_velocity), (5, RANGES.max_omega)):
        even = starts.state[:20, column] / reach
        assert even.min() < -0.7 and even.max() > 0.7


def test_holes_are_filled_where_pilots_go():
    pilots, starts = states(2000, 1), suggested()
    observed = np.column_stack(
        (starts.length_scale, starts.state[:, 1], np.cos(starts.state[:, 2]), starts.state[:, 3:])
    )
    found = distances(observed[20:], pilots, np.ones(len(OBSERVATION)))
    assert found.distance == pytest.approx(0, abs=1e-4)
    assert len(np.unique(starts.state[20:], axis=0)) == 20


def test_members_that_agree_leave_distance_from_no_throw():
    """Where members agree everywhere there is nothing to learn by disagreement, and any pilot will do."""
    one = ensemble(n_members=1)
    same = Ensemble(tuple(np.repeat(w, 3, axis=0) for w in one.weights), tuple(np.repeat(b, 3, 0) for b in one.biases))
    assert np.isfinite(suggested(members=same).state).all()


def test_states_beyond_the_range_of_robots_are_not_suggested():
    wild = states(500, 1)
    wild[:, 1] = 17.0
    starts = suggested(pilots=wild)
    assert (np.abs(starts.state[:, 1]) <= RANGES.y_reach).all() and len(starts) == 40


def test_the_same_generator_gives_the_same_starts():
    assert (suggested().state == suggested().state).all() and (suggested().state != suggested(seed=6).state).any()


def test_what_can_not_be_thrown_is_not_suggested():
    limits = ThrowLimits(max_velocity=1.5, max_omega=0.8, heights=(-0.5, 1.0), lengths=(1.0, 1.5, 3.0))
    starts = suggest_throws(40, states(2000, 1), states(500, 2), ensemble(), np.random.default_rng(5), limits=limits)
    assert len(starts) == 40 and set(starts.length_scale) == {1.0, 1.5, 3.0}
    assert np.hypot(*starts.state[:, 3:5].T).max() <= 1.5 + 1e-6 and np.abs(starts.state[:, 5]).max() <= 0.8
    assert starts.state[:, 1].min() >= -0.5 and starts.state[:, 1].max() <= 1.0
    assert np.hypot(*starts.state[:20, 3:5].T).max() > 1.2  # the whole range of what can be thrown


def test_heights_that_can_be_thrown_from_are_covered_evenly():
    limits = ThrowLimits(heights=(-0.5, 1.0))
    starts = suggest_throws(40, states(2000, 1), states(500, 2), ensemble(), np.random.default_rng(5), limits=limits)
    counts, _ = np.histogram(starts.state[:20, 1], bins=4, range=(-0.5, 1.0))
    assert counts.sum() == 20 and counts.min() >= 3


def test_heights_at_which_no_robot_has_a_link_are_refused():
    limits = ThrowLimits(heights=(4.0, 5.0))
    with pytest.raises(ValueError, match="heights are 4 to 5 m, expected some within 3 m of the surface"):
        suggest_throws(4, states(200, 1), states(50, 2), ensemble(), np.random.default_rng(5), limits=limits)


def test_bars_are_refused_if_none_is_like_a_link():
    start = (states(200, 1), states(50, 2), ensemble(), np.random.default_rng(5))
    with pytest.raises(ValueError, match=r"bars are 0.5 and 4 m long, expected one of 1 to 3 m"):
        suggest_throws(4, *start, limits=ThrowLimits(lengths=(4.0, 0.5)))
    starts = suggest_throws(4, *start, limits=ThrowLimits(lengths=(4.0, 0.99)))
    assert set(starts.length_scale) <= {4.0, 0.99}


def test_a_number_below_one_is_refused():
    with pytest.raises(ValueError, match="n is 0, expected at least 1 throw"):
        suggested(n=0)
