"""``puddle servo play`` and ``off``: check the files, ask the user, play the timeline on a controller."""

import contextlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.bench.fabrication.kit_files import KIT_MANIFEST, read_timeline
from pipeline.bench.servo.log import ServoLog, default_path
from pipeline.bench.servo.player import NEUTRAL_HOLD, Clock, Frames, Player, Show, frames_of, stopped_by_signals
from pipeline.bench.servo.servo_controller import DryRunController, ServoController, confirm_off
from pipeline.config.loading import load
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


@dataclass(frozen=True)
class User:
    """The user on the terminal."""

    confirm: Callable[[str], bool]  # asks a yes-or-no question
    say: Callable[[str], None]  # shows a line
    read: Callable[[], str | None] = lambda: None
    """Returns the next line that the user typed, or None while there is none. Raises EOFError where none can follow."""


@dataclass(frozen=True)
class Connection:
    """The controller that the user chose."""

    port: str | None = None
    timeout: float = 0.1  # longest wait for an answer [s]
    dry_run: bool = False

    def open(self) -> ServoController:
        """Open the controller. Add other kinds of controllers here."""
        if self.dry_run:
            return DryRunController()
        if self.port is None:
            raise PuddleError("--port: expected the controller's port (`puddle servo play --list-ports`), or --dry-run")
        from pipeline.bench.servo.maestro import open_maestro

        return open_maestro(self.port, timeout=self.timeout)


def calibration_at(path: Path) -> tuple[Path, Calibration]:
    """Read the calibration of a kit, or a calibration file. Return its path too."""
    file = path / "calibration.yaml" if path.is_dir() else path
    return file, load(Calibration, file)


def play_timeline(
    kit: Path,
    connection: Connection,
    user: User,
    calibration_path: Path | None = None,
    *,
    duration: float | None = None,
    loop: bool = False,
    log: Path | None = None,
    clock: Clock | None = None,
) -> bool:
    """Play a timeline, or that of a kit's folder, once the user agrees; for a duration [s], or to its end.

    The calibration is calibration.yaml beside the timeline, and the log servo-DATE-TIME.csv, unless they are given.
    Returns whether the run reached its end; False if the user declined or stopped it. Raises PuddleError if a file is
    invalid, or the port or the controller fails; it says how the servos were left.
    """
    path = kit / "timeline.json" if kit.is_dir() else kit
    manifest = path.with_name(KIT_MANIFEST)
    if kit.is_dir() and not path.exists() and manifest.is_file():
        raise PuddleError(f"{kit}: the kit has no timeline because its servos can't play this gait. See {manifest}.")
    timeline = read_timeline(path)
    calibration_path = calibration_path or path.with_name("calibration.yaml")
    calibration = load(Calibration, calibration_path)
    servos = calibration.servos
    try:
        wanted = pulses(timeline, calibration)
    except TimelineError as error:
        reason = str(error).removesuffix(".")
        raise PuddleError(f"{path} with {calibration_path}: {reason}. Nothing was moved.") from None
    log_path = log or default_path(path.parent)
    with contextlib.closing(connection.open()) as controller:
        for servo, column in zip(servos, wanted.T, strict=True):
            low, high = sorted(np.degrees(servo.angle(pulse)) for pulse in (column.min(), column.max()))
            span = f"{low:+.0f}° to {high:+.0f}°, {column.min():.0f} to {column.max():.0f} µs"
            user.say(f"  joint {servo.joint} on channel {servo.channel}: {span}")
        length = (len(wanted) - 1) / FRAME_RATE_HZ
        again = ", again and again" if loop else ""
        until = "" if duration is None else f", stopped after {duration:g} s"
        user.say(f"{length:g} s of timeline on {controller.name}{again}{until}.")
        user.say(SAFETY)
        if n := _n_faults(manifest):
            user.say(f"This kit has {n} fault{'s' * (n > 1)}. See {manifest}.")
        user.say(f"The log of this run: {log_path}")
        if not connection.dry_run and not user.confirm("Move the servos?"):
            user.say("Nothing was moved.")
            return False
        frames = frames_of(wanted, loop=loop, duration=duration)
        return run(controller, servos, frames, log_path, user, clock or Clock())


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
    user: User,
    clock: Clock,
    *,
    show: Show | None = None,
    neutral: Mapping[int, float] | None = None,
) -> bool:
    """Send frames to an open controller until they end or the user stops them, and log what was sent.

    ``show`` is called for each frame, by default to keep a line of the terminal up to date. Servos return to
    ``neutral``, by default to their centres. Returns whether the frames reached their end. Raises PuddleError if
    something fails; the message says how the servos were left.
    """
    with ServoLog(log_path) as log, stopped_by_signals() as stop:
        player = Player(controller, servos, log, stop, clock, show=show or _live_line(servos), neutral=neutral)
        try:
            ended = player.follow(frames)
        except (PuddleError, OSError) as error:
            raise PuddleError(f"{error}\nServos: {player.outcome}. Log: {log_path}") from error
        finally:
            with contextlib.suppress(OSError):  # the terminal is closed
                user.say(f"Servos: {player.outcome}.")
    user.say(f"{ended[0].upper()}{ended[1:]}.")
    user.say(f"Largest delay of a command: {1000 * player.worst_lateness:.1f} ms. Log: {log_path}")
    return not stop.count


def _live_line(servos: Sequence[ServoCalibration]) -> Show:
    """Return a function that rewrites one line of the terminal, or does nothing without a terminal."""

    def show(time: float, sent: Mapping[int, float], lateness: float) -> None:
        if sys.stderr.isatty() and round(time * FRAME_RATE_HZ) % _FRAMES_PER_UPDATE == 0:
            angles = (f"joint {servo.joint} {np.degrees(servo.angle(sent[servo.channel])):+6.1f}°" for servo in servos)
            late = f"late {1000 * lateness:5.1f} ms"
            sys.stderr.write(f"\r{time:7.1f} s  {'  '.join(angles)}  {late}  (Ctrl-C stops) ")
            sys.stderr.flush()

    return show


def switch_off(connection: Connection, calibration: Calibration) -> tuple[int, ...]:
    """Stop the pulses of all servos, and read back that they stopped. Returns their channels.

    Raises PortLostError, or ControllerError if the controller reports an error or still puts out a pulse.
    """
    channels = tuple(servo.channel for servo in calibration.servos)
    with contextlib.closing(connection.open()) as controller:
        try:
            controller.prepare({})
        finally:  # even if the controller does not answer, it may receive
            controller.off(channels)
        confirm_off(controller, {channel: controller.position(channel) for channel in channels})
    return channels
