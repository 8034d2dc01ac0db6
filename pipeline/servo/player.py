"""Playing a timeline, and the way out of it: whatever happens, servos go to neutral and are switched off.

The ways to end: the timeline's own, ``--duration``, a signal, a late host, a controller that errs, a port that is lost,
any exception at all. Each leads through :func:`_way_out`. A second signal there switches off at once, short of neutral.
Where the port is lost nothing more can be said, and the controller's own time-out does the rest.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from types import FrameType
from typing import Protocol

import numpy as np
import numpy.typing as npt

from pipeline.errors import PuddleError
from pipeline.servo.controller import ControllerFault, PortLost, ServoDriver
from pipeline.servo.limits import Outlet
from pipeline.servo.log import Entry
from tasks.fabrication.calibration import ServoCalibration
from tasks.fabrication.timeline import FRAMES_PER_SECOND

FRAME = 1 / FRAMES_PER_SECOND

LATEST = 0.25
"""A host that is so late has lost its grip on the robot [s]; a Maestro's own time-out should be twice as long."""

STARTING = 1.0
"""Time at neutral before the timeline begins [s]: nobody knows where the horns stood."""

RETURN_SPEED = 0.5
"""Of a servo's greatest speed: how fast it is brought back to neutral."""

SETTLING = 0.3
"""Time at neutral before the pulses stop [s]."""

FOLLOWING = 0.1
"""How far behind what it is sent a controller may be [s]: two frames, its own period and the reading."""

AT_NEUTRAL = 1.0
"""How far from its neutral pulse a servo counts as there [µs]: a tenth of a degree of a usual one."""

UNCONFIRMED = (
    "they were told to switch off, and the controller does not confirm it; cut their power if they hold or move"
)
NOT_SWITCHED_OFF = (
    "THEY COULD NOT BE SWITCHED OFF. The controller's own time-out does that, if it is set (docs/servo.md); cut their "
    "power if they hold or move"
)


class LateHost(PuddleError):  # noqa: N818 (what it is, not that it went wrong)
    """The computer fell too far behind the timeline."""


class Clock(Protocol):
    """Time, so that a test can bend it."""

    def now(self) -> float:
        """Give a time that never goes back [s]."""
        ...

    def sleep(self, duration: float) -> None:
        """Wait [s]."""
        ...


class RealClock:
    """The computer's own."""

    def now(self) -> float:
        """Seconds since some moment."""
        return time.monotonic()

    def sleep(self, duration: float) -> None:
        """Wait."""
        time.sleep(duration)


@dataclass
class Stop:
    """How often the user, or the system, has asked to stop."""

    asked: int = 0

    def ask(self, signum: int, frame: FrameType | None) -> None:  # noqa: ARG002
        """Ask once more: a signal's handler."""
        self.asked += 1


@contextmanager
def stopped_by_signals() -> Iterator[Stop]:
    """Turn Ctrl-C, SIGTERM and a closed terminal into a wish that the player honours within a frame."""
    stop = Stop()
    kinds = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {kind: signal.signal(kind, stop.ask) for kind in kinds}
    try:
        yield stop
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


class Notes(Protocol):
    """Where entries of the log go."""

    def add(self, *entries: Entry) -> None:
        """Keep them."""
        ...


@dataclass(frozen=True)
class Moment:
    """What the live line shows."""

    time: float
    """Since the timeline began [s]."""
    angles: Mapping[int, float]
    """Of each channel, as sent [rad]."""
    lateness: float
    """[s]"""


