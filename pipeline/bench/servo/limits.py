"""Limits on what a servo is sent.

Every command to a controller goes through :class:`LimitedOutput`, which passes it through :func:`clamp`.
"""

import math
from collections.abc import Mapping, Sequence

from pipeline.bench.servo.servo_controller import ServoController
from tasks.bench.fabrication.calibration import ServoCalibration

_STEPS_PER_US = 4  # a Maestro resolves a quarter of a microsecond
LONGEST_STEP = 0.04  # longest time since the last command that a servo may move for [s]: two frames


def clamp(wanted_us: float, last_us: float | None, elapsed: float, servo: ServoCalibration) -> float:
    """Limit a pulse to a servo's range and rate.

    Args:
        wanted_us: Requested pulse [µs]; any float, NaN and infinities included.
        last_us: Last pulse sent [µs]; None if the servo was off, because its position is then unknown.
        elapsed: Time since the last pulse [s].
        servo: Calibration with the limits.

    Returns:
        A multiple of 1/4 µs in [min_us, max_us] that differs from ``last_us`` by at most what max_rate_us allows in
        ``elapsed`` (LONGEST_STEP at most). A servo that was off gets its neutral pulse; NaN repeats the last pulse.
    """
    lowest, highest = math.ceil(servo.min_us * _STEPS_PER_US), math.floor(servo.max_us * _STEPS_PER_US)
    if last_us is None:
        return min(max(round(servo.centre_us * _STEPS_PER_US), lowest), highest) / _STEPS_PER_US
    last = round(last_us * _STEPS_PER_US)
    if math.isnan(wanted_us):
        return last / _STEPS_PER_US
    # Rounded down; 1e-9 absorbs the rounding error of the product.
    reach = math.floor(servo.max_rate_us * min(max(elapsed, 0.0), LONGEST_STEP) * _STEPS_PER_US + 1e-9)
    lowest, highest = max(lowest, last - reach), min(highest, last + reach)
    wanted = min(max(wanted_us * _STEPS_PER_US, lowest), highest)
    return min(max(round(wanted), lowest), highest) / _STEPS_PER_US


class LimitedOutput:
    """The only access to the servos. Remembers the last pulse of each and when it was sent."""

    def __init__(self, controller: ServoController, servos: Sequence[ServoCalibration]) -> None:
        self._controller = controller
        self._servos = {servo.channel: servo for servo in servos}
        self._last: dict[int, tuple[float, float]] = {}

    @property
    def sent(self) -> Mapping[int, float]:
        """Last pulse [µs] of each channel that is on."""
        return {channel: pulse for channel, (pulse, _) in self._last.items()}

    def send(self, wanted_us: Mapping[int, float], now: float) -> None:
        """Limit pulses [µs] and send them; ``sent`` holds the result."""
        allowed = {}
        for channel, wanted in wanted_us.items():
            pulse, when = self._last.get(channel, (None, now))
            allowed[channel] = clamp(wanted, pulse, now - when, self._servos[channel])
        # Recorded first: if the write fails half-way, some servos may have received their pulse.
        self._last |= {channel: (pulse, now) for channel, pulse in allowed.items()}
        self._controller.send(allowed)

    def off(self) -> None:
        """Stop all pulses."""
        self._controller.off(tuple(self._servos))
        self._last.clear()
