"""An oscillator with reflexes: what a joint and its link sense moves the target angle, by gains that evolve.

    target = A · sin(2π (f t + phase)) + Σ gain · sensed

Box2D's motor follows its target at once unless its torque is too small, so the angle of the joint tells of its load.
"""

from collections.abc import Callable
from typing import Any

from tasks.design.controllers.controller import Controller, gain, register_controller
from tasks.design.controllers.open_loop import swing
from tasks.simd.lanes import select

ANGLE, SPEED, TILT, SPIN, WET, CONTACT = range(6)
FARTHEST = 1.5707964  # of the target from rest, either way [rad]


def law(joint: Any, sine: Callable[[Any], Any]) -> Any:
    """Return the target angle from rest, within a quarter turn either way [rad]."""
    gains = joint.gains
    target = (
        swing(joint, sine)
        + gains[ANGLE] * joint.angle
        + gains[SPEED] * joint.speed
        + gains[TILT] * joint.sin
        + gains[SPIN] * joint.spin
        + gains[WET] * joint.wet
        + gains[CONTACT] * joint.contact
    )
    below = select(target > FARTHEST, FARTHEST, target)
    return select(below < -FARTHEST, -FARTHEST, below)


register_controller(
    Controller(
        "reflex",
        law,
        genes=(
            gain("angle", 1.0, ""),
            gain("speed", 0.5, "s"),
            gain("tilt", 1.0, "rad"),
            gain("spin", 0.5, "s"),
            gain("wet", 1.0, "rad"),
            gain("contact", 1.0, "rad"),
        ),
        senses=("angle", "speed", "sin", "spin", "wet", "contact"),
    )
)
