"""The gait: how far each joint's motor turns it from its rest angle, over time. Paper, "Evolutionary Design".

    swing = A · sin(2π (f t + phase))        target angle = rest angle + swing

with one frequency f per robot; the amplitude A is the joint's range of motion. Everything that moves a joint calls
:func:`swing`: both engines, the constraints on designs, and the servos of a robot that was built. Only this module
knows the formula and what follows from it.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tasks.arrays import Float64
from tasks.compiled import formula
from tasks.design.genes import Designs

TURN = 2 * np.pi  # [rad]
AMPLITUDE, PHASE = range(2)  # numbers of a joint's gait: [rad], [turns]
N_NUMBERS = 2


def gaits_of(designs: Designs) -> Float64:
    """Return (N_NUMBERS, n_designs, n_links) numbers of the joints' gaits; a root's are ignored."""
    return np.stack([designs.motion_range, designs.phase / TURN])


@formula
def swing(gait: Any, periods: Any, sine: Callable[[Any], Any]) -> Any:
    """Return the angles from rest that gaits command [rad].

    Args:
        gait: N_NUMBERS numbers by index; each a number, an array, or SIMD lanes in a kernel.
        periods: f t, time in periods of the gait.
        sine: sine of an angle in turns, in the precision of both.
    """
    return gait[AMPLITUDE] * sine(periods + gait[PHASE])


def sine(turns: Float64) -> Float64:
    """Return the sine of angles in turns in double precision; the engines have one of their own."""
    return np.sin(TURN * turns)


def reach(designs: Designs) -> Float64:
    """Return the largest angle from rest that each joint's gait commands, (n_designs, n_links) [rad]."""
    return designs.motion_range


def top_speed(designs: Designs) -> Float64:
    """Return the highest speed that each joint's gait commands, (n_designs, n_links) [rad/s]."""
    return TURN * designs.frequency[:, None] * designs.motion_range


def begun_later(designs: Designs, angle: float) -> Designs:
    """Return designs whose gaits begin later, by an angle of the first harmonic [rad]."""
    return replace(designs, phase=(designs.phase + angle) % TURN)
