"""What a servo controller can do, whatever its wire says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from pipeline.errors import PuddleError


class PortLost(PuddleError):  # noqa: N818 (what it is, not that it went wrong)
    """The port is gone, or takes no more bytes: nothing can be said to the controller."""


class ControllerFault(PuddleError):  # noqa: N818
    """The controller reports an error, answers nonsense or does not answer. It may still listen."""


class ServoDriver(Protocol):
    """A controller of servos. Pulses are in µs by channel; those given have been through the limits already.

    Every method raises PortLost where the port fails, ControllerFault where the controller does.
    """

    @property
    def name(self) -> str:
        """What to call it in a message: its port."""
        ...

    def prepare(self, rates_us: Mapping[int, float]) -> None:
        """Meet the controller, and have it limit each channel's rate [µs/s] too, where it can. Moves nothing."""
        ...

    def send(self, pulses_us: Mapping[int, float]) -> None:
        """Tell channels their pulse; those that were off begin."""
        ...

    def position(self, channel: int) -> float | None:
        """Read the pulse that a channel gets at the moment [µs]; 0 where it is off, None where it can't be known."""
        ...

    def check(self) -> None:
        """Ask the controller for errors."""
        ...

    def home(self) -> None:
        """Put every channel into the state that the user set for errors, where the controller has one."""
        ...

    def off(self, channels: tuple[int, ...]) -> None:
        """Stop the pulses: the servos go limp."""
        ...

    def close(self) -> None:
        """Let go of the port; never raises."""
        ...


class DryRun:
    """A controller that is not there: every command is taken and nothing moves."""

    name = "dry run"

    def prepare(self, rates_us: Mapping[int, float]) -> None:
        """Nothing to meet."""

    def send(self, pulses_us: Mapping[int, float]) -> None:
        """Nobody is told."""

    def position(self, channel: int) -> float | None:  # noqa: ARG002
        """Nothing is known."""
        return None

    def check(self) -> None:
        """Nothing can go wrong."""

    def home(self) -> None:
        """Nothing moves."""

    def off(self, channels: tuple[int, ...]) -> None:
        """Nothing was on."""

    def close(self) -> None:
        """Nothing was open."""
