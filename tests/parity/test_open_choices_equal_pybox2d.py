"""What the paper leaves open, each way it can be set: both engines still agree in every float of every step."""

from dataclasses import replace
from typing import Any

import numba
import numpy as np
import pytest
from both_engines import OTHER_CONSTANTS, STRONG_MOTORS, assert_equal, wild

from tasks.design import Designs, random_designs
from tasks.simulation import batch
from tasks.simulation.box2d import ANGULAR_SLOP, Column
from tasks.simulation.controller import Controllers
from tasks.simulation.simd.lanes import widest
from tasks.world import DryLand, Environment, Physics, Slush, TrueSlush

LIMITED: dict[str, Any] = {"joint_limits": "range_of_motion"}
PHYSICS: dict[str, dict[str, Any]] = {
    "limits": LIMITED,
    "peak to peak": {"range_of_motion": "peak_to_peak"},
    "limits, peak to peak": {**LIMITED, "range_of_motion": "peak_to_peak"},
    "motors that start after settling": {"motors_while_settling": False},
    "limits, motors that start after settling": {**LIMITED, "motors_while_settling": False},
    "root at the surface": {"spawn": "root_centre"},
    "slow motors": {"max_motor_speed": 0.4},
}
SLUSHES: dict[str, dict[str, Any]] = {
    "by component": {"drag": "by_component"},
    "euler": {"drag_integration": "euler"},
    "clamped euler": {"drag_integration": "clamped_euler"},
    "clamped euler by component": {"drag": "by_component", "drag_integration": "clamped_euler"},
}

N_DESIGNS = widest() + 1
"""Designs for each way, drawn anew in each run: more than there are lanes."""

LEAST_AMPLITUDE = 0.1  # of genes in their bounds, peak to peak [rad]; Box2D solves ranges below 0.07 rad otherwise

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="slow in Python; test_batch.py has a short one")


@pytest.fixture(params=[False, True], ids=["trees", "rigid bodies"])
def collide(request: pytest.FixtureRequest) -> bool:
    """Whether links collide, which the rigid-body engine computes."""
    return bool(request.param)


@pytest.mark.parametrize("changed", PHYSICS.values(), ids=PHYSICS)
@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(1.0), TrueSlush(9.0)], ids=["dry", "shallow", "deep"])
def test_physics(changed: dict[str, Any], environment: Environment, collide: bool, same_libm: None, seed: int) -> None:
    designs = random_designs(N_DESIGNS, np.random.default_rng(seed))
    physics = Physics(link_collisions=collide, **changed)
    motion = assert_equal(designs, environment, physics, n_settle=60, n_measure=180)
    usual = Physics(link_collisions=collide)
    otherwise = batch.roll_out(designs, environment, usual, n_settle=60, n_measure=180, trace=False)
    assert (motion.final != otherwise.final).any(axis=(0, 2, 3)).mean() > 0.5


@pytest.mark.parametrize("changed", SLUSHES.values(), ids=SLUSHES)
@pytest.mark.parametrize("depth", [0.3, 9.0])
def test_slush(changed: dict[str, Any], depth: float, collide: bool, same_libm: None, seed: int) -> None:
    designs = random_designs(N_DESIGNS, np.random.default_rng(seed))
    physics, environment = Physics(link_collisions=collide), TrueSlush(depth, Slush(**changed))
    motion = assert_equal(designs, environment, physics, n_settle=60, n_measure=240)
    otherwise = batch.roll_out(designs, TrueSlush(depth), physics, n_settle=60, n_measure=240, trace=False)
    assert (motion.final != otherwise.final).any(axis=(0, 2, 3)).mean() > 0.9


@pytest.mark.parametrize("environment", [DryLand(0.0), TrueSlush(2.0)], ids=["dry", "slush"])
def test_limits_of_groups_that_are_stepped_together(environment: Environment, same_libm: None, seed: int) -> None:
    designs = random_designs(2 * widest() + 5, np.random.default_rng(seed))
    assert_equal(designs, environment, Physics(**LIMITED), n_settle=200, n_measure=1200, trace=False)


@pytest.mark.parametrize("constants", [STRONG_MOTORS, OTHER_CONSTANTS], ids=["strong motors", "other constants"])
def test_limits_against_motors_far_beyond_the_paper_s_range(
    constants: dict[str, Any], collide: bool, same_libm: None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    designs = wild(random_designs(20, rng), rng, motor_on=0.6)
    designs = replace(designs, motion_range=np.maximum(designs.motion_range, LEAST_AMPLITUDE))
    physics = Physics(**LIMITED, **constants, link_collisions=collide)
    assert_equal(designs, TrueSlush(0.3), physics, n_settle=50, n_measure=450)


def joint_angles(designs: Designs, trace: np.ndarray) -> np.ndarray:
    """(n_designs, n_steps, n_joints) angles between child and parent [rad]."""
    angle = trace[0, ..., Column.ANGLE].astype(np.float64)
    parent = np.broadcast_to(designs.parent[:, None, 1:], angle[..., 1:].shape)
    return np.asarray(angle[..., 1:] - np.take_along_axis(angle, parent, axis=2))


def test_joints_stop_at_their_limits_with_and_without_motors() -> None:
    designs = random_designs(40, np.random.default_rng(3))
    lower, upper = (of[:, None, 1:] for of in Controllers.of(designs).limits())
    beyond = []
    for changed in ({}, LIMITED):
        physics = Physics(max_motor_torque=10.0, **changed)  # too weak to hold the robot's weight
        motion = batch.roll_out(designs, DryLand(0.0), physics, n_settle=200, n_measure=600, trace=True)
        assert motion.trace is not None
        angle = joint_angles(designs, motion.trace)
        beyond.append(np.maximum(lower - angle, angle - upper).max(axis=1))
    free, limited = beyond
    # Box2D tolerates its slop; a fast joint overshoots in the step in which it arrives, and is turned back.
    assert limited.max() < 4 * ANGULAR_SLOP
    for driven in (True, False):
        of_kind = designs.motor_on[:, 1:] == driven
        assert (free > 4 * ANGULAR_SLOP)[of_kind].sum() >= 2
        assert (limited > -1e-3)[of_kind].any()


def test_motors_that_start_after_settling_give_no_torque_before(seed: int) -> None:
    designs = random_designs(12, np.random.default_rng(seed))
    physics = Physics(motors_while_settling=False)
    idle = Physics(max_motor_torque=0.0)
    waiting, never = (
        batch.roll_out(designs, TrueSlush(9.0), of, n_settle=60, n_measure=30, trace=True) for of in (physics, idle)
    )
    assert waiting.trace is not None and never.trace is not None
    np.testing.assert_array_equal(waiting.trace[:, :, :60], never.trace[:, :, :60])
    moved = (waiting.trace[:, :, 60:] != never.trace[:, :, 60:]).any(axis=(0, 2, 3, 4))
    np.testing.assert_array_equal(moved, designs.motor_on[:, 1:].any(axis=1))
