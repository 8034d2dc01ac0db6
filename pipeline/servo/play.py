"""``puddle servo play``: check the files, ask the user, play the timeline on a controller."""

import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.errors import PuddleError
from pipeline.fabrication.kit_folder import KIT_MANIFEST
from pipeline.fabrication.timeline_file import read_calibration, read_timeline
from pipeline.servo.connection import Connection, open_controller
from pipeline.servo.log import ServoLog, default_path
from pipeline.servo.player import NEUTRAL_HOLD, Clock, Frames, Player, PlayState, frames_of, stopped_by_signals
from pipeline.servo.servo_controller import ServoController
from pipeline.store import disk
from pipeline.store.encoding import decode_json, digest
from tasks.arrays import Float64
from tasks.fabrication.calibration import ServoCalibration
from tasks.fabrication.timeline import FRAME_RATE_HZ, TimelineError, pulses

_FRAMES_PER_UPDATE = 5  # the live line is rewritten ten times a second

SAFETY = (
    f"The servos first jump to neutral and stay there for {NEUTRAL_HOLD:g} s. Keep your fingers out of the joints and "
    f"the servos' power switch within reach. Ctrl-C returns the servos to neutral and switches them off; a second "
    f"Ctrl-C switches them off at once."
)


@dataclass(frozen=True)
class PlayOptions(Connection):
    """Options of a run."""

    timeline: Path  # A timeline, or the folder of a kit
    calibration: Path | None = None  # calibration file; None takes calibration.yaml beside the timeline
    duration: float | None = None  # time after which to stop [s], more than 0; None plays to the end
    loop: bool = False
    log: Path | None = None  # log file; None puts servo-DATE-TIME.parquet beside the timeline


def play_timeline(
    options: PlayOptions, *, confirm: Callable[[str], bool], say: Callable[[str], None], clock: Clock | None = None
) -> bool:
    """Play a timeline.

    Args:
        options: What to play, and where.
        confirm: Asks the user a yes-or-no question.
        say: Shows a line to the user.
        clock: Clock of the run; None takes the computer's.

    Returns:
        Whether the run reached its end; False if the user declined or stopped it.

    Raises:
        PuddleError: A file is invalid, the port or the controller fails. The message says how the servos were left.
    """
    if options.duration is not None and not 0 < options.duration < np.inf:
        raise PuddleError(f"--duration: expected more than 0 s, got {options.duration:g}. Nothing was moved.")
    is_kit = options.timeline.is_dir()
    path = options.timeline / "timeline.json" if is_kit else options.timeline
    manifest = path.with_name(KIT_MANIFEST)
    if is_kit and not path.exists() and manifest.is_file():
        raise PuddleError(
            f"{options.timeline}: the kit has no timeline because its servos can't play this gait. See {manifest}."
        )
    timeline = read_timeline(path)
    calibration_path = options.calibration or path.with_name("calibration.yaml")
    calibration = read_calibration(calibration_path)
    try:
        wanted = pulses(timeline, calibration)
    except TimelineError as error:
        reason = str(error).removesuffix(".")
        raise PuddleError(f"{path} with {calibration_path}: {reason}. Nothing was moved.") from None
    log_path = new_log(options.log, path.parent)
    with contextlib.closing(open_controller(options)) as controller:
        warnings = _kit_warnings(manifest, (path, calibration_path))
        for line in (*_plan(calibration.servos, wanted, options, controller), *warnings):
            say(line)
        say(f"The log of this run: {log_path}")
        if not options.dry_run and not confirm("Move the servos?"):
            say("Nothing was moved.")
            return False
        frames = frames_of(wanted, loop=options.loop, duration=options.duration)
        return run(controller, calibration.servos, frames, log_path, say, clock or Clock())


