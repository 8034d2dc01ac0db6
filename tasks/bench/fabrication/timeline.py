"""Servo timelines: the angle of every joint, frame by frame, and the pulses that command it.

The angles are those of the simulated gait (tasks/design/gait.py) from rest, with time scaled from simulation to bench
(tasks/bench/fabrication/scaling.py). An envelope raises the amplitude from 0 to 1 and lowers it again: a run begins and
ends at rest, without a jump in angle, speed or acceleration.
"""

from dataclasses import dataclass

import numpy as np

from tasks.arrays import Float64
from tasks.bench.fabrication.calibration import Calibration, ServoCalibration
from tasks.design import Designs
from tasks.design.gait import swing
from tasks.design.gene import DesignError

DURATION = 150.0  # of a run on the bench, ramps included [s]; paper, "Physical Validation"
RAMP = 2.0  # of the rise from rest, and of the return to it [s]
FRAME_RATE_HZ = 50.0  # frames per second; an analogue servo reads one pulse every 20 ms


class TimelineError(ValueError):
    """A timeline is invalid, or its servos can't play it. The message names the joint, the time and the limit."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """Joint angles at 50 Hz."""

    joints: tuple[int, ...]  # driven joints, by the numbers of their child links
    angle: Float64  # (n_frames, n_joints) angles from rest [rad]

    def __post_init__(self) -> None:
        if not self.joints:
            raise TimelineError("timeline: no motor is on, expected at least one")
        if self.angle.shape[1:] != (len(self.joints),) or not len(self.angle):
            expected = f"expected (n_frames, {len(self.joints)})"
            raise TimelineError(f"timeline: angles have shape {self.angle.shape}, {expected}")

    @property
    def time(self) -> Float64:
        """(n_frames,) times [s]."""
        return np.arange(len(self.angle)) / FRAME_RATE_HZ

    @property
    def speed(self) -> Float64:
        """(n_frames - 1, n_joints) speeds between frames [rad/s]."""
        change: Float64 = np.diff(self.angle, axis=0)
        return change * FRAME_RATE_HZ


def envelope(time: Float64, *, duration: float, ramp: float) -> Float64:
    """Return the amplitude's envelope at (n,) times [s]: it rises from 0 to 1 and falls again by 6 s⁵ - 15 s⁴ + 10 s³.

    The rise and the fall take ``ramp`` [s] each, or half of the duration [s] where that is shorter.
    """
    ramp = min(ramp, duration / 2)
    s = np.clip(np.minimum(time, duration - time) / ramp, 0.0, 1.0)
    risen: Float64 = s**3 * (10 + s * (6 * s - 15))
    return risen


def driven_joints(design: Designs) -> tuple[int, ...]:
    """List the driven joints of one design."""
    return tuple(int(joint) for joint in np.flatnonzero(design.motor_on[0]) if joint > 0)


def timeline_of(design: Designs, *, time_scale: float, duration: float = DURATION, ramp: float = RAMP) -> Timeline:
    """Sample the motor commands of one design's controller, with ``time_scale`` bench seconds per simulated second.

    Raises TimelineError if no motor is on, or the controller needs what servos lack: they sense nothing.
    """
    joints = driven_joints(design)
    n_frames = round(duration * FRAME_RATE_HZ) + 1
    time = np.arange(n_frames) / FRAME_RATE_HZ
    periods = design.frequency[0] * time[:, None] / time_scale
    rise = envelope(time, duration=time[-1], ramp=ramp)
    try:
        angle = swing(design, periods[:, None])[:, 0, list(joints)]
    except DesignError as error:
        raise TimelineError(str(error)) from None
    return Timeline(joints=joints, angle=rise[:, None] * angle)


def pulses(timeline: Timeline, calibration: Calibration) -> Float64:
    """Convert angles to (n_frames, n_servos) pulses [µs], in the order of the calibration's servos.

    Raises TimelineError if joints and servos do not match, or a pulse or speed exceeds the limits of its servo.
    """
    if {servo.joint for servo in calibration.servos} != set(timeline.joints):
        driven = ", ".join(map(str, timeline.joints))
        calibrated = ", ".join(str(servo.joint) for servo in calibration.servos)
        raise TimelineError(f"expected servos for joints {driven}, the calibration has them for {calibrated}")
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
            f"µs, expected {servo.min_us:g} to {servo.max_us:g} µs; it swings ±{np.degrees(np.abs(angle).max()):.1f}°"
        )
    if speed.size and (fastest := np.abs(speed).max()) > servo.max_speed:
        raise TimelineError(f"{name} turns at {fastest:.2f} rad/s, expected at most {servo.max_speed:g}")
    return pulse
