"""The gait: how far each joint's motor turns it from its rest angle over time, as far as that is known beforehand.

The law is the controller's (:mod:`tasks.design.controllers`); here, of those that sense nothing but time.
"""

from dataclasses import replace

import numpy as np

from tasks.arrays import Float64
from tasks.design.controllers import OPEN_LOOP, Controller, Joint, controller_named
from tasks.design.gene import DesignError
from tasks.design.genes import Designs

TURN = 2 * np.pi  # [rad]
_INSTANTS = np.arange(256) / 256  # of a period, at which other controllers than the paper's are looked at


def joints_of(designs: Designs, periods: Float64) -> Joint:
    """Return what controllers know of joints without senses; periods broadcast to (..., n_designs, n_links)."""
    return Joint(periods, designs.motion_range, designs.phase / TURN, np.moveaxis(designs.gains, 1, 0))


def blind_controller(designs: Designs) -> Controller:
    """Return the designs' controller; raise DesignError if it needs more than the time."""
    controller = controller_named(designs.controller)
    if not controller.is_blind:
        raise DesignError(
            f"controller {controller.name} needs {controller.needs}, which servos and checks of gaits lack: "
            f"expected one that needs the time alone, such as {OPEN_LOOP}"
        )
    return controller


def swing(designs: Designs, periods: Float64) -> Float64:
    """Return the angles from rest that gaits command [rad], by f t, time in periods; (..., n_designs, n_links)."""
    angle: Float64 = blind_controller(designs).law(joints_of(designs, periods), lambda turns: np.sin(TURN * turns))
    return angle


def reach(designs: Designs) -> Float64:
    """Return the largest angle from rest that each joint's gait commands, (n_designs, n_links) [rad]."""
    if designs.controller == OPEN_LOOP:
        return designs.motion_range
    return np.asarray(np.abs(swing(designs, _INSTANTS[:, None, None])).max(axis=0))


def top_speed(designs: Designs) -> Float64:
    """Return the highest speed that each joint's gait commands, (n_designs, n_links) [rad/s]."""
    if designs.controller == OPEN_LOOP:
        return TURN * designs.frequency[:, None] * designs.motion_range
    angle = swing(designs, _INSTANTS[:, None, None])
    of_period = np.abs(np.roll(angle, -1, axis=0) - angle).max(axis=0) * len(_INSTANTS)
    return np.asarray(designs.frequency[:, None] * of_period)


def begun_later(designs: Designs, angle: float) -> Designs:
    """Return designs whose oscillators begin later, by an angle [rad]."""
    return replace(designs, phase=(designs.phase + angle) % TURN)
