"""``puddle servo play`` and ``off``: check the files, ask the user, play the timeline on a controller."""

import contextlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.bench.fabrication.kit_files import KIT_MANIFEST, read_calibration, read_timeline
from pipeline.bench.servo.log import ServoLog, default_path
from pipeline.bench.servo.player import NEUTRAL_HOLD, Clock, Frames, Player, PlayState, frames_of, stopped_by_signals
from pipeline.bench.servo.servo_controller import ControllerError, DryRunController, ServoController
from pipeline.errors import PuddleError
from pipeline.store.encoding import decode_json
from tasks.bench.fabrication.calibration import Calibration, ServoCalibration
from tasks.bench.fabrication.timeline import FRAME_RATE_HZ, TimelineError, pulses

_FRAMES_PER_UPDATE = 5  # the live line is rewritten ten times a second

SAFETY = (
    f"The servos first jump to neutral and stay there for {NEUTRAL_HOLD:g} s. Keep your fingers out of the joints and "
    f"the servos' power switch within reach. Ctrl-C returns the servos to neutral and switches them off; a second "
    f"Ctrl-C switches them off at once."
)

Say = Callable[[str], None]  # shows a line to the user
Confirm = Callable[[str], bool]  # asks the user a yes-or-no question


@dataclass(frozen=True, kw_only=True)
class Connection:
    """Options that choose a controller."""

    port: str | None = None
    dry_run: bool = False
    timeout: float = 0.1  # longest wait for an answer of the controller [s]


@dataclass(frozen=True)
class PlayOptions(Connection):
    """Options of a run."""

    timeline: Path  # a timeline, or the folder of a kit
    calibration: Path | None = None  # calibration file; None takes calibration.yaml beside the timeline
    duration: float | None = None  # time after which to stop [s]; None plays to the end
    loop: bool = False
    log: Path | None = None  # log file; None puts servo-DATE-TIME.csv beside the timeline


def open_controller(connection: Connection) -> ServoController:
    """Open the controller that the user chose. Add other kinds of controllers here."""
    if connection.dry_run:
        return DryRunController()
    if connection.port is None:
        raise PuddleError("--port: expected the controller's port (`puddle servo play --list-ports`), or --dry-run")
    from pipeline.bench.servo.maestro import open_maestro

    return open_maestro(connection.port, timeout=connection.timeout)


def calibration_at(path: Path) -> tuple[Path, Calibration]:
    """Read the calibration of a kit, or a calibration file. Return its path too."""
    file = path / "calibration.yaml" if path.is_dir() else path
    return file, read_calibration(file)


def play_timeline(options: PlayOptions, *, confirm: Confirm, say: Say, clock: Clock | None = None) -> bool:
    """Play a timeline. Returns whether the run reached its end; False if the user declined or stopped it.

    Raises PuddleError if a file is invalid, or the port or the controller fails; it says how the servos were left.
    """
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
    servos = calibration.servos
    try:
        wanted = pulses(timeline, calibration)
    except TimelineError as error:
        reason = str(error).removesuffix(".")
        raise PuddleError(f"{path} with {calibration_path}: {reason}. Nothing was moved.") from None
    log_path = options.log or default_path(path.parent)
    with contextlib.closing(open_controller(options)) as controller:
        for servo, column in zip(servos, wanted.T, strict=True):
            low, high = sorted(np.degrees(servo.angle(pulse)) for pulse in (column.min(), column.max()))
            span = f"{low:+.0f}° to {high:+.0f}°, {column.min():.0f} to {column.max():.0f} µs"
            say(f"  joint {servo.joint} on channel {servo.channel}: {span}")
        length = (len(wanted) - 1) / FRAME_RATE_HZ
        again = ", again and again" if options.loop else ""
        until = "" if options.duration is None else f", stopped after {options.duration:g} s"
        say(f"{length:g} s of timeline on {controller.name}{again}{until}.")
        say(SAFETY)
        if n := _n_faults(manifest):
            say(f"This kit has {n} fault{'s' * (n > 1)}. See {manifest}.")
        say(f"The log of this run: {log_path}")
        if not options.dry_run and not confirm("Move the servos?"):
            say("Nothing was moved.")
            return False
        frames = frames_of(wanted, loop=options.loop, duration=options.duration)
        return run(controller, servos, frames, log_path, say, clock or Clock())


def _n_faults(manifest: Path) -> int:
    if not manifest.is_file():
        return 0
    kit = decode_json(manifest.read_bytes(), str(manifest))
    return sum(finding["severity"] == "fault" for finding in kit["findings"])


def run(
    controller: ServoController,
    servos: Sequence[ServoCalibration],
    frames: Frames,
    log_path: Path,
    say: Say,
    clock: Clock,
) -> bool:
    """Send frames to an open controller until they end or the user stops them, and log what was sent.

    Returns whether the frames reached their end. Raises PuddleError if something fails; the message says how the servos
    were left.
    """
    with ServoLog(log_path) as log, stopped_by_signals() as stop:
        player = Player(controller, servos, log, stop, clock, show=_live_line(servos))
        try:
            ended = player.follow(frames)
        except (PuddleError, OSError) as error:
            raise PuddleError(f"{error}\nServos: {player.outcome}. Log: {log_path}") from error
        finally:
            with contextlib.suppress(OSError):  # the terminal is closed
                say(f"Servos: {player.outcome}.")
    say(f"{ended[0].upper()}{ended[1:]}.")
    say(f"Largest delay of a command: {1000 * player.worst_lateness:.1f} ms. Log: {log_path}")
    return not stop.count


def _live_line(servos: Sequence[ServoCalibration]) -> Callable[[PlayState], None]:
    """Return a function that rewrites one line of the terminal, or does nothing without a terminal."""
    if not sys.stderr.isatty():
        return lambda state: None

    def show(state: PlayState) -> None:
        if round(state.time * FRAME_RATE_HZ) % _FRAMES_PER_UPDATE == 0:
            angles = "  ".join(f"joint {s.joint} {np.degrees(state.angles[s.channel]):+6.1f}°" for s in servos)
            sys.stderr.write(f"\r{state.time:7.1f} s  {angles}  late {1000 * state.lateness:5.1f} ms  (Ctrl-C stops) ")
            sys.stderr.flush()

    return show


def switch_off(controller: ServoController, calibration: Calibration) -> None:
    """Stop the pulses of all servos, and read back that they stopped.

    Raises PortLostError, or ControllerError if the controller reports an error or still puts out a pulse.
    """
    channels = tuple(servo.channel for servo in calibration.servos)
    try:
        controller.prepare({})
    finally:  # even if the controller does not answer, it may receive
        controller.off(channels)
    for channel in channels:
        if position := controller.position(channel):
            raise ControllerError(
                f"{controller.name}: channel {channel} is switched off but puts out {position:g} µs. Cut the servos' "
                f"power if they hold or move"
            )
