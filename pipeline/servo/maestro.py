"""Pololu's Maestro over its serial port, in the compact protocol.

Source: Pololu Maestro Servo Controller User's Guide, sections 4.b (errors), 5.c to 5.e (protocol and commands),
https://www.pololu.com/docs/0J40. A command byte has its top bit set, data bytes are 7 bits each, low ones first; pulses
are in quarters of a microsecond, so that 1500 µs on channel 0 is 84 00 70 2E.

Where "Timeout" is set in the Maestro Control Center, and "On startup or error: Off" for each channel, it stops the
pulses by itself when the host falls silent: docs/servo.md.
"""

from __future__ import annotations

import contextlib
import errno
import math
from collections.abc import Mapping
from typing import Any

import serial

from pipeline.errors import PuddleError
from pipeline.servo.controller import ControllerFault, PortLost

SET_TARGET, SET_SPEED, SET_ACCELERATION = 0x84, 0x87, 0x89
GET_POSITION, GET_ERRORS, GO_HOME = 0x90, 0xA1, 0xA2
BAUD_INDICATION = 0xAA

UNITS_PER_US = 4
"""Of a target: quarters of a microsecond."""

SPEED_UNIT = 25.0
"""Of a speed: a quarter of a microsecond in 10 ms, in [µs/s]."""

PATIENCE = 0.1
"""Longest wait for an answer, or for bytes to be taken [s]; a Maestro on USB answers within 2 ms."""

ERRORS = (
    "serial signal error (a framing error or a wrong baud rate)",
    "serial overrun (bytes came faster than it could read them)",
    "serial buffer full",
    "serial CRC error (CRC is enabled in its settings; puddle sends none)",
    "serial protocol error (it was sent bytes that are no command)",
    "serial time-out (it heard nothing for longer than its settings allow)",
    "script stack error",
    "script call stack error",
    "script program counter error",
)
"""By bit."""

VENDOR_ID = 0x1FFB
PRODUCT_IDS = (0x0089, 0x008A, 0x008B, 0x008C)
"""Of Maestros with 6, 12, 18 and 24 channels on USB."""


def two_bytes(value: int) -> bytes:
    """Split a 14-bit number into its low and its high seven bits."""
    if not 0 <= value < 1 << 14:
        raise ValueError(f"{value} does not fit into two data bytes, expected 0 to 16383")
    return bytes((value & 0x7F, value >> 7))


def set_target(channel: int, pulse_us: float) -> bytes:
    """Tell a channel its pulse [µs]; 0 stops it."""
    return bytes((SET_TARGET, channel)) + two_bytes(round(pulse_us * UNITS_PER_US))


def set_speed(channel: int, rate_us: float) -> bytes:
    """Limit a channel's rate [µs/s]: the next unit above, so that the controller never lags behind the host's limit."""
    return bytes((SET_SPEED, channel)) + two_bytes(min(math.ceil(rate_us / SPEED_UNIT), (1 << 14) - 1))


def no_acceleration_limit(channel: int) -> bytes:
    """Lift a channel's limit of acceleration: the timeline's ramps are gentle, and a controller that lags is wrong."""
    return bytes((SET_ACCELERATION, channel)) + two_bytes(0)


