"""Environments: a depth that is one, and the medium that goes with the name."""

import re
from collections.abc import Callable

import pytest

from tasks.world import DryLand, Environment, LinkStates, Physics, ResidualSlush, TrueSlush, VelocityChange


class StillEnsemble:
    """Three members that change nothing."""

    n_members = 3

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        return VelocityChange(vx=0 * links.vx, vy=0 * links.vy, omega=0 * links.omega)


ENSEMBLE = StillEnsemble()


def residual_slush(depth: float) -> ResidualSlush:
    return ResidualSlush(depth=depth, ensemble=ENSEMBLE)


ENVIRONMENTS = [DryLand, TrueSlush, residual_slush]


@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.parametrize("depth", [-1e-9, -9, float("nan"), float("inf"), True, "1", None])
def test_other_depths_are_refused(environment: Callable[[float], Environment], depth: float) -> None:
    message = f"depth is {depth!r}, expected a finite number of metres, at least 0"
    with pytest.raises(ValueError, match=re.escape(message)):
        environment(depth)


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
