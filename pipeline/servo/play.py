"""``puddle drive``: from a timeline file to moving servos, and the words around it."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pipeline.errors import PuddleError
from pipeline.fabrication.kit_folder import MARK
from pipeline.fabrication.timeline_file import read_calibration, read_timeline
from pipeline.servo.controller import DryRun, ServoDriver
from pipeline.servo.log import DriveLog
from pipeline.servo.player import STARTING, Moment, Player, stopped_by_signals
from pipeline.store import disk
from pipeline.store.encoding import decode_json, digest
from tasks.fabrication.calibration import Calibration, ServoCalibration
from tasks.fabrication.timeline import FRAMES_PER_SECOND, TimelineError, pulses

TIMELINE, CALIBRATION = "timeline.json", "calibration.yaml"
"""Names of the files in a kit."""

FRAMES_BETWEEN_LINES = 5
"""The live line is written ten times a second."""


@dataclass(frozen=True)
class Wish:
    """What the user asked for."""

    timeline: Path
    """A timeline, or the folder of a kit."""
    calibration: Path | None = None
    """Beside the timeline, unless given."""
    port: str | None = None
    dry_run: bool = False
    duration: float | None = None
    """After which to stop [s]; more than 0."""
    loop: bool = False
    log: Path | None = None
    """Where to write what was sent; beside the timeline, with the time in its name, unless given."""
    baud: int = 115200
    baud_detection: bool = False


def port_lines() -> list[str]:
    """List this machine's serial ports, a Maestro's marked."""
    from serial.tools.list_ports import comports

    from pipeline.servo.maestro import PRODUCT_IDS, VENDOR_ID

    lines = []
    for port in sorted(comports(), key=lambda one: one.device):
        ours = port.vid == VENDOR_ID and port.pid in PRODUCT_IDS
        lines.append(f"{port.device}  {port.description}{'  <- a Maestro' if ours else ''}")
    maestro = "A Maestro shows two ports; its Command Port, for --port, is usually the first."
    return [*lines, maestro] if lines else ["No serial port. Is the controller plugged in?"]


def drive(wish: Wish, *, confirm: Callable[[str], bool], say: Callable[[str], None]) -> bool:
    """Play a timeline.

    Args:
        wish: what the user asked for.
        confirm: puts a question to the user, and says whether the answer is yes.
        say: shows a line.

    Returns:
        Whether it came to its end; False where the user said no, or stopped it.

    Raises:
        PuddleError: files that are none, a port that fails, a controller that errs; the servos are safe, or the
            message says that they are not.
    """
    if wish.duration is not None and wish.duration <= 0:
        raise PuddleError(f"--duration: expected more than 0 s, came {wish.duration:g}. Nothing was moved.")
    path = wish.timeline / TIMELINE if wish.timeline.is_dir() else wish.timeline
    if wish.timeline.is_dir() and not path.exists() and (wish.timeline / MARK).is_file():
        raise PuddleError(
            f"{wish.timeline}: the kit has no timeline: its servos can't play this gait. "
            f"{wish.timeline / MARK} says why."
        )
    timeline = read_timeline(path)
    calibrated_by = wish.calibration or path.with_name(CALIBRATION)
    servos = _calibration(calibrated_by)
    try:
        wanted = pulses(timeline, servos)
    except TimelineError as error:
        raise PuddleError(f"{path} with {calibrated_by}: {str(error).removesuffix('.')}. Nothing was moved.") from None
    log_path = wish.log or path.with_name(f"drive-{datetime.now():%Y%m%d-%H%M%S}.parquet")
    if log_path.exists():
        raise PuddleError(f"--log: {log_path} is there already. Choose another name.")
    with contextlib.closing(open_driver(wish)) as driver:
        of_kit = _said_by_kit(path.with_name(MARK), (path, calibrated_by))
        for line in (*_plan(servos.servos, wanted, wish, driver), *of_kit):
            say(line)
        say(f"What is sent will be in {log_path}.")
        if not wish.dry_run and not confirm("Move the servos?"):
            say("Nothing was moved.")
            return False
        return _play(driver, servos.servos, wanted, wish, log_path, say)


def _calibration(path: Path) -> Calibration:
    """Read a calibration; where there is no such file, call it what it should be, which is not settings."""
    try:
        return read_calibration(path)
    except PuddleError as error:
        if isinstance(error.__cause__, OSError):
            raise PuddleError(f"{path}: expected a calibration file, came: {error.__cause__.strerror}") from error
        raise


def open_driver(wish: Wish) -> ServoDriver:
    """Open the controller that the user names: the place to name another kind."""
    if wish.dry_run:
        return DryRun()
    if wish.port is None:
        raise PuddleError("--port: expected the controller's port (`puddle drive --list-ports`), or --dry-run")
    from pipeline.servo.maestro import open_maestro

    return open_maestro(wish.port, baud=wish.baud, baud_detection=wish.baud_detection)


def _plan(
    servos: Sequence[ServoCalibration], wanted: npt.NDArray[np.float64], wish: Wish, driver: ServoDriver
) -> Iterator[str]:
    """Say what is about to happen."""
    for servo, column in zip(servos, wanted.T, strict=True):
        angles = sorted(np.degrees(servo.angle(pulse)) for pulse in (column.min(), column.max()))
        yield (
            f"  joint {servo.joint} on channel {servo.channel}: {angles[0]:+.0f}° to {angles[1]:+.0f}°, "
            f"{column.min():.0f} to {column.max():.0f} µs"
        )
    length = (len(wanted) - 1) / FRAMES_PER_SECOND
    until = ""
    if wish.loop:
        until = f", over and over, {'until Ctrl-C' if wish.duration is None else f'for {wish.duration:g} s'}"
    elif wish.duration is not None:
        until = f", stopped after {min(wish.duration, length):g} s"
    yield f"{length:g} s of timeline on {driver.name}{until}."
    yield (
        f"At first the servos jump to neutral, from wherever they are, and stay there for {STARTING:g} s. Keep fingers "
        f"out of the joints and the servos' power switch in reach. Ctrl-C brings them back to neutral and switches "
        f"them off; a second one switches them off at once, wherever they stand."
    )


def _said_by_kit(mark: Path, played: Sequence[Path]) -> Iterator[str]:
    """Say how much speaks against the kit that a timeline is of, if it is of one, and what was edited of it.

    Editing is the user's right (a calibration is there for it); that a file was damaged looks the same.
    """
    if not mark.is_file():
        return
    said = decode_json(disk.read(mark), str(mark))
    if not isinstance(said, dict):
        return
    n = sum(isinstance(one, dict) and one.get("severity") == "fault" for one in said.get("findings", []))
    if n:
        yield f"{n} fault{'s' * (n > 1)} found in this kit speak{'s' * (n == 1)} against it: {mark} lists them."
    made = said.get("files")
    for file in played:
        sha256 = made.get(file.name) if isinstance(made, dict) and file.parent == mark.parent else None
        if sha256 is not None and digest(file.read_bytes()) != sha256:
            yield f"{file} is not as it was made with the kit. If you changed nothing in it, stop: it is damaged."


def _play(
    driver: ServoDriver,
    servos: Sequence[ServoCalibration],
    wanted: npt.NDArray[np.float64],
    wish: Wish,
    log_path: Path,
    say: Callable[[str], None],
) -> bool:
    log = DriveLog(log_path)
    with contextlib.ExitStack() as stack:
        stack.callback(log.close)
        stop = stack.enter_context(stopped_by_signals())
        player = Player(driver, servos, log, stop, show=live_line(servos))
        try:
            ended = player.play(wanted, loop=wish.loop, duration=wish.duration)
        except (PuddleError, OSError) as error:
            raise PuddleError(f"{error}\nThe servos: {player.parting}. What was sent is in {log_path}.") from error
        finally:  # also for a defect, and before the log is closed: a full disk's error takes the place of this one
            with contextlib.suppress(OSError):  # a closed terminal
                say(f"The servos: {player.parting}.")
    say(f"{ended[0].upper()}{ended[1:]}.")
    say(f"The latest command was {1000 * player.worst_lateness:.1f} ms late. What was sent is in {log_path}.")
    return not stop.asked


def live_line(servos: Sequence[ServoCalibration]) -> Callable[[Moment], None]:
    """Give what shows the run as it goes: one line of a terminal, rewritten; nothing elsewhere."""
    if not sys.stderr.isatty():
        return lambda moment: None
    count = 0

    def show(moment: Moment) -> None:
        nonlocal count
        count += 1
        if count % FRAMES_BETWEEN_LINES == 1:
            angles = "  ".join(f"joint {s.joint} {np.degrees(moment.angles[s.channel]):+6.1f}°" for s in servos)
            line = f"\r{moment.time:7.1f} s  {angles}  late {1000 * moment.lateness:5.1f} ms  (Ctrl-C stops) "
            sys.stderr.write(line)
            sys.stderr.flush()

    return show