class Maestro:
    """A Maestro on an open port; see :class:`pipeline.servo.controller.ServoDriver`."""

    def __init__(self, port: Any, *, baud_detection: bool = False) -> None:
        """Take an open port.

        Args:
            port: pyserial's, or one that behaves like it.
            baud_detection: whether the controller waits for 0xAA to learn the baud rate from.
        """
        self._port = port
        self._baud_detection = baud_detection
        self.name = str(port.name)

    def prepare(self, rates_us: Mapping[int, float]) -> None:
        """Meet the controller, forget its old errors, and have it limit rates as well."""
        if self._baud_detection:
            self._write(bytes((BAUD_INDICATION,)))
        with contextlib.suppress(serial.SerialException, OSError):
            self._port.reset_input_buffer()  # what it said to others before
        self._errors()  # reading clears them; a time-out since the last run is as it should be
        for channel, rate in rates_us.items():
            self._write(set_speed(channel, rate) + no_acceleration_limit(channel))
        self.check()

    def send(self, pulses_us: Mapping[int, float]) -> None:
        """Set targets, all in one write."""
        self._write(b"".join(set_target(channel, pulse) for channel, pulse in pulses_us.items()))

    def position(self, channel: int) -> float:
        """Read the pulse that a channel gets at the moment [µs]: the controller's word, not the horn's."""
        answer = self._ask(bytes((GET_POSITION, channel)))
        return int.from_bytes(answer, "little") / UNITS_PER_US

    def check(self) -> None:
        """Refuse to go on where the controller has noted errors."""
        found = self._errors()
        if found:
            names = [name for bit, name in enumerate(ERRORS) if found >> bit & 1] or [f"unknown bits {found:#06x}"]
            raise ControllerFault(f"{self.name}: the controller reports: {'; '.join(names)}")

    def home(self) -> None:
        """Do with every channel what its settings say for errors."""
        self._write(bytes((GO_HOME,)))

    def off(self, channels: tuple[int, ...]) -> None:
        """Stop the pulses of some channels."""
        self._write(b"".join(set_target(channel, 0) for channel in channels))

    def close(self) -> None:
        """Let go of the port."""
        with contextlib.suppress(serial.SerialException, OSError):
            self._port.close()

    def _errors(self) -> int:
        found = int.from_bytes(self._ask(bytes((GET_ERRORS,))), "little")
        if found >> len(ERRORS):
            raise ControllerFault(
                f"{self.name}: expected the controller's errors, came {found:#06x}, which has bits "
                f"that mean nothing. Is it a Maestro, and its Command Port?"
            )
        return found

    def _write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as error:
            raise PortLost(f"{self.name}: the port is lost while sending: {_reason(error)}") from error

    def _ask(self, command: bytes) -> bytes:
        """Send a command that is answered by two bytes."""
        try:
            stray = self._port.in_waiting
            if stray:
                said = self._port.read(stray)
                raise ControllerFault(f"{self.name}: expected silence before a question, came {said[:16].hex(' ')}")
            self._port.write(command)
            answer = bytes(self._port.read(2))
        except (serial.SerialException, OSError) as error:
            raise PortLost(f"{self.name}: the port is lost while asking: {_reason(error)}") from error
        if len(answer) < 2:
            raise ControllerFault(
                f"{self.name}: expected an answer to {command.hex(' ')} within {PATIENCE * 1000:.0f} ms, came "
                f"{answer.hex(' ') or 'nothing'}. Is it a Maestro, and its Command Port?"
            )
        return answer


def _reason(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def open_maestro(path: str, *, baud: int, baud_detection: bool) -> Maestro:
    """Open a Maestro's port, for us alone.

    Raises:
        PuddleError: the port is missing, busy, forbidden or no serial port; says what to do.
    """
    try:
        port = serial.Serial(path, baudrate=baud, timeout=PATIENCE, write_timeout=PATIENCE, exclusive=True)
    except (serial.SerialException, OSError, ValueError) as error:
        raise PuddleError(f"{path}: {_advice(error)}") from error
    return Maestro(port, baud_detection=baud_detection)


def _advice(error: Exception) -> str:
    text, number = _reason(error), getattr(error, "errno", None)
    if number == errno.ENOENT or "No such file" in text:
        return "there is no such port. Is the controller plugged in? `puddle drive --list-ports` shows what there is."
    if number == errno.EACCES or "Permission denied" in text:
        return "you may not use this port. On Linux, join its group (often dialout) and log in again."
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in text or "busy" in text.lower():
        return "the port is busy: another program has it (Maestro Control Center, another puddle). Close that first."
    return f"it can't be opened as a serial port: {text}"
