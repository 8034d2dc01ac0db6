"""The controller: a sine good to its stated error, and θ*(t) = rest + range · sin(2π f t + phase)."""

import numpy as np

from tasks.design import random_designs
from tasks.simulation.controller import Controllers, sine_of_turns

DT = 1 / 60
EPS32 = 2.0**-24
"""Relative rounding of float32."""


def test_the_sine_is_as_good_as_stated() -> None:
    turns = np.concatenate([np.linspace(-2, 2, 400_001), np.random.default_rng(41).uniform(-100, 100, 200_000)])
    turns = turns.astype(np.float32)
    sine = sine_of_turns(turns)
    assert sine.dtype == np.float32
    # Whole turns come off exactly, so that the error is the polynomial's at any number of turns.
    assert np.abs(sine - np.sin(2 * np.pi * turns.astype(np.float64))).max() < 3e-7


def test_the_target_angle() -> None:
    designs = random_designs(50, np.random.default_rng(42))
    controllers = Controllers.of(designs)
    for step in (0, 1, 199, 1399, 5999):
        expected = designs.rest_angle + designs.motion_range * np.sin(
            2 * np.pi * designs.frequency[:, None] * step * DT + designs.phase
        )
        # Turns are counted up to f t + 1, rounded in f, in dt, in their products and in the sum: five times. The rest
        # is the sine's own error and the rounding of two numbers up to 5 rad.
        turns = designs.frequency[:, None] * step * DT + 1
        tolerance = np.pi / 2 * (2 * np.pi * 5 * EPS32 * turns + 3e-7) + 3 * EPS32 * 5
        assert (np.abs(controllers.target_angle(step, DT) - expected)[:, 1:] <= tolerance).all()
