"""puddle servo: play a timeline on a robot's servos, calibrate them, switch them off."""

import os
import select
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.options import with_options
from pipeline.commands.terminal import INTERRUPTED, to_stdout

if TYPE_CHECKING:
    from pipeline.bench.servo.play import Connection

servo = typer.Typer(help="Play a timeline on servos, calibrate them, switch them off.", no_args_is_help=True)

_STANDARD_INPUT = 0  # its file descriptor


def _list_ports(wanted: bool) -> None:
    """List the serial ports and exit, if the user asked for that."""
    from pipeline.bench.servo.maestro import port_lines

    if wanted:
        to_stdout(*port_lines())
        raise typer.Exit


@dataclass(frozen=True)
class PortOptions:
    """Options that choose a servo controller."""

    port: Annotated[str | None, typer.Option("--port", help="Port of the servo controller: /dev/ttyACM0.")] = None
    list_ports: Annotated[
        bool,
        typer.Option("--list-ports", callback=_list_ports, is_eager=True, help="List this machine's serial ports."),
    ] = False
    timeout: Annotated[
        float, typer.Option("--timeout", min=0.01, help="Longest wait for the controller's answer [s].")
    ] = 0.1
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Do everything except talk to a controller.")] = False

    def connection(self) -> "Connection":
        """Return the connection that was chosen."""
        from pipeline.bench.servo.play import Connection

        return Connection(self.port, self.timeout, self.dry_run)


Log = Annotated[Path | None, typer.Option("--log", help="Log of what was sent (CSV); default beside the timeline.")]


@with_options
def play(
    timeline: Annotated[Path, typer.Argument(help="A kit that `puddle fabricate` made, or a timeline.json.")],
    port: PortOptions,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", help="The servos' calibration; default calibration.yaml beside the timeline."),
    ] = None,
    duration: Annotated[float | None, typer.Option("--duration", min=0.0, help="Stop after this time [s].")] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Repeat the timeline until stopped.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Start without asking for confirmation.")] = False,
    log: Log = None,
) -> None:
    """Move a robot's servos through a timeline, and return them to rest whatever happens (docs/servo.md)."""
    from pipeline.bench.servo.play import User, play_timeline

    user = User(lambda question: yes or _confirmed(question), to_stdout)
    if not play_timeline(timeline, port.connection(), user, calibration, duration=duration, loop=loop, log=log):
        raise typer.Exit(INTERRUPTED)


@with_options
def calibrate(
    kit: Annotated[Path, typer.Argument(help="A kit that `puddle fabricate` made, or a calibration.yaml.")],
    port: PortOptions,
    joints: Annotated[list[int] | None, typer.Option("--joint", help="Calibrate this joint alone; repeatable.")] = None,
    log: Log = None,
) -> None:
    """Move the servos one by one, measure them, and write calibration.yaml; the previous one stays beside it."""
    from pipeline.bench.servo.calibrate import calibrate as measure
    from pipeline.bench.servo.play import User

    user = User(_confirmed, to_stdout, TypedLines(_STANDARD_INPUT))
    if not measure(kit, port.connection(), user, joints=joints or (), log=log):
        raise typer.Exit(INTERRUPTED)


@with_options
def off(
    kit: Annotated[Path, typer.Argument(help="A kit, or a calibration.yaml, which lists the channels.")],
    port: PortOptions,
) -> None:
    """Switch the servos off at once, wherever they are, and check that the controller has stopped their pulses."""
    from pipeline.bench.servo.play import calibration_at, switch_off

    _, calibration = calibration_at(kit)
    channels = switch_off(port.connection(), calibration)
    to_stdout(f"Servos on channels {', '.join(map(str, channels))}: switched off.")


for _command in (play, calibrate, off):
    servo.command()(_command)


class TypedLines:
    """The lines that arrive at a file descriptor, without waiting for them."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._data = b""

    def __call__(self) -> str | None:
        """Return the next line, or None if none has arrived. Raises EOFError at the end."""
        if b"\n" not in self._data and select.select([self._descriptor], [], [], 0.0)[0]:
            data = os.read(self._descriptor, 4096)
            if not data:
                raise EOFError
            self._data += data
        if b"\n" not in self._data:
            return None
        line, _, self._data = self._data.partition(b"\n")
        return line.decode(errors="replace")


def _confirmed(question: str) -> bool:
    try:
        return typer.confirm(question)
    except typer.Abort:  # Ctrl-C, or no terminal to answer on
        return False
