"""Controllers in the engines: what a joint senses, and the speed of its motor. Paper, "Evolutionary Design".

The target θ* is the joint's rest angle and the angle of the controller's law (tasks/design/controllers). The motor's
speed is gain · (θ* - θ), within the limit ``physics.max_motor_speed``.

Both engines must agree on θ* to the last bit, and platforms differ in the last bit of their sine. So the sine here is a
polynomial in single precision. Its argument is in turns, so that whole turns are subtracted without rounding.
"""

from __future__ import annotations

import numpy as np

from tasks.arrays import Bools, Float32
from tasks.compiled import formula
from tasks.design.controllers import Joint, controller_named
from tasks.design.gait import joints_of
from tasks.design.genes import Designs
from tasks.simd.lanes import Numeric, floor, select
from tasks.simulation.box2d import TOTAL_RADIUS, Column, top_of_ground
from tasks.world.physics import Physics
from tasks.world.slush import lowest_corner, submerged_part

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
def sensing(
    joint: Joint,
    angle: Numeric,
    speed: Numeric,
    length: Numeric,
    y: Numeric,
    cos: Numeric,
    sin: Numeric,
    spin: Numeric,
    ground: Numeric,
) -> Joint:
    """Return a joint that also senses itself, its link's state, and ground whose top is at a height.

    A link of 1 m² is in contact where Box2D makes contact points: within the skins of both polygons.
    """
    wet, _ = submerged_part(length, y, cos, sin)
    contact = select(lowest_corner(length, y, cos, sin) <= ground + TOTAL_RADIUS, 1.0, 0.0)
    periods, amplitude, phase, gains, dt, memory, above, told = joint[:8]
    return Joint(periods, amplitude, phase, gains, dt, memory, above, told, angle, speed, cos, sin, spin, wet, contact)


@formula
def motor_speed(target: Numeric, joint_angle: Numeric, gain: Numeric, limit: Numeric) -> Numeric:
    """Return the motor speed gain · (θ* - θ), within its limit [rad/s]."""
    wanted = gain * (target - joint_angle)
    below = select(wanted > limit, limit, wanted)
    return select(below < -limit, -limit, below)


def fastest(physics: Physics) -> np.float32:
    """Return the limit of the motors' speed [rad/s]; infinite if there is none."""
    return np.float32(np.inf if physics.max_motor_speed is None else physics.max_motor_speed)


class Controllers:
    """Controllers of designs in a rollout of an engine in NumPy, in its precision, with what they remember."""

    def __init__(self, designs: Designs, physics: Physics, depth: float) -> None:
        """Begin without memories; ``physics.time_step`` is the time between two targets."""
        single = np.float32
        jointed = designs.parent >= 0
        self.motor_on: Bools = designs.motor_on & jointed  # (n_designs, n_links); False for the root, without a joint
        self.controller = controller_named(designs.controller)
        self._jointed, self._parent = jointed, np.maximum(designs.parent, 0)
        self._frequency, self._rest, self._length = (
            array.astype(single) for array in (designs.frequency[:, None], designs.rest_angle, designs.length_scale)
        )
        self._dt, self._ground = single(physics.time_step), top_of_ground(depth)
        amplitude, phase, gains = (array.astype(single) for array in joints_of(designs, designs.frequency)[1:4])
        self._joint = Joint(None, amplitude, phase, gains, self._dt, *[single(0)] * 3)

    def target_angle(self, step: int, state: Float32, cos: Float32, sin: Float32) -> Float32:
        """Return the target angles between child and parent in a step; (n_members, n_designs, n_links) [rad].

        Args:
            step: number of the step; the next call is of the next step.
            state: (n_members, n_designs, n_links, 6) states of the links.
            cos: (n_members, n_designs, n_links) cosines of their angles.
            sin: sines of the same angles.
        """
        joint = self._joint._replace(periods=self._frequency * (np.float32(step) * self._dt))
        if self.controller.senses:
            angle, omega, y = (state[..., column] for column in (Column.ANGLE, Column.OMEGA, Column.Y))
            turned, speed = self.less_parent(angle) - self._rest, self.less_parent(omega)
            joint = sensing(joint, turned, speed, self._length, y, cos, sin, omega, self._ground)
        with np.errstate(invalid="ignore", over="ignore"):  # of robots that have diverged
            angle = self.controller.law(joint, sine_of_turns)
            if self.controller.remembers:
                angle, *kept = angle
                memory, tells = (np.where(self._jointed, number, np.float32(0)) for number in kept)
                self._joint = self._joint._replace(
                    memory=memory, memory_above=self._of_parent(memory), told=self._of_children(tells)
                )
        target: Float32 = self._rest + np.broadcast_to(angle, state.shape[:-1])
        return target

    def less_parent(self, quantity: Float32) -> Float32:
        """Return an angle or angular velocity of each link less its parent's; (..., n_links), of the root 0."""
        return quantity - self._of_parent(quantity)

    def _of_parent(self, quantity: Float32) -> Float32:
        return np.take_along_axis(quantity, np.broadcast_to(self._parent, quantity.shape), axis=-1)

    def _of_children(self, quantity: Float32) -> Float32:
        """Return the sum of a quantity of each link's children, which the batch engine adds up in the same order."""
        sums, n_links = np.zeros_like(quantity), quantity.shape[-1]
        for child in range(1, n_links):
            sums += np.where(
                self._parent[:, child, None] == np.arange(n_links), quantity[..., child, None], np.float32(0)
            )
        return sums
