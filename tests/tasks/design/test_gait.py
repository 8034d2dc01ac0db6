"""The gait's extremes and shifts are those of its formula."""

import numpy as np

from tasks.design import random_designs
from tasks.design.gait import TURN, begun_later, reach, swing, top_speed

DESIGNS = random_designs(30, np.random.default_rng(3))
PERIODS = np.linspace(0.0, 1.0, 20_001)[:, None, None]


def test_reach_and_top_speed_are_the_extremes_over_a_period() -> None:
    angle = swing(DESIGNS, PERIODS)
    speed = np.diff(angle, axis=0) / PERIODS[1] * DESIGNS.frequency[:, None]
    np.testing.assert_allclose(np.abs(angle).max(axis=0), reach(DESIGNS), rtol=1e-6)
    np.testing.assert_allclose(np.abs(speed).max(axis=0), top_speed(DESIGNS), rtol=1e-6)


def test_a_gait_that_begins_later_is_shifted_in_time() -> None:
    later = swing(begun_later(DESIGNS, 1.3), PERIODS)
    np.testing.assert_allclose(later, swing(DESIGNS, PERIODS + 1.3 / TURN), rtol=0, atol=1e-12)
