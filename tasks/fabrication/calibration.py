"""Calibration: which servo moves which joint, and what pulse puts it at which angle.

A hobby servo holds the angle that the width of its pulses tells, linear within its travel:
pulse = centre + direction · us_per_rad · angle, where the angle is the joint's from its rest, in the simulation's
sense. Horns sit on splines and servos differ, so a kit's file is a first guess: measure each once (docs/servo.md).
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from tasks.design.genes import N_LINKS
from tasks.parameters import Parameters

SHORTEST_US, LONGEST_US = 400.0, 2600.0
"""Pulses that hobby servos take for a position [µs]; what is far outside is a slip of the pen."""


class ServoCalibration(Parameters):
    """One servo."""

    joint: int = Field(ge=1, lt=N_LINKS)
    """The joint that it moves, by the number of its child link."""
    channel: int = Field(ge=0, le=23)
    """Of the controller."""
    centre_us: float = Field(ge=SHORTEST_US, le=LONGEST_US)
    """Pulse at which the joint rests [µs]; the neutral position."""
    direction: Literal[1, -1]
    """1 if longer pulses turn the child link counter-clockwise, as positive angles do, seen with x to the right."""
    us_per_rad: float = Field(gt=0.0, le=10_000.0)
    """Change of the pulse for a turn of one radian [µs/rad]."""
    min_us: float = Field(ge=SHORTEST_US, le=LONGEST_US)
    """Shortest pulse that it may be sent [µs]."""
    max_us: float = Field(ge=SHORTEST_US, le=LONGEST_US)
    """Longest pulse that it may be sent [µs]."""
    max_speed: float = Field(gt=0.0, le=100.0)
    """Fastest that the joint may be told to turn [rad/s]."""

    @field_validator("direction", mode="before")
    @classmethod
    def _a_number(cls, value: object) -> object:
        if isinstance(value, bool):  # which equals 1 or 0
            raise ValueError(f"expected 1 or -1, got {str(value).lower()}")
        return value

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.min_us >= self.max_us:
            raise ValueError(
                f"min_us is {self.min_us:g} and max_us is {self.max_us:g}: expected min_us below max_us. "
                f"Are they swapped?"
            )
        if not self.min_us <= self.centre_us <= self.max_us:
            raise ValueError(
                f"centre_us is {self.centre_us:g}, expected min_us to max_us, {self.min_us:g} to {self.max_us:g}"
            )
        return self

    @property
    def max_rate_us(self) -> float:
        """Fastest change of the pulse [µs/s]."""
        return self.max_speed * self.us_per_rad

    def angle(self, pulse_us: float) -> float:
        """Give the joint's angle from rest at a pulse [rad]."""
        return self.direction * (pulse_us - self.centre_us) / self.us_per_rad


class Calibration(Parameters):
    """All servos of a robot."""

    servos: tuple[ServoCalibration, ...] = Field(min_length=1)
    """In any order. Two servos may share a joint, one in each pontoon."""

    @model_validator(mode="after")
    def _channels_once(self) -> Self:
        channels = [servo.channel for servo in self.servos]
        for channel in channels:
            if channels.count(channel) > 1:
                raise ValueError(f"servos: channel {channel} appears twice, expected one servo on each")
        return self
