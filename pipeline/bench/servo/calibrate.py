"""``puddle servo calibrate``: move the servos one after the other by hand, and write down what was measured.

A servo is held at its pulse at the controller's frame rate while the user reads and types, because a controller with a
time-out switches silent channels off. Limits, rates and the shutdown are those of a run.
"""

import contextlib
from collections.abc import Generator, Mapping, Sequence
from math import degrees, isfinite, radians
from pathlib import Path

import numpy as np

from pipeline.bench.fabrication.kit_files import calibration_yaml
from pipeline.bench.servo.log import default_path
from pipeline.bench.servo.play import SAFETY, Connection, User, calibration_at, run
from pipeline.bench.servo.player import Clock, Frames
from pipeline.errors import PuddleError
from pipeline.store import disk
from tasks.arrays import Float64
from tasks.bench.fabrication.calibration import Calibration, ServoCalibration

_LOWEST_US, _HIGHEST_US = 500.0, 2500.0  # pulses that hobby servos accept
_LARGEST_STEP_US = 100.0  # so that a slip of the finger moves a servo by 10° only
_SPEED = 0.5  # of a servo that is being calibrated [rad/s]
_SMALLEST_TURN_US, _SMALLEST_TURN = 50.0, radians(5)  # below, the error of reading an angle is too large
_PLAUSIBLE_US_PER_RAD = (100.0, 3000.0)  # a common servo has 600


def calibrate(
    kit: Path,
    connection: Connection,
    user: User,
    *,
    joints: Sequence[int] = (),
    log: Path | None = None,
    clock: Clock | None = None,
) -> bool:
    """Measure servos with the user's help, and write their calibration beside the previous one.

    All joints are calibrated if none are given. Returns whether a calibration was written; False if the user declined
    or stopped. Raises PuddleError if a file is invalid, or the port or the controller fails; nothing was written then.
    """
    path, before = calibration_at(kit)
    if unknown := set(joints) - {servo.joint for servo in before.servos}:
        known = ", ".join(str(servo.joint) for servo in before.servos)
        raise PuddleError(f"--joint: {path} has servos for joints {known}, got {min(unknown)}")
    log_path = log or default_path(path.parent)
    measured: dict[int, ServoCalibration] = {}
    with contextlib.closing(connection.open()) as controller:
        user.say(f"{SAFETY} The log of this run: {log_path}")
        if not connection.dry_run and not user.confirm("Move the servos?"):
            user.say("Nothing was moved.")
            return False
        chosen = [servo for servo in before.servos if not joints or servo.joint in joints]
        for number, servo in enumerate(chosen, 1):
            free = {"min_us": _LOWEST_US, "max_us": _HIGHEST_US, "max_speed": min(_SPEED, servo.max_speed)}
            of_servo = log_path if number == 1 else log_path.with_stem(f"{log_path.stem}-{number}")
            neutral = {servo.channel: servo.centre_us}
            frames, moved = _measurement(servo, user, measured, neutral), [servo.model_copy(update=free)]
            asked = number == 1 or connection.dry_run
            if not (asked or user.confirm(f"Move the servo of joint {servo.joint} on channel {servo.channel}?")):
                user.say(f"{path} is unchanged.")
                return False
            if not run(controller, moved, frames, of_servo, user, clock or Clock(), show=_nothing, neutral=neutral):
                user.say(f"{path} is unchanged.")
                return False
    after = Calibration(servos=tuple(measured.get(servo.channel, servo) for servo in before.servos))
    for servo in measured.values():
        user.say(
            f"joint {servo.joint} on channel {servo.channel}: rest at {servo.centre_us:g} µs, "
            f"{servo.us_per_rad:.0f} µs/rad, direction {servo.direction:+d}, {servo.min_us:g} to {servo.max_us:g} µs"
        )
    previous = disk.unused(path)
    if not user.confirm(f"Write {path}? The previous calibration stays as {previous.name}."):
        user.say(f"{path} is unchanged.")
        return False
    disk.place(previous, path.read_bytes())
    disk.place(path, calibration_yaml(after, f"Measured with `puddle servo calibrate`. Before: {previous.name}."))
    user.say(f"Wrote {path}.")
    return True


def _nothing(time: float, sent: Mapping[int, float], lateness: float) -> None:
    """Show nothing while the user types."""


