"""Pololu's Maestro over its USB Command Port, in the compact protocol.

Source: Pololu Maestro Servo Controller User's Guide, sections 4.b (errors), 5.c to 5.e (protocol and commands),
https://www.pololu.com/docs/0J40. A command byte has its top bit set; data bytes hold 7 bits each, low bits first.
Pulses are in quarters of a microsecond, so that 1500 µs on channel 0 is 84 00 70 2E.

With "Timeout" and "On startup or error: Off" set in the Maestro Control Center, the Maestro stops the pulses by itself
when the host falls silent (docs/servo.md).
"""

import contextlib
import errno
import math
import termios
from collections.abc import Iterator, Mapping

import serial
from serial.tools.list_ports import comports

from pipeline.bench.servo.servo_controller import ControllerError, PortLostError
from pipeline.errors import PuddleError

_SET_TARGET, _SET_SPEED, _SET_ACCELERATION = 0x84, 0x87, 0x89
_GET_POSITION, _GET_ERRORS = 0x90, 0xA1
_UNITS_PER_US = 4  # a target is in quarters of a microsecond
_SPEED_UNIT_US = 25.0  # a speed is in quarters of a microsecond per 10 ms, that is 25 µs/s
_ERRORS_BY_BIT = (
    "serial signal error (a framing error)",
    "serial overrun (bytes arrived faster than it could read them)",
    "serial buffer full",
    "serial CRC error (CRC is enabled in its settings; puddle sends none)",
    "serial protocol error (it received bytes that are not a command)",
    "serial time-out (it received nothing for longer than its settings allow)",
    "script stack error",
    "script call stack error",
    "script program counter error",
)
_VENDOR_ID, _PRODUCT_IDS = 0x1FFB, (0x0089, 0x008A, 0x008B, 0x008C)  # Maestros with 6, 12, 18 and 24 channels


def command(code: int, channel: int, value: int) -> bytes:
    """Encode a command to a channel with a 14-bit number, low seven bits first."""
    return bytes((code, channel, value & 0x7F, value >> 7))


def set_target(channel: int, pulse_us: float) -> bytes:
    """Encode the command that sets a channel's pulse [µs]; 0 stops it."""
    return command(_SET_TARGET, channel, round(pulse_us * _UNITS_PER_US))


def set_limits(channel: int, rate_us: float) -> bytes:
    """Encode a limit on a channel's rate [µs/s], rounded up, and none on its acceleration.

    So the controller never lags behind the host.
    """
    speed = min(math.ceil(rate_us / _SPEED_UNIT_US), (1 << 14) - 1)
    return command(_SET_SPEED, channel, speed) + command(_SET_ACCELERATION, channel, 0)


class Maestro:
    """A Maestro on an open port; implements :class:`pipeline.bench.servo.servo_controller.ServoController`."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port
        self.name = str(port.name)

    def prepare(self, rates_us: Mapping[int, float]) -> None:
        """Contact the controller, clear old errors and limit the rate [µs/s] of each channel."""
        with self._port_kept("sending"):
            self._port.reset_input_buffer()  # answers to an earlier program
        self._read_errors()  # reading clears them; a time-out since the last run is expected
        for channel, rate in rates_us.items():
            self._write(set_limits(channel, rate))
        self.check()

    def send(self, pulses_us: Mapping[int, float]) -> None:
        """Set the pulses [µs] of channels in one write."""
        self._write(b"".join(set_target(channel, pulse) for channel, pulse in pulses_us.items()))

    def position(self, channel: int) -> float:
        """Read the pulse that a channel puts out now [µs], which is not where the horn is."""
        return int.from_bytes(self._ask(bytes((_GET_POSITION, channel))), "little") / _UNITS_PER_US

    def check(self) -> None:
        """Raise ControllerError if the controller reports errors."""
        if bits := self._read_errors():
            names = [name for bit, name in enumerate(_ERRORS_BY_BIT) if bits >> bit & 1]
            raise ControllerError(f"{self.name}: the controller reports: {'; '.join(names)}")

    def off(self, channels: tuple[int, ...]) -> None:
        """Stop the pulses of channels."""
        self._write(b"".join(set_target(channel, 0) for channel in channels))

    def close(self) -> None:
        """Release the port."""
        with contextlib.suppress(serial.SerialException, OSError):
            self._port.close()

    def _read_errors(self) -> int:
        bits = int.from_bytes(self._ask(bytes((_GET_ERRORS,))), "little")
        if bits >> len(_ERRORS_BY_BIT):
            expected = f"expected error bits 0 to {len(_ERRORS_BY_BIT) - 1}, got {bits:#06x}"
            raise ControllerError(f"{self.name}: {expected}. Is this a Maestro's Command Port?")
        return bits

    def _write(self, data: bytes) -> None:
        with self._port_kept("sending"):
            self._port.write(data)

    def _ask(self, command: bytes) -> bytes:
        """Send a command and read its answer of two bytes."""
        with self._port_kept("asking"):
            early = self._port.read(self._port.in_waiting)
            self._port.write(command)
            answer = bytes(self._port.read(2))
        if early:
            got = early[:16].hex(" ")
            raise ControllerError(f"{self.name}: expected no bytes before the next command, got {got}")
        if len(answer) < 2:
            raise ControllerError(
                f"{self.name}: expected an answer to {command.hex(' ')} within {self._port.timeout:g} s, got "
                f"{answer.hex(' ') or 'nothing'}. Is this a Maestro's Command Port?"
            )
        return answer

    @contextlib.contextmanager
    def _port_kept(self, doing: str) -> Iterator[None]:
        try:
            yield
        except (serial.SerialException, OSError, termios.error) as error:
            raise PortLostError(f"{self.name}: lost the port while {doing}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def open_maestro(path: str, *, timeout: float) -> Maestro:
    """Open a Maestro's port, such as /dev/ttyACM0, for exclusive use.

    ``timeout`` is the longest wait for an answer, or for bytes to be accepted [s]; a Maestro takes 2 ms. Raises
    PuddleError if the port is missing, busy, forbidden or not a serial port.
    """
    try:
        return Maestro(serial.Serial(path, timeout=timeout, write_timeout=timeout, exclusive=True))
    except (serial.SerialException, OSError, ValueError) as error:
        raise PuddleError(f"{path}: {_advice(error)}") from error


def _advice(error: Exception) -> str:
    text, number = _reason(error), getattr(error, "errno", None)
    if number == errno.ENOENT or "No such file" in text:
        return "no such port. Is the controller plugged in? List the ports with `puddle servo play --list-ports`."
    if number == errno.EACCES or "Permission denied" in text:
        return "permission denied. On Linux, join the port's group (often dialout) and log in again."
    if number in (errno.EBUSY, errno.EAGAIN) or "lock" in text or "busy" in text.lower():
        return "the port is busy. Close the program that uses it (Maestro Control Center, another puddle)."
    return f"can't be opened as a serial port: {text}"


def port_lines() -> list[str]:
    """List this computer's serial ports and mark those of a Maestro."""
    lines = []
    for port in sorted(comports(), key=lambda port: port.device):
        is_maestro = port.vid == _VENDOR_ID and port.pid in _PRODUCT_IDS
        lines.append(f"{port.device}  {port.description}{'  <- a Maestro' if is_maestro else ''}")
    advice = "A Maestro has two ports. Pass its Command Port, usually the first, to --port."
    return [*lines, advice] if lines else ["No serial port found. Is the controller plugged in?"]