def _plan(
    servos: Sequence[ServoCalibration], wanted: Float64, options: PlayOptions, controller: ServoController
) -> Iterator[str]:
    for servo, column in zip(servos, wanted.T, strict=True):
        angles = sorted(np.degrees(servo.angle(pulse)) for pulse in (column.min(), column.max()))
        yield (
            f"  joint {servo.joint} on channel {servo.channel}: {angles[0]:+.0f}° to {angles[1]:+.0f}°, "
            f"{column.min():.0f} to {column.max():.0f} µs"
        )
    length = (len(wanted) - 1) / FRAME_RATE_HZ
    until = ""
    if options.loop:
        until = f", repeated {'until Ctrl-C' if options.duration is None else f'for {options.duration:g} s'}"
    elif options.duration is not None:
        until = f", stopped after {min(options.duration, length):g} s"
    yield f"{length:g} s of timeline on {controller.name}{until}."
    yield SAFETY


def _kit_warnings(manifest: Path, played: Sequence[Path]) -> Iterator[str]:
    """Warn of the kit's faults and of files that differ from the kit's: they may be edited, or damaged."""
    if not manifest.is_file():
        return
    kit = decode_json(disk.read(manifest), str(manifest))
    if not isinstance(kit, dict):
        return
    findings = kit.get("findings")
    n = sum(
        isinstance(one, dict) and one.get("severity") == "fault"
        for one in (findings if isinstance(findings, list) else [])
    )
    if n:
        yield f"This kit has {n} fault{'s' * (n > 1)}. See {manifest}."
    digests = kit.get("files")
    for file in played:
        expected = digests.get(file.name) if isinstance(digests, dict) and file.parent == manifest.parent else None
        if expected is not None and digest(file.read_bytes()) != expected:
            yield f"{file} has changed since the kit was made. If you did not edit it, stop: it is damaged."


def new_log(chosen: Path | None, folder: Path) -> Path:
    """Return the path of a run's log: the chosen one, or a new one in a folder. Raises PuddleError if it exists."""
    path = chosen or default_path(folder)
    if path.exists():
        raise PuddleError(f"--log: {path} already exists. Choose another name.")
    return path


def run(
    controller: ServoController,
    servos: Sequence[ServoCalibration],
    frames: Frames,
    log_path: Path,
    say: Callable[[str], None],
    clock: Clock,
) -> bool:
    """Send frames to a controller until they end or the user stops them, and log what was sent.

    Args:
        controller: An open controller.
        servos: The servos, in the order of the frames' pulses.
        frames: Yields the pulses of each frame.
        log_path: The log to write.
        say: Shows a line to the user.
        clock: Clock of the run.

    Returns:
        Whether the frames reached their end; False if the user stopped them.

    Raises:
        PuddleError: Something failed. The message says how the servos were left.
    """
    log = ServoLog(log_path, say)
    with contextlib.ExitStack() as stack:
        stack.callback(log.close)
        stop = stack.enter_context(stopped_by_signals())
        player = Player(controller, servos, log, stop, clock, show=_live_line(servos))
        try:
            ended = player.follow(frames)
        except (PuddleError, OSError) as error:
            raise PuddleError(f"{error}\nServos: {player.outcome}. Log: {log_path}") from error
        finally:  # before the log is closed, because an error there would replace this message
            with contextlib.suppress(OSError):  # the terminal is closed
                say(f"Servos: {player.outcome}.")
    say(f"{ended[0].upper()}{ended[1:]}.")
    say(f"Largest delay of a command: {1000 * player.worst_lateness:.1f} ms. Log: {log_path}")
    return not stop.count


def _live_line(servos: Sequence[ServoCalibration]) -> Callable[[PlayState], None]:
    """Return a function that rewrites one line of the terminal, or does nothing without a terminal."""
    if not sys.stderr.isatty():
        return lambda state: None
    count = 0

    def show(state: PlayState) -> None:
        nonlocal count
        count += 1
        if count % _FRAMES_PER_UPDATE == 1:
            angles = "  ".join(f"joint {s.joint} {np.degrees(state.angles[s.channel]):+6.1f}°" for s in servos)
            sys.stderr.write(f"\r{state.time:7.1f} s  {angles}  late {1000 * state.lateness:5.1f} ms  (Ctrl-C stops) ")
            sys.stderr.flush()

    return show
