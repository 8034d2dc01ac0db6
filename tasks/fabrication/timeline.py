"""Servo timelines: what angle every joint is told to hold, frame by frame, and the pulses that tell it.

The controller is the simulation's (tasks/simulation/controller.py): angle from rest = range · sin(2π f t + phase), with time
stretched from simulation to bench (tasks/fabrication/scaling.py). A run begins and ends at rest: an envelope rises from
0 to 1 and falls again, with no jump of angle, speed or acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from tasks.arrays import Float64
from tasks.design import Designs
from tasks.fabrication.calibration import Calibration, ServoCalibration
from tasks.parameters import Parameters

FRAME_RATE_HZ = 50.0
"""Analogue servos take a pulse every 20 ms; more often is of no use to them."""


class TimelineError(ValueError):
    """A timeline that its servos can't play: names the joint, the instant, what was expected and what came."""


class Playback(Parameters):
    """How long a run lasts, and how gently it begins."""

    duration: float = Field(default=150.0, ge=0.1, le=3600.0)
    """Of the whole run on the bench, ramps included [s]; at least 5 frames of 20 ms, to rise and fall in. [P]"""
    ramp: float = Field(default=2.0, gt=0.0, le=60.0)
    """Of the rise from rest, and of the fall back to it [s]."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """Joint angles at 50 Hz."""

    joints: tuple[int, ...]
    """The driven joints, each by the number of its child link."""
    angle: Float64
    """(n_frames, n_joints) from rest [rad]."""

    def __post_init__(self) -> None:
        if not self.joints:
            raise TimelineError("timeline: no joint is driven, expected one or more with its motor on")
        if self.angle.ndim != 2 or self.angle.shape[1] != len(self.joints) or not len(self.angle):
            raise TimelineError(
                f"timeline: angles have shape {self.angle.shape}, expected (n_frames, {len(self.joints)})"
            )
        if not np.isfinite(self.angle).all():
            frame, column = np.argwhere(~np.isfinite(self.angle))[0]
            raise TimelineError(
                f"timeline: joint {self.joints[column]} at {frame / FRAME_RATE_HZ:.2f} s: "
                f"expected an angle, came {self.angle[frame, column]}"
            )

    @property
    def time(self) -> Float64:
        """(n_frames,) since the beginning [s]."""
        return np.arange(len(self.angle)) / FRAME_RATE_HZ

    @property
    def speed(self) -> Float64:
        """(n_frames - 1, n_joints) between frames [rad/s]."""
        change: Float64 = np.diff(self.angle, axis=0)
        return change * FRAME_RATE_HZ


def envelope(time: Float64, *, duration: float, ramp: float) -> Float64:
    """Rise from 0 to 1 and fall again, each within ``ramp`` (or half the duration), by 6 s⁵ - 15 s⁴ + 10 s³."""
    ramp = min(ramp, duration / 2)
    s = np.clip(np.minimum(time, duration - time) / ramp, 0.0, 1.0)
    risen: Float64 = s**3 * (10 + s * (6 * s - 15))
    return risen


def timeline_of(design: Designs, playback: Playback, *, time_scale: float) -> Timeline:
    """Write down what a design's controller tells its motors.

    Args:
        design: one design; its driven joints are those whose motor is on.
        playback: how long, and how gently.
        time_scale: seconds on the bench for one of the simulation.

    Raises:
        TimelineError: no motor is on.
    """
    joints = tuple(int(joint) for joint in np.flatnonzero(design.motor_on[0]) if joint > 0)
    n_frames = round(playback.duration * FRAME_RATE_HZ) + 1
    time = np.arange(n_frames) / FRAME_RATE_HZ
    turns = design.frequency[0] * time / time_scale
    swing = design.motion_range[0] * np.sin(2 * np.pi * turns[:, None] + design.phase[0])
    rise = envelope(time, duration=time[-1], ramp=playback.ramp)
    return Timeline(joints=joints, angle=rise[:, None] * swing[:, list(joints)])


def pulses(timeline: Timeline, calibration: Calibration) -> Float64:
    """Turn angles into pulse widths.

    Returns:
        (n_frames, n_servos) [µs], in the order of the calibration's servos.

    Raises:
        TimelineError: a joint has no servo or a servo no joint, or a pulse or its rate is past the servo's limits.
    """
    if strangers := sorted({servo.joint for servo in calibration.servos} ^ set(timeline.joints)):
        served = ", ".join(str(servo.joint) for servo in calibration.servos)
        driven = ", ".join(map(str, timeline.joints))
        raise TimelineError(
            f"joint {strangers[0]}: the timeline drives joints {driven}, the calibration has servos "
            f"for {served}; expected the same"
        )
    return np.stack([_pulses_of(servo, timeline) for servo in calibration.servos], axis=1)


def _pulses_of(servo: ServoCalibration, timeline: Timeline) -> Float64:
    column = timeline.joints.index(servo.joint)
    angle, speed = timeline.angle[:, column], timeline.speed[:, column]
    pulse: Float64 = servo.centre_us + servo.direction * servo.us_per_rad * angle
    name = f"joint {servo.joint} (channel {servo.channel})"
    outside = np.flatnonzero((pulse < servo.min_us) | (pulse > servo.max_us))
    if outside.size:
        frame = outside[0]
        raise TimelineError(
            f"{name} at {frame / FRAME_RATE_HZ:.2f} s: {np.degrees(angle[frame]):+.1f}° needs {pulse[frame]:.0f} "
            f"µs, expected {servo.min_us:g} to {servo.max_us:g}. It swings to {np.degrees(np.abs(angle).max()):.1f}°."
        )
    if speed.size and (fastest := np.abs(speed).max()) > servo.max_speed:
        raise TimelineError(f"{name} is told to turn at {fastest:.2f} rad/s, expected at most {servo.max_speed:g}")
    return pulse
