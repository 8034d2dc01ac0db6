"""The playing loop and its shutdown: however a run ends, the servos return to neutral and are switched off.

A run ends with the timeline, after ``--duration``, on a signal, when the host is late, when the controller fails, when
the port is lost, or on any other exception. All of these lead through :meth:`Player._shut_down`. A second signal there
switches the servos off at once. If the port is lost, only the controller's own time-out can still act.
"""

import itertools
import signal
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field

import numpy as np

from pipeline.bench.servo.limits import LimitedOutput
from pipeline.bench.servo.log import LogEntry, ServoLog
from pipeline.bench.servo.servo_controller import ControllerError, PortLostError, ServoController, confirm_off
from pipeline.cluster.process import handled
from pipeline.errors import PuddleError
from tasks.arrays import Float64
from tasks.bench.fabrication.calibration import ServoCalibration
from tasks.bench.fabrication.timeline import FRAME_RATE_HZ

_FRAME = 1 / FRAME_RATE_HZ
MAX_LATENESS = 0.25  # longest delay after which a run goes on [s]; the Maestro's own time-out should be twice as long
NEUTRAL_HOLD = 1.0  # at neutral before the timeline begins [s], because the horns' initial position is unknown
_RETURN_SPEED = 0.5  # share of a servo's maximum speed on the way back to neutral
_SETTLING_TIME = 0.3  # at neutral before the pulses stop [s]
_READBACK_DELAY = 0.1  # longest delay of a reported pulse [s]: two frames, the controller's own period and the reading
_NEUTRAL_TOLERANCE_US = 1.0  # a tenth of a degree of a common servo

_UNCONFIRMED = "told to switch off, but the controller does not confirm it. Cut their power if they hold or move"
_NOT_SWITCHED_OFF = (
    "NOT SWITCHED OFF. The controller's own time-out does that, if it is set (docs/servo.md). Cut their power if they "
    "hold or move"
)

Frames = Generator[Float64, None, str]
"""Yields the (n_servos,) pulses of each frame [µs], in the order of the servos; returns what ended them, in words."""


def frames_of(pulses_us: Float64, *, loop: bool = False, duration: float | None = None) -> Frames:
    """Yield the (n_frames, n_servos) pulses [µs] of a timeline, again and again if ``loop``, for a duration [s]."""
    for frame in itertools.count():
        if duration is not None and frame * _FRAME >= duration:
            return f"stopped after {duration:g} s"
        if frame >= len(pulses_us) and not loop:
            break
        yield pulses_us[frame % len(pulses_us)]
    return "the timeline ended"


Show = Callable[[float, Mapping[int, float], float], None]
"""Shows a run after a frame: the time since the timeline began [s], the pulses sent by channel [µs], the delay [s]."""


class Clock:
    """The computer's monotonic clock [s]. Tests pass their own."""

    now = staticmethod(time.monotonic)
    sleep = staticmethod(time.sleep)


@dataclass
class StopRequest:
    """Number of times that the user or the system has asked to stop."""

    count: int = 0

    def ask(self, *_: object) -> None:
        """Handle a signal."""
        self.count += 1


@contextmanager
def stopped_by_signals() -> Iterator[StopRequest]:
    """Turn Ctrl-C, SIGTERM and SIGHUP into a request that the player serves within a frame."""
    stop = StopRequest()
    with handled((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), stop.ask):
        yield stop


