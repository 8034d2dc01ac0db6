"""The interface of a servo controller, independent of its wire protocol."""

from collections.abc import Mapping
from typing import Protocol

from pipeline.errors import PuddleError


class PortLostError(PuddleError):
    """The port is gone or accepts no more bytes, so the controller can't be reached."""


class ControllerError(PuddleError):
    """The controller reports an error, sends an invalid answer or does not answer. It may still receive commands."""


class ServoController(Protocol):
    """A controller of servos. Pulses are in µs, by channel, and have already been limited.

    Every method but ``close`` raises PortLostError if the port fails and ControllerError if the controller does.
    """

    @property
    def name(self) -> str:
        """The port, as messages call it."""

    def prepare(self, rates_us: Mapping[int, float]) -> None:
        """Contact the controller and let it limit each channel's rate [µs/s] too, if it can. Moves nothing."""

    def send(self, pulses_us: Mapping[int, float]) -> None:
        """Set the pulse of each channel. Channels that were off start to pulse."""

    def position(self, channel: int) -> float | None:
        """Read the pulse that a channel puts out now [µs]: 0 if it is off, None if the controller can't tell."""

    def check(self) -> None:
        """Raise ControllerError if the controller reports errors."""

    def off(self, channels: tuple[int, ...]) -> None:
        """Stop the pulses, which leaves the servos limp."""

    def close(self) -> None:
        """Release the port. Never raises."""


def confirm_off(controller: ServoController, positions_us: Mapping[int, float | None]) -> None:
    """Raise ControllerError if a channel that was switched off still puts out a pulse [µs]."""
    for channel, position in positions_us.items():
        if position:
            raise ControllerError(
                f"{controller.name}: channel {channel} is switched off but puts out {position:g} µs. Cut the servos' "
                f"power if they hold or move"
            )


class DryRunController:
    """A controller without hardware: it accepts every command, moves nothing and knows no position."""

    name = "dry run"

    def _accept(self, *_: object, **__: object) -> None:
        """Do nothing."""

    prepare = send = position = check = off = close = _accept
