"""The one last function: whatever is asked of a servo, this is what it is sent.

Nothing reaches a controller but through :class:`Outlet`, and nothing leaves an Outlet but through :func:`clamp`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pipeline.servo.controller import ServoDriver
from tasks.fabrication.calibration import ServoCalibration

STEPS_PER_US = 4
"""Pulses are sent in quarters of a microsecond, the finest that a Maestro makes."""

LONGEST_STEP = 0.04
"""However long ago the last command was, the next moves as far as in two frames at most [s]."""


def clamp(wanted_us: float, last_us: float | None, elapsed: float, servo: ServoCalibration) -> float:
    """Give the pulse that a servo is sent.

    Args:
        wanted_us: what is asked for [µs], anything at all.
        last_us: what it was sent last; None if it was off, so that nobody knows where it stands.
        elapsed: since then [s].
        servo: its limits.

    Returns:
        A multiple of 1/4 µs within [min_us, max_us], no further from ``last_us`` than max_rate_us allows in ``elapsed``
        (or in LONGEST_STEP). A servo that was off is sent its neutral position and nothing else; a wish that is no
        number is no wish.
    """
    lowest, highest = math.ceil(servo.min_us * STEPS_PER_US), math.floor(servo.max_us * STEPS_PER_US)
    if last_us is None:
        return min(max(round(servo.centre_us * STEPS_PER_US), lowest), highest) / STEPS_PER_US
    last = round(last_us * STEPS_PER_US)
    if math.isnan(wanted_us):
        return last / STEPS_PER_US
    # Rounded down, with room for the rounding of this line itself.
    reach = math.floor(servo.max_rate_us * min(max(elapsed, 0.0), LONGEST_STEP) * STEPS_PER_US + 1e-9)
    lowest, highest = max(lowest, last - reach), min(highest, last + reach)
    wanted = min(max(wanted_us * STEPS_PER_US, lowest), highest)
    return min(max(round(wanted), lowest), highest) / STEPS_PER_US


class Outlet:
    """The only way to the servos: remembers what each was sent last, and when."""

    def __init__(self, driver: ServoDriver, servos: Sequence[ServoCalibration]) -> None:
        self._driver = driver
        self._servos = {servo.channel: servo for servo in servos}
        self._last: dict[int, tuple[float, float]] = {}

    @property
    def sent(self) -> Mapping[int, float]:
        """What each servo was sent last [µs], by channel; nothing where it is off."""
        return {channel: pulse for channel, (pulse, _) in self._last.items()}

    def send(self, wanted_us: Mapping[int, float], now: float) -> None:
        """Send what may be sent of what is wanted; ``sent`` says what that was."""
        allowed = {}
        for channel, wanted in wanted_us.items():
            pulse, when = self._last.get(channel, (None, now))
            allowed[channel] = clamp(wanted, pulse, now - when, self._servos[channel])
        # Before the bytes are: if they get lost half-way, some servos may have them.
        self._last |= {channel: (pulse, now) for channel, pulse in allowed.items()}
        self._driver.send(allowed)

    def off(self) -> None:
        """Stop all pulses."""
        self._driver.off(tuple(self._servos))
        self._last.clear()