@dataclass
class Player:
    """One run on a controller."""

    controller: ServoController
    servos: Sequence[ServoCalibration]
    log: ServoLog
    stop: StopRequest
    clock: Clock = field(default_factory=Clock)
    show: Show = lambda time, sent, lateness: None
    neutral: Mapping[int, float] | None = None  # pulse at rest of each channel [µs], which may change; the centres
    worst_lateness: float = 0.0
    outcome: str = "never moved"  # how the run left the servos, in words

    def __post_init__(self) -> None:
        self._shutting_down = False
        self._output = LimitedOutput(self.controller, self.servos)
        self._began = self.clock.now()
        self._turn = 0
        self._neutral = self.neutral or {servo.channel: servo.centre_us for servo in self.servos}

    def follow(self, frames: Frames) -> str:
        """Hold neutral, send what each frame asks for, then return the servos to neutral and switch them off.

        Returns what ended the run, in words. Raises PuddleError if something goes wrong; the servos are then at neutral
        and off unless ``outcome`` says otherwise.
        """
        failure: BaseException | None = None
        try:
            self.controller.prepare({servo.channel: servo.max_rate_us for servo in self.servos})
            self._note("start")
            self._hold_neutral()
            ended = self._send_frames(frames)
            self._note(ended)
            return ended
        except BaseException as error:
            failure = error
            raise
        finally:
            self._shut_down(failure)

    def _hold_neutral(self) -> None:
        start = self.clock.now()
        for frame in range(round(NEUTRAL_HOLD / _FRAME)):
            if self.stop.count:
                return
            lateness = self._wait_until(start + frame * _FRAME)
            self._command(self._neutral, lateness=lateness)
        self.controller.check()

    def _send_frames(self, frames: Frames) -> str:
        start, frame = self.clock.now(), 0
        while not self.stop.count:
            try:
                wanted = next(frames)
            except StopIteration as end:
                return str(end.value)
            lateness = self._wait_until(start + frame * _FRAME)
            by_channel = {servo.channel: float(pulse) for servo, pulse in zip(self.servos, wanted, strict=True)}
            self._command(by_channel, frame=frame, lateness=lateness)
            sent = self._output.sent
            self._read_back(sent)
            self.show(frame * _FRAME, sent, lateness)
            frame += 1
        return "stopped by the user"

    def _wait_until(self, due: float) -> float:
        """Sleep until an instant and return the delay [s]."""
        ahead = due - self.clock.now()
        if ahead > 0:
            self.clock.sleep(ahead)
        lateness = max(self.clock.now() - due, 0.0)
        self.worst_lateness = max(self.worst_lateness, lateness)
        if lateness > MAX_LATENESS:
            expected = f"expected at most {MAX_LATENESS:g} s. Close other programs."
            raise PuddleError(f"this computer was {lateness:.2f} s late, {expected}")
        return lateness

    def _command(self, wanted: Mapping[int, float], *, frame: int | None = None, lateness: float | None = None) -> None:
        """Send pulses and log them, also if the write fails half-way."""
        now = self.clock.now()
        try:
            self._output.send(wanted, now)
        finally:
            since = now - self._began
            rows = (
                LogEntry(since, "", frame, channel, wanted[channel], pulse, None, lateness)
                for channel, pulse in self._output.sent.items()
            )
            self._record(*rows)

    def _read_back(self, sent: Mapping[int, float]) -> None:
        """Read one servo's pulse, or the errors, in turn: a frame has time for one answer."""
        turn, self._turn = self._turn, (self._turn + 1) % (len(self.servos) + 1)
        if turn == len(self.servos):
            self.controller.check()
            return
        servo = self.servos[turn]
        position = self._position(servo)
        if position is not None and abs(position - sent[servo.channel]) > servo.max_rate_us * _READBACK_DELAY + 2.0:
            raise ControllerError(
                f"{self.controller.name}: sent {sent[servo.channel]:g} µs to channel {servo.channel}, it puts out "
                f"{position:g} µs. Set the channel to servo mode, with limits beyond {servo.min_us:g} to "
                f"{servo.max_us:g} µs, in the controller's own settings."
            )

    def _position(self, servo: ServoCalibration) -> float | None:
        """Read and log the pulse that a servo gets [µs]; None if the controller can't tell."""
        position = self.controller.position(servo.channel)
        if position is not None:
            self._note("position", channel=servo.channel, position=position)
        return position

    def _shut_down(self, failure: BaseException | None) -> None:
        """Return the servos to neutral and switch them off."""
        self._shutting_down = True
        if failure is not None:
            self._note(f"{type(failure).__name__}: {failure}")
        if not self._output.sent:
            return
        where = None
        try:
            # If the port is lost, switching off fails too and reports it.
            with suppress(PortLostError, ControllerError):
                where = self._return_to_neutral(self.stop.count)
        finally:
            self._switch_off(failure, where or self._short_of_neutral())

    def _switch_off(self, failure: BaseException | None, where: str) -> None:
        """Stop the pulses, and read each one back, because written bytes may not have arrived."""
        now = self.clock.now() - self._began
        try:
            try:
                self._output.off()
            finally:
                self._record(*(LogEntry(now, event="off", channel=servo.channel, sent=0.0) for servo in self.servos))
            confirm_off(self.controller, {servo.channel: self._position(servo) for servo in self.servos})
            self.outcome = f"switched off {where}"
        except (PortLostError, ControllerError) as error:
            self.outcome = _UNCONFIRMED if isinstance(error, ControllerError) else _NOT_SWITCHED_OFF
            if failure is None:
                raise
        finally:
            self._note(f"servos: {self.outcome}")

    def _return_to_neutral(self, already_asked: int) -> str:
        """Go back at half speed unless the user asks again to stop. Return where the servos are, in words."""
        step = {servo.channel: _RETURN_SPEED * servo.max_rate_us * _FRAME for servo in self.servos}
        neutral, still = self._neutral, 0
        while self._output.sent and still * _FRAME < _SETTLING_TIME and self.stop.count <= already_asked:
            sent = self._output.sent
            away = {channel: neutral[channel] - pulse for channel, pulse in sent.items()}
            self._command({c: sent[c] + min(max(rest, -step[c]), step[c]) for c, rest in away.items()})
            still = still + 1 if max(map(abs, away.values())) < _NEUTRAL_TOLERANCE_US else 0
            self.clock.sleep(_FRAME)
        if still * _FRAME < _SETTLING_TIME:
            return self._short_of_neutral()
        if not self._confirms_neutral():
            return "at an unknown position: sent to neutral, but the controller does not confirm it"
        return "at neutral"

    def _confirms_neutral(self) -> bool:
        """Check the pulses that the controller puts out; its own limits may differ from the calibration's."""
        try:
            reported = [(servo, self._position(servo)) for servo in self.servos]
        except ControllerError:
            return False
        return all(
            pulse is None or abs(pulse - self._neutral[servo.channel]) < _NEUTRAL_TOLERANCE_US
            for servo, pulse in reported
        )

    def _short_of_neutral(self) -> str:
        sent = self._output.sent
        angles = ", ".join(
            f"joint {servo.joint} (channel {servo.channel}) {np.degrees(servo.angle(sent[servo.channel])):+.0f}°"
            for servo in self.servos
        )
        return f"away from neutral, last sent to: {angles}"

    def _note(self, event: str, *, channel: int | None = None, position: float | None = None) -> None:
        self._record(LogEntry(self.clock.now() - self._began, event=event, channel=channel, position=position))

    def _record(self, *entries: LogEntry) -> None:
        """Log entries. A full disk ends a run, but must not keep the servos from returning to neutral."""
        with suppress(OSError) if self._shutting_down else nullcontext():
            self.log.add(*entries)
