"""The controller: target angle of each joint's motor in each step. Paper, "Evolutionary Design".

θ*(t) = rest + A · sin(2π f t + phase), with one frequency f per robot. The amplitude A is the joint's range of motion,
or half of it, as the setting ``physics.range_of_motion`` has it. The motor's speed is gain · (θ* - θ), within the limit
``physics.max_motor_speed``.

Both engines must agree on θ* to the last bit, and platforms differ in the last bit of their sine. So the sine here is a
polynomial in single precision. Its argument is in turns, so that whole turns are subtracted without rounding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tasks.arrays import Bools, Float32
from tasks.design.genes import Designs
from tasks.world.physics import Physics, RangeOfMotion

TURN = 2 * np.pi  # [rad]

SINE_OF_TURNS = (6.283185, -41.341656, 81.601, -76.54965, 39.535793)
"""Coefficients of the odd powers of r in sin(2π r) for |r| ≤ 1/4: least squares on Chebyshev nodes, error 2e-7."""


def sine_of_turns(turns: Float32) -> Float32:
    """Compute the sine of an angle in turns, in float32 throughout; the absolute error is below 3e-7."""
    c1, c3, c5, c7, c9 = (np.float32(c) for c in SINE_OF_TURNS)
    half, quarter = np.float32(0.5), np.float32(0.25)
    r = turns - np.floor(turns + half)
    folded = quarter - np.abs(np.abs(r) - quarter)  # sin(π - α) = sin α
    square = folded * folded
    sine = folded * (c1 + square * (c3 + square * (c5 + square * (c7 + square * c9))))
    signed: Float32 = np.where(r < 0, -sine, sine).astype(np.float32)
    return signed


def fastest(physics: Physics) -> np.float32:
    """Return the limit of the motors' speed [rad/s]; infinite if there is none."""
    return np.float32(np.inf if physics.max_motor_speed is None else physics.max_motor_speed)


AMPLITUDE: Mapping[RangeOfMotion, float] = {"amplitude": 1.0, "peak_to_peak": 0.5}
"""Amplitude of an oscillation over the joint's range of motion."""


@dataclass(frozen=True, eq=False)
class Controllers:
    """Controllers of designs, rounded once to the engines' precision."""

    frequency: Float32  # (n_designs, 1) [Hz]
    phase_turns: Float32  # (n_designs, n_links) [turns]
    amplitude: Float32  # (n_designs, n_links) [rad]
    rest_angle: Float32  # (n_designs, n_links) [rad]
    motor_on: Bools  # (n_designs, n_links); False for the root, which has no joint

    @staticmethod
    def of(designs: Designs, range_of_motion: RangeOfMotion = "amplitude") -> Controllers:
        """Return the controllers of designs."""
        single = np.float32
        jointed = np.arange(designs.parent.shape[1]) > 0
        return Controllers(
            frequency=designs.frequency[:, None].astype(single),
            phase_turns=(designs.phase / TURN).astype(single),
            amplitude=(AMPLITUDE[range_of_motion] * designs.motion_range).astype(single),
            rest_angle=designs.rest_angle.astype(single),
            motor_on=designs.motor_on & jointed,
        )

    def target_angle(self, step: int, time_step: float) -> Float32:
        """Compute the target angles between child and parent in a step; (n_designs, n_links) [rad]."""
        time = np.float32(step) * np.float32(time_step)
        turns = self.frequency * time + self.phase_turns
        return self.rest_angle + self.amplitude * sine_of_turns(turns)
