"""What the paper leaves open, each way it can be set: both engines still agree in every float of every step."""

from typing import Any

import numba
import numpy as np
import pytest
from both_engines import assert_equal

from tasks.design import random_designs
from tasks.simulation import batch
from tasks.simulation.simd.lanes import widest
from tasks.world import DryLand, Environment, Physics, Slush, TrueSlush

PHYSICS: dict[str, dict[str, Any]] = {
    "peak to peak": {"range_of_motion": "peak_to_peak"},
    "slow motors": {"max_motor_speed": 0.4},
}

N_DESIGNS = widest() + 1
"""Designs for each way, drawn anew in each run: more than there are lanes."""

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


@pytest.mark.parametrize("depth", [0.3, 9.0])
def test_drag_by_component(depth: float, collide: bool, same_libm: None, seed: int) -> None:
    designs = random_designs(N_DESIGNS, np.random.default_rng(seed))
    physics, environment = Physics(link_collisions=collide), TrueSlush(depth, Slush(drag="by_component"))
    motion = assert_equal(designs, environment, physics, n_settle=60, n_measure=240)
    otherwise = batch.roll_out(designs, TrueSlush(depth), physics, n_settle=60, n_measure=240, trace=False)
    assert (motion.final != otherwise.final).any(axis=(0, 2, 3)).mean() > 0.9
