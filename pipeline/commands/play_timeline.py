"""puddle drive: play a timeline on a robot's servos."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.exit_codes import INTERRUPTED
from pipeline.commands.options import with_options
from pipeline.errors import PuddleError


@with_options
def drive(
    timeline: Annotated[
        Path | None, typer.Argument(help="A kit that `puddle fabricate` made, or a timeline (timeline.json).")
    ] = None,
    port: Annotated[str | None, typer.Option("--port", help="Port of the servo controller: /dev/ttyACM0.")] = None,
    list_ports: Annotated[bool, typer.Option("--list-ports", help="List this machine's serial ports.")] = False,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", help="The servos' calibration; default calibration.yaml beside the timeline."),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Do everything except talk to a controller.")] = False,
    duration: Annotated[float | None, typer.Option("--duration", help="Stop after this time [s].")] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Repeat the timeline until stopped.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Start without asking for confirmation.")] = False,
    log: Annotated[
        Path | None, typer.Option("--log", help="Log of what was sent (Parquet); default beside the timeline.")
    ] = None,
    baud: Annotated[int, typer.Option("--baud", min=300, max=200_000, help="Rate of a wired port; unused by USB.")] = (
        115200
    ),
    baud_detection: Annotated[
        bool, typer.Option("--baud-detection", help="Send 0xAA first: the controller detects the baud rate.")
    ] = False,
    timeout: Annotated[
        float,
        typer.Option("--timeout", min=0.01, help="Longest wait for the controller's answer [s]; more on a slow line."),
    ] = 0.1,
) -> None:
    """Move a robot's servos through a timeline, and return them to rest whatever happens (docs/servo.md)."""
    from pipeline.servo import play

    if list_ports:
        for line in play.port_lines():
            typer.echo(line)
        return
    if timeline is None:
        raise PuddleError("expected a kit or a timeline to play: `puddle drive kit --port ...`, or --list-ports")
    options = play.PlayOptions(timeline, calibration, port, dry_run, duration, loop, log, baud, baud_detection, timeout)
    if not play.play_timeline(options, confirm=lambda question: yes or _confirmed(question), say=typer.echo):
        raise typer.Exit(INTERRUPTED)


def _confirmed(question: str) -> bool:
    try:
        return typer.confirm(question)
    except typer.Abort:  # Ctrl-C, or no terminal to answer on
        return False