def _measurement(
    servo: ServoCalibration, user: User, measured: dict[int, ServoCalibration], neutral: dict[int, float]
) -> Frames:
    """Ask for the four measurements of a servo while it is held, and add its calibration to ``measured``.

    Once its rest is known it is ``neutral``, to which it returns: the earlier one may be beyond what it touches.
    """
    user.say(
        f"\nJoint {servo.joint} on channel {servo.channel}. Type a step such as +20 or -5 [µs] to move it, at most "
        f"{_LARGEST_STEP_US:g} at a time, and an empty line when it is there."
    )
    rest = yield from _moved(servo.centre_us, "1 of 4: move it until the joint is at rest, as in the drawing.", user)
    neutral[servo.channel] = rest
    us_per_rad, direction, pulse = yield from _scale(rest, user)
    question = "3 of 4: move it to the shortest pulse before anything touches."
    shortest = yield from _moved(pulse, question, user, below=rest)
    question = "4 of 4: move it to the longest pulse before anything touches."
    longest = yield from _moved(shortest, question, user, above=rest)
    fields = {"centre_us": rest, "us_per_rad": round(us_per_rad, 3), "direction": direction}
    limits = {"min_us": shortest, "max_us": longest}
    measured[servo.channel] = ServoCalibration(**{**servo.model_dump(), **fields, **limits})
    return f"joint {servo.joint} is measured"


def _scale(rest: float, user: User) -> Generator[Float64, None, tuple[float, int, float]]:
    """Measure a known turn. Return the pulse per radian [µs/rad], the direction, and the pulse now [µs]."""
    pulse = rest
    while True:
        question = "2 of 4: move it by 20° or more, so that you can measure the angle."
        pulse = yield from _moved(pulse, question, user)
        user.say(
            "By how many degrees is the child link now turned from rest? Counter-clockwise is positive, seen with "
            "forward to the right."
        )
        angle = radians((yield from _number(pulse, user)))
        turn = abs(pulse - rest)
        if turn < _SMALLEST_TURN_US or abs(angle) < _SMALLEST_TURN:
            least = f"{_SMALLEST_TURN_US:g} µs and {degrees(_SMALLEST_TURN):g}°"
            user.say(f"Expected a turn of at least {least}, got {turn:g} µs and {degrees(abs(angle)):g}°.")
            continue
        us_per_rad, (low, high) = turn / abs(angle), _PLAUSIBLE_US_PER_RAD
        if low <= us_per_rad <= high:
            return us_per_rad, 1 if (pulse - rest) * angle > 0 else -1, pulse
        user.say(f"Expected {low:g} to {high:g} µs/rad, got {us_per_rad:.0f}. Is the angle in degrees?")


def _moved(
    pulse: float, question: str, user: User, *, below: float = np.inf, above: float = -np.inf
) -> Generator[Float64, None, float]:
    """Move a servo from a pulse [µs] by the user's steps until an empty line between two pulses. Return the last."""
    user.say(f"{question} Now {pulse:g} µs.")
    while True:
        step = yield from _number(pulse, user, empty=0.0)
        if step == 0.0:
            if above < pulse < below:
                return pulse
            side, rest = ("less", below) if pulse >= below else ("more", above)
            user.say(f"Expected {side} than the pulse at rest, {rest:g} µs, got {pulse:g}.")
        elif abs(step) > _LARGEST_STEP_US:
            user.say(f"Expected a step of at most {_LARGEST_STEP_US:g} µs, got {step:g}.")
        elif not _LOWEST_US <= pulse + step <= _HIGHEST_US:
            user.say(f"Expected a pulse of {_LOWEST_US:g} to {_HIGHEST_US:g} µs, got {pulse + step:g}.")
        else:
            pulse += step
            user.say(f"{pulse:g} µs")


def _number(pulse: float, user: User, *, empty: float | None = None) -> Generator[Float64, None, float]:
    """Hold a servo until the user types a number. An empty line counts as ``empty``, if that is a number."""
    while True:
        try:
            line = user.read()
        except EOFError:
            raise PuddleError("the input ended before the calibration did. No calibration was written") from None
        if line is None:
            yield np.array([pulse])
            continue
        with contextlib.suppress(ValueError):
            value = float(line) if line.strip() or empty is None else empty
            if isfinite(value):
                return value
        user.say(f"Expected a number, got {line.strip()!r}.")
