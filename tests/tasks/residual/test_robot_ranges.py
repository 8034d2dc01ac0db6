"""The states that robots pass through, estimated in the base simulator."""

import numpy as np
import pytest
from pydantic import ValidationError

from tasks.design import random_designs
from tasks.residual import Throws, initial_states, robot_ranges
from tasks.simulation import simulate
from tasks.world import DryLand, Physics, TrueSlush

RANGES = robot_ranges(Physics())
THROWS = Throws(design="robots", n_throws=300, n_steps=None)


@pytest.mark.parametrize("environment", [DryLand(depth=0.0), TrueSlush(depth=2.0), TrueSlush(depth=9.0)])
def test_other_designs_stay_within_the_ranges_in_every_environment(environment):
    trace = simulate(random_designs(64, np.random.default_rng(11)), environment, trace=True).trace[:, 200:]
    assert np.mean(np.hypot(trace[..., 3], trace[..., 4]) < RANGES.max_velocity) > 0.99
    assert np.mean(np.abs(trace[..., 5]) < RANGES.max_omega) > 0.99


def test_a_throw_is_followed_until_gravity_takes_it_out_of_the_range():
    physics = Physics()
    assert THROWS.n_steps_of(physics) == round(RANGES.max_velocity / (physics.gravity * physics.time_step))
    assert Throws(design="robots", n_steps=70).n_steps_of(physics) == 70
    assert robot_ranges(Physics(gravity=0.0)).n_steps == 200


def test_starts_fill_the_ranges_evenly():
    low = [1.0, -RANGES.y_reach, 0, *[-RANGES.max_velocity] * 2, -RANGES.max_omega]
    high = [3.0, RANGES.y_reach, 2 * np.pi, *[RANGES.max_velocity] * 2, RANGES.max_omega]
    found = initial_states(THROWS, np.random.default_rng(3))
    columns = np.column_stack((found.length_scale, found.state[:, 1:]))
    unit = (columns - low) / np.subtract(high, low)
    # Every 64th of each axis holds exactly 4 of the first 256 points of a Sobol sequence.
    for column in unit[:256].T:
        assert np.histogram(column, 64, (0, 1))[0].tolist() == [4] * 64
    assert (found.state[:, 0] == 0).all() and len(found) == 300


@pytest.mark.parametrize("changed", [{"max_velocity": 3.0}, {"length_scales": (2.0,)}])
def test_ranges_that_the_design_ignores_are_refused(changed):
    (name,) = changed
    with pytest.raises(ValidationError, match=f"design is robots, which ignores {name}: expected the design paper"):
        Throws(design="robots", **changed)
