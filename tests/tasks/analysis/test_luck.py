from dataclasses import replace

import numpy as np
import pytest

from tasks.analysis.luck import jittered, luck, reach
from tasks.design import check, random_designs
from tasks.simulation import simulate
from tasks.world import TrueSlush


def rng(seed=0):
    return np.random.default_rng(seed)


def test_attachments_move_by_the_jitter_and_nothing_else_does():
    designs = random_designs(50, rng())
    upper, lower = designs.parent_attachment.copy(), designs.child_attachment.copy()
    upper[:, 1], lower[:, 2] = 1.0, -1.0  # at the bounds
    designs = replace(designs, parent_attachment=upper, child_attachment=lower)
    moved = jittered(designs, rng(1))
    check(moved)
    for name, array in designs.arrays():
        change = getattr(moved, name) - array if name != "motor_on" else moved.motor_on ^ array
        if name in ("parent_attachment", "child_attachment"):
            assert np.abs(change[:, 1:]) == pytest.approx(1e-4) and (change[:, 0] == 0).all()
            assert 0.4 < (change[:, 3:] > 0).mean() < 0.6  # of 150: four deviations are 0.16
        else:
            assert not change.any(), name


def chaotic(designs):
    """Uniform over 0 to 10, and anew for the least change of an attachment."""
    return 10 * np.mod(1e9 * np.pi * designs.parent_attachment[:, 1], 1)


def test_a_winner_of_many_was_lucky():
    """The best of 500 uniform numbers is 10 · 500/501; tries are uniform, with a mean of 5 ± 2.9 / √64."""
    designs = random_designs(500, rng(2))
    champion = designs[chaotic(designs).argmax()]
    found = luck(champion, chaotic, rng=rng(3), n_tries=64)
    assert found.claimed[0] > 9.9
    assert found.loss[0].low < 5 < found.loss[0].high
    assert found.loss[0].value == pytest.approx(5, abs=4 * 2.9 / 8)
    assert found.share_below[0] > 0.9


def test_a_smooth_fitness_is_no_luck():
    found = luck(random_designs(3, rng()), lambda d: d.length_scale.sum(axis=1), rng=rng(), n_tries=5)
    assert (found.again == found.claimed[:, None]).all() and found.again.shape == (3, 5)
    assert [loss.value for loss in found.loss] == [0.0] * 3 and (found.share_below == 0).all()


def test_designs_keep_their_own_tries():
    found = luck(random_designs(4, rng()), lambda d: d.frequency, rng=rng(), n_tries=3)
    assert (found.again == found.claimed[:, None]).all() and len(set(found.claimed)) == 4


def test_everything_is_simulated_at_once():
    calls = []
    luck(random_designs(4, rng()), lambda d: calls.append(len(d)) or np.zeros(len(d)), rng=rng(), n_tries=3)
    assert calls == [16]


def test_what_diverged_says_so():
    scored = np.array([[np.nan, 1.0, 5.0], [1.0, np.nan, 4.0], [1.0, -np.inf, np.nan]])  # as evolved, and two tries
    found = luck(random_designs(3, rng()), lambda d: scored.ravel(), rng=rng(), n_tries=2)
    assert [loss.reason for loss in found.loss] == [
        "the design itself diverges",
        "all of 2 tries diverged",
        "1 value, an interval needs 2 or more",
    ]
    assert found.loss[2].value == 1.0 and found.n_diverged.tolist() == [0, 2, 1]
    assert np.isnan(found.share_below[:2]).all() and found.share_below[2] == 1.0


def test_slush_forgives_what_evolution_could_not_know():
    """In deep slush the motion is smooth, so 1e-4 of half a height moves a robot by about as little."""
    designs = random_designs(4, rng(4))

    def displacement(designs):
        return simulate(designs, TrueSlush(depth=9.0), n_settle=20, n_measure=100, engine="reference").displacement

    found = luck(designs, displacement, rng=rng(5), n_tries=2)
    assert np.abs(found.again - found.claimed[:, None]).max() < 0.02
    assert (found.again != found.claimed[:, None]).any()


def test_reach_is_what_the_robot_did_not_move():
    found = reach(np.array([5.0, 3.0, np.nan]), np.array([1.0, 3.5, np.nan]))
    assert found.reach == pytest.approx([4.0, -0.5, np.nan], nan_ok=True)