@dataclass
class Player:
    """One drive of some servos."""

    driver: ServoDriver
    servos: Sequence[ServoCalibration]
    log: Notes
    stop: Stop
    clock: Clock = field(default_factory=RealClock)
    show: Callable[[Moment], None] = lambda moment: None
    worst_lateness: float = 0.0
    parting: str = "they were never moved"
    """How the servos were left, in words."""

    def __post_init__(self) -> None:
        self._leaving = False
        self._outlet = Outlet(self.driver, self.servos)
        self._began = self.clock.now()
        self._turn = 0

    def play(self, pulses_us: npt.NDArray[np.float64], *, loop: bool = False, duration: float | None = None) -> str:
        """Play a timeline and lead the servos home.

        Args:
            pulses_us: (n_frames, n_servos) what the timeline asks for, servos in their order.
            loop: whether to begin again at its end, which is at rest as its beginning is.
            duration: after which to stop [s]; at the timeline's end without it.

        Returns:
            What ended it, in words.

        Raises:
            PuddleError: what went wrong; the servos are at neutral and off, unless the message says otherwise.
        """
        fault: BaseException | None = None
        try:
            rates = {servo.channel: servo.max_rate_us for servo in self.servos}
            for channel, rate in rates.items():
                self._note(f"at most {rate:g} µs/s", channel=channel)
            self.driver.prepare(rates)
            self._note("start")
            self._hold_neutral(STARTING)
            ended = self._follow(pulses_us, loop, duration)
            self._note(ended)
            return ended
        except BaseException as error:
            fault = error
            raise
        finally:
            self._way_out(fault)

    # -- the timeline ----------------------------------------------------------------------------------------------

    def _follow(self, pulses_us: npt.NDArray[np.float64], loop: bool, duration: float | None) -> str:
        start, frame = self.clock.now(), 0
        while not self.stop.asked:
            due = start + frame * FRAME
            if duration is not None and frame * FRAME >= duration:
                return f"the end of {duration:g} s"
            if frame >= len(pulses_us) and not loop:
                return "the end of the timeline"
            lateness = self._wait(due)
            wanted = pulses_us[frame % len(pulses_us)]
            by_channel = {servo.channel: float(pulse) for servo, pulse in zip(self.servos, wanted, strict=True)}
            self._command(by_channel, frame=frame, lateness=lateness)
            sent = self._outlet.sent
            self._read_back(sent)
            angles = {servo.channel: servo.angle(sent[servo.channel]) for servo in self.servos}
            self.show(Moment(frame * FRAME, angles, lateness))
            frame += 1
        return "stopped by the user"

    def _wait(self, due: float) -> float:
        """Wait for an instant, and say how much later it is now."""
        ahead = due - self.clock.now()
        if ahead > 0:
            self.clock.sleep(ahead)
        lateness = max(self.clock.now() - due, 0.0)
        self.worst_lateness = max(self.worst_lateness, lateness)
        if lateness > LATEST:
            raise LateHost(
                f"this computer was {lateness:.2f} s late, expected at most {LATEST:g} s: it is too busy, or was asleep"
            )
        return lateness

    def _command(self, wanted: Mapping[int, float], *, frame: int = -1, lateness: float | None = None) -> None:
        """Send what may be sent of what is wanted, and note it, even if it gets lost half-way."""
        now = self.clock.now()
        try:
            self._outlet.send(wanted, now)
        finally:
            self._keep(
                *(
                    Entry(
                        now - self._began,
                        frame=frame,
                        channel=channel,
                        wanted=wanted[channel],
                        sent=pulse,
                        lateness=lateness,
                    )
                    for channel, pulse in self._outlet.sent.items()
                )
            )

    def _read_back(self, sent: Mapping[int, float]) -> None:
        """Ask the controller about one servo, or for its errors, in turn: a frame has time for one answer."""
        turn, self._turn = self._turn, (self._turn + 1) % (len(self.servos) + 1)
        if turn == len(self.servos):
            self.driver.check()
            return
        servo = self.servos[turn]
        position = self._position(servo)
        if position is None:
            return
        if abs(position - sent[servo.channel]) > servo.max_rate_us * FOLLOWING + 2.0:
            raise ControllerFault(
                f"{self.driver.name}: channel {servo.channel} was sent {sent[servo.channel]:g} µs and gives "
                f"{position:g} µs. Do the controller's own limits of that channel leave room for "
                f"{servo.min_us:g} to {servo.max_us:g} µs, and is it in servo mode?"
            )

    def _position(self, servo: ServoCalibration) -> float | None:
        """Ask the controller what pulse a servo gets [µs], and note the answer; None where it can't say."""
        position = self.driver.position(servo.channel)
        if position is not None:
            self._note("position", channel=servo.channel, position=position)
        return position

    # -- the way in and the way out --------------------------------------------------------------------------------

    def _hold_neutral(self, duration: float) -> None:
        start = self.clock.now()
        for frame in range(round(duration / FRAME)):
            if self.stop.asked:
                return
            lateness = self._wait(start + frame * FRAME)
            self._command({servo.channel: servo.centre_us for servo in self.servos}, lateness=lateness)
        self.driver.check()

    def _way_out(self, fault: BaseException | None) -> None:
        """Bring the servos to neutral and switch them off; where the port is lost, say so and leave it."""
        self._leaving = True
        if fault is not None:
            self._note(f"{type(fault).__name__}: {fault}")
        if not self._outlet.sent:
            return
        where = None
        try:
            # PortLost may pass: where off, below, fails too, it says so.
            with suppress(PortLost, ControllerFault):
                where = self._return_to_neutral(self.stop.asked)
                if fault is not None:
                    self._note("home")
                    self.driver.home()
        finally:
            self._switch_off(fault, where or self._short_of_neutral())

    def _switch_off(self, fault: BaseException | None, where: str) -> None:
        try:
            self._off()
            self._see_that_they_are_off()
            self.parting = f"they were switched off {where}"
        except (PortLost, ControllerFault) as error:
            self.parting = UNCONFIRMED if isinstance(error, ControllerFault) else NOT_SWITCHED_OFF
            if fault is None:
                raise
        finally:
            self._note(f"the servos: {self.parting}")

    def _off(self) -> None:
        """Switch off, and note it, even if it gets lost half-way."""
        now = self.clock.now() - self._began
        try:
            self._outlet.off()
        finally:
            self._keep(*(Entry(now, event="off", channel=servo.channel, sent=0.0) for servo in self.servos))

    def _see_that_they_are_off(self) -> None:
        """Have the controller confirm it: bytes that were written may never have arrived."""
        for servo in self.servos:
            position = self._position(servo)
            if position:
                raise ControllerFault(
                    f"{self.driver.name}: channel {servo.channel} was switched off and still gives {position:g} µs"
                )

    def _return_to_neutral(self, asked: int) -> str:
        """Go back at half speed; a second wish to stop cuts it short. Says, in words, where that left the servos."""
        step = {servo.channel: RETURN_SPEED * servo.max_rate_us * FRAME for servo in self.servos}
        neutral = {servo.channel: servo.centre_us for servo in self.servos}
        still = 0
        while self._outlet.sent and still * FRAME < SETTLING and self.stop.asked <= asked:
            sent = self._outlet.sent
            away = {channel: neutral[channel] - pulse for channel, pulse in sent.items()}
            self._command({c: sent[c] + min(max(rest, -step[c]), step[c]) for c, rest in away.items()})
            still = still + 1 if max(map(abs, away.values())) < AT_NEUTRAL else 0
            self.clock.sleep(FRAME)
        if still * FRAME < SETTLING:
            return self._short_of_neutral()
        if not self._gives_neutral():
            return "where they stood: told to go to neutral, and the controller does not confirm that they are there"
        return "at neutral"

    def _gives_neutral(self) -> bool:
        """Whether the controller gives neutral too, where it can say: its own limits may keep a servo elsewhere."""
        try:
            gives = [(servo, self._position(servo)) for servo in self.servos]
        except ControllerFault:
            return False
        return all(pulse is None or abs(pulse - servo.centre_us) < AT_NEUTRAL for servo, pulse in gives)

    def _short_of_neutral(self) -> str:
        """Say where the servos were sent last; the horns may lag behind."""
        sent = self._outlet.sent
        angles = ", ".join(
            f"joint {servo.joint} (channel {servo.channel}) to {np.degrees(servo.angle(sent[servo.channel])):+.0f}°"
            for servo in self.servos
        )
        return f"where they stood, not at neutral: last sent were {angles}"

    # -- the log ---------------------------------------------------------------------------------------------------

    def _note(self, event: str, *, channel: int = -1, position: float | None = None) -> None:
        self._keep(Entry(self.clock.now() - self._began, event=event, channel=channel, position=position))

    def _keep(self, *entries: Entry) -> None:
        """Log entries. A full disk ends a drive, but never stands between the servos and their neutral position."""
        with suppress(OSError) if self._leaving else nullcontext():
            self.log.add(*entries)
