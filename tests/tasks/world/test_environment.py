"""Environments: a depth that is one, and the constants that all share."""

import re

import pytest

from tasks.world import DryLand, Physics


@pytest.mark.parametrize("depth", [-1e-9, -9, float("nan"), float("inf"), True, "1", None])
def test_other_depths_are_refused(depth) -> None:
    message = f"depth is {depth!r}, expected a finite number of metres, at least 0"
    with pytest.raises(ValueError, match=re.escape(message)):
        DryLand(depth)


def test_the_base_simulators_constants() -> None:
    assert Physics().model_dump() == {
        "gravity": 9.8,
        "time_step": 1 / 60,
        "velocity_iterations": 8,
        "position_iterations": 3,
        "link_density": 1.0,
        "friction": 0.8,
        "restitution": 0.0,
        "motor_gain": 10.0,
        "max_motor_torque": 100.0,
        "passive_joints": "swing",
        "link_collisions": False,
    }
