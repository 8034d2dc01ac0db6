from dataclasses import replace

import numpy as np
import pytest

from tasks.analysis.luck import jittered, luck
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
    assert found.claimed > 9.9
    assert found.loss.low < 5 < found.loss.high
    assert found.loss.value == pytest.approx(5, abs=4 * 2.9 / 8)
    assert found.share_below > 0.9


def test_a_smooth_fitness_is_no_luck():
    champion = random_designs(1, rng())
    found = luck(champion, lambda d: d.length_scale.sum(axis=1), rng=rng(), n_tries=5)
    assert found.again == found.claimed == champion.length_scale.sum() and found.n_tries == 5
    assert (found.loss.value, found.share_below, found.n_diverged) == (0.0, 0.0, 0)


def test_everything_is_simulated_at_once():
    calls = []
    luck(random_designs(1, rng()), lambda d: calls.append(len(d)) or np.zeros(len(d)), rng=rng(), n_tries=3)
    assert calls == [4]


@pytest.mark.parametrize(
    ("scored", "value", "reason"),
    [  # as evolved, and two tries
        ([np.nan, 1.0, 1.0], None, "the design itself diverges"),
        ([1.0, np.nan, -np.inf], None, "all of 2 tries diverged"),
        ([5.0, 4.0, np.nan], 1.0, "1 value, an interval needs 2 or more"),
    ],
)
def test_a_loss_without_interval_gives_the_reason(scored, value, reason):
    found = luck(random_designs(1, rng()), lambda d: np.array(scored), rng=rng(), n_tries=2)
    assert (found.loss.value, found.loss.reason) == (value, reason)
    assert found.n_diverged == np.count_nonzero(~np.isfinite(scored[1:]))
    assert found.share_below == pytest.approx(np.nan if value is None else 1.0, nan_ok=True)


def test_slush_forgives_what_evolution_could_not_know():
    """In deep slush the motion is smooth, so 1e-4 of half a height moves a robot by about as little."""
    champion = random_designs(1, rng(4))

    def displacement(designs):
        return simulate(designs, TrueSlush(depth=9.0), n_settle=20, n_measure=100, engine="reference").displacement

    found = luck(champion, displacement, rng=rng(5), n_tries=2)
    assert 0 < abs(found.again - found.claimed) < 0.02
