"""Calibration: which servo moves which joint, and which pulse puts it at which angle.

A hobby servo turns to the angle that the width of its pulses encodes, linearly within its travel:
pulse = centre + direction · us_per_rad · angle, where the angle is measured from the joint's rest angle, positive as in
the simulation. Servos differ, and a horn fits its spline only tooth by tooth, so the calibration in a kit is a first
guess: measure each servo once (docs/servo.md).
"""

from typing import Literal, Self

from pydantic import Field, model_validator

from tasks.design.genes import MOST_LINKS
from tasks.parameters import Parameters

_MIN_PULSE_US, _MAX_PULSE_US = 400.0, 2600.0  # hobby servos; a value outside is a typing error


class ServoCalibration(Parameters):
    """Calibration of one servo."""

    joint: int = Field(ge=1, lt=MOST_LINKS)
    """The joint that it moves, by the number of its child link."""
    channel: int = Field(ge=0, le=23)
    """Channel of the servo controller."""
    centre_us: float = Field(ge=_MIN_PULSE_US, le=_MAX_PULSE_US)
    """Neutral pulse, at which the joint is at rest [µs]."""
    direction: Literal[1, -1]
    """1 if longer pulses turn the child link counter-clockwise, seen with x to the right; else -1."""
    us_per_rad: float = Field(gt=0.0, le=10_000.0)
    """Change of the pulse per radian [µs/rad]."""
    min_us: float = Field(ge=_MIN_PULSE_US, le=_MAX_PULSE_US)
    """Shortest pulse that may be sent [µs]."""
    max_us: float = Field(ge=_MIN_PULSE_US, le=_MAX_PULSE_US)
    """Longest pulse that may be sent [µs]."""
    max_speed: float = Field(gt=0.0, le=100.0)
    """Fastest speed that may be commanded [rad/s]."""

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        limits = f"min_us is {self.min_us:g} and max_us is {self.max_us:g}"
        if self.min_us >= self.max_us:
            raise ValueError(f"{limits}, expected min_us < max_us. Are they swapped?")
        if not self.min_us <= self.centre_us <= self.max_us:
            raise ValueError(f"centre_us is {self.centre_us:g}, but {limits}, expected a value between them")
        return self

    @property
    def max_rate_us(self) -> float:
        """Fastest change of the pulse [µs/s]."""
        return self.max_speed * self.us_per_rad

    @property
    def reach(self) -> float:
        """Largest angle from rest that it reaches on both sides [rad]."""
        return min(self.max_us - self.centre_us, self.centre_us - self.min_us) / self.us_per_rad

    def angle(self, pulse_us: float) -> float:
        """Return the joint's angle from rest [rad] at a pulse."""
        return self.direction * (pulse_us - self.centre_us) / self.us_per_rad


class Calibration(Parameters):
    """Calibration of all servos of a robot."""

    servos: tuple[ServoCalibration, ...] = Field(min_length=1)
    """Servos in any order; two may share a joint, one in each pontoon."""

    @model_validator(mode="after")
    def _check_channels(self) -> Self:
        channels = [servo.channel for servo in self.servos]
        for channel in channels:
            if channels.count(channel) > 1:
                raise ValueError(f"servos: channel {channel} appears twice, expected one servo per channel")
        return self
