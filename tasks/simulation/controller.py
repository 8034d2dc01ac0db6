"""The controller: target angle of each joint's motor in each step. Paper, "Evolutionary Design".

The target θ* is that of the gait (tasks/design/gait.py). The motor's speed is gain · (θ* - θ), within the limit
``physics.max_motor_speed``.

Both engines must agree on θ* to the last bit, and platforms differ in the last bit of their sine. So the sine here is a
polynomial in single precision. Its argument is in turns, so that whole turns are subtracted without rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tasks.arrays import Bools, Float32
from tasks.compiled import formula
from tasks.design.gait import gaits_of, swing
from tasks.design.genes import Designs
from tasks.simd.lanes import Numeric, floor, select
from tasks.world.physics import Physics

_QUARTER, _HALF = np.float32(0.25), np.float32(0.5)
_C1, _C3, _C5, _C7, _C9 = (np.float32(c) for c in (6.283185, -41.341656, 81.601, -76.54965, 39.535793))
"""Coefficients of the odd powers of r in sin(2π r) for |r| ≤ 1/4: least squares on Chebyshev nodes, error 2e-7."""


@formula
def sine_of_turns(turns: Numeric) -> Numeric:
    """Compute the sine of angles in turns, float32 numbers or lanes; the absolute error is below 3e-7."""
    r = turns - floor(turns + _HALF)
    folded = _QUARTER - abs(abs(r) - _QUARTER)  # sin(π - α) = sin α
    square = folded * folded
    sine = folded * (_C1 + square * (_C3 + square * (_C5 + square * (_C7 + square * _C9))))
    return select(r < 0.0, -sine, sine)


@formula
def target_angle(gait: Any, rest_angle: Numeric, periods: Numeric) -> Numeric:
    """Return the target angles of joints, by f t, time in periods of their gaits [rad]."""
    return rest_angle + swing(gait, periods, sine_of_turns)


@formula
def motor_speed(target: Numeric, joint_angle: Numeric, gain: Numeric, limit: Numeric) -> Numeric:
    """Return the motor speed gain · (θ* - θ), within its limit [rad/s]."""
    wanted = gain * (target - joint_angle)
    below = select(wanted > limit, limit, wanted)
    return select(below < -limit, -limit, below)


def fastest(physics: Physics) -> np.float32:
    """Return the limit of the motors' speed [rad/s]; infinite if there is none."""
    return np.float32(np.inf if physics.max_motor_speed is None else physics.max_motor_speed)


@dataclass(frozen=True, eq=False)
class Controllers:
    """Controllers of designs, rounded once to the engines' precision."""

    frequency: Float32  # (n_designs, 1) [Hz]
    gait: Float32  # (N_NUMBERS, n_designs, n_links) numbers of tasks.design.gait
    rest_angle: Float32  # (n_designs, n_links) [rad]
    motor_on: Bools  # (n_designs, n_links); False for the root, which has no joint

    @staticmethod
    def of(designs: Designs) -> Controllers:
        """Return the controllers of designs."""
        single = np.float32
        jointed = np.arange(designs.parent.shape[1]) > 0
        return Controllers(
            frequency=designs.frequency[:, None].astype(single),
            gait=gaits_of(designs).astype(single),
            rest_angle=designs.rest_angle.astype(single),
            motor_on=designs.motor_on & jointed,
        )

    def target_angle(self, step: int, time_step: float) -> Float32:
        """Compute the target angles between child and parent in a step; (n_designs, n_links) [rad]."""
        time = np.float32(step) * np.float32(time_step)
        angle: Float32 = target_angle(self.gait, self.rest_angle, self.frequency * time)
        return angle
