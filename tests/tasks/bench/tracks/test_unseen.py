"""Errors on throws that a medium was not fitted to, in fluids whose laws are known."""

import numpy as np
import pytest

from tasks.bench.tracks.unseen import Unseen, errors_on, findings
from tasks.residual import MeasuredTransitions, Throws, initial_states, simulate_throws
from tasks.world import ENVIRONMENTS, Physics, Slush

PHYSICS = Physics()
FLOWING = ENVIRONMENTS["flowing_slush"].environment(0.0, ENVIRONMENTS["flowing_slush"].settings()).medium


def thrown(medium) -> MeasuredTransitions:
    throws = Throws(n_throws=20, y_reach=2.0, max_velocity=4.0, max_omega=3.0)
    exact = simulate_throws(initial_states(throws, np.random.default_rng(3)), 60, medium, PHYSICS)
    noise = np.random.default_rng(4).normal(scale=1e-6, size=exact.residual.shape).astype(np.float32)
    columns = exact.columns() | {"next_in_target": exact.next_in_target + noise}
    return MeasuredTransitions(**columns, residual_sd=np.ones_like(noise), held_out=np.ones(len(exact), dtype=bool))


def test_the_medium_itself_follows_throws_to_their_ends_and_another_does_not() -> None:
    """With ten times the drag bars hardly move: the error is most of the way that they go."""
    right, wrong = (errors_on(thrown(Slush()), Slush(linear_drag=drag), PHYSICS, 0.0) for drag in (10.0, 100.0))
    assert right.error == pytest.approx(0, abs=1e-4) and right.mirrored == pytest.approx(right.error, abs=1e-4)
    assert right.depth == pytest.approx(1, abs=0.3)
    assert wrong.error > 0.2


def test_a_fluid_that_flows_has_no_mirror_image() -> None:
    found = errors_on(thrown(FLOWING), FLOWING, PHYSICS, 0.0)
    assert found.error < 1e-4 < 0.1 < found.mirrored
    (said,) = findings([found, found])
    assert "has none" in said and "network.form=signed_angle" in said


@pytest.mark.parametrize(
    ("folds", "said"),
    [
        ([Unseen(0.05, 0.05, 3.0, 0.9)], ()),  # errors that do not matter
        ([Unseen(0.3, 0.3, 1.0, 0.3)], ()),
        ([Unseen(0.3, 0.3, 1.0, 0.9), Unseen(0.2, 0.2, 1.0, 0.8)], ("memory",)),
        ([Unseen(0.3, 0.3, 2.0, 0.2)], ("depth",)),
        ([Unseen(0.2, 0.4, 0.5, 0.8)], ("mirror", "r = 0.80", "deep ones are 0.5 times")),
        ([Unseen(0.3, 0.3, float("nan"), float("nan"))], ()),  # throws too short, or too dry, to tell
    ],
)
def test_what_is_wrong_is_said_where_errors_matter(folds, said) -> None:
    found = findings(folds)
    assert len(found) == len(said)
    assert all(words in line for words, line in zip(said, found, strict=True))
