"""The reference engine against the obvious script, which computes motors and slush by other means."""

import numpy as np
import pytest

from benchmarks import obvious
from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.world import Physics, Slush, TrueSlush


@pytest.mark.parametrize("design", range(4))
def test_the_engine_agrees_with_the_obvious_script(design: int) -> None:
    designs = random_designs(4, np.random.default_rng(65))
    trace = simulate(designs, TrueSlush(9.0), n_settle=0, n_measure=150, engine="reference", trace=True).trace
    assert trace is not None
    robot, expected = obvious.Robot(designs, design, 9.0, Physics(), Slush()), []
    for _ in range(150):
        robot.step()
        expected.append([(*link.position, link.angle) for link in robot.links])
    # The script computes motors and slush in float64: a rounding of 1e-7 apart at first, 2e-6 m or rad after 2.5 s.
    np.testing.assert_allclose(trace[design][..., :3], expected, rtol=0, atol=2e-5)
