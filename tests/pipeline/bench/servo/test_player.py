"""The player on a simulated Maestro: it keeps the limits and ends at neutral and off, whatever fails."""

import csv
import os
import signal

import numpy as np
import pytest

from pipeline.bench.servo.limits import LONGEST_STEP
from pipeline.bench.servo.log import LogEntry, ServoLog
from pipeline.bench.servo.maestro import open_maestro
from pipeline.bench.servo.player import MAX_LATENESS, Player, StopRequest, frames_of, stopped_by_signals
from pipeline.bench.servo.servo_controller import ControllerError, DryRunController, PortLostError
from pipeline.errors import PuddleError
from tasks.bench.fabrication.timeline import Timeline, envelope, pulses

N_FRAMES = 201


@pytest.fixture(scope="module")
def wanted(calibration):
    """Four seconds of a 40° swing at 0.5 Hz. Its speed, 0.7 · π plus ramps, is below 3 rad/s."""
    time = np.arange(N_FRAMES) / 50
    rise = envelope(time, duration=4.0, ramp=1.0)
    swing = rise[:, None] * 0.7 * np.sin(np.pi * time[:, None] + [0.0, 1.0])
    return pulses(Timeline(joints=(2, 4), angle=swing), calibration)


class Memory:
    def __init__(self) -> None:
        self.entries: list[LogEntry] = []

    def add(self, *entries: LogEntry) -> None:
        self.entries += entries

    def sent(self, channel: int) -> list[float]:
        return [entry.sent for entry in self.entries if entry.channel == channel and entry.sent is not None]


def player_of(fake, calibration, clock, *, log=None, stop=None) -> Player:
    return Player(
        open_maestro(fake.path, timeout=10.0), calibration.servos, log or Memory(), stop or StopRequest(), clock=clock
    )


def check_what_it_was_sent(fake, calibration) -> None:
    """Check that every pulse is within its limits and rate, and that each servo starts at neutral."""
    for servo in calibration.servos:
        before = None
        for pulse in fake.pulses(servo.channel):
            if pulse == 0:
                before = None
                continue
            assert servo.min_us <= pulse <= servo.max_us
            if before is None:
                assert pulse == servo.centre_us
            else:
                assert abs(pulse - before) <= servo.max_rate_us * LONGEST_STEP
            before = pulse


def check_neutral_and_off(fake, calibration) -> None:
    check_what_it_was_sent(fake, calibration)
    assert not fake.on
    for servo in calibration.servos:
        *_, last, off = fake.pulses(servo.channel)
        assert off == 0 and last == servo.centre_us


def test_a_timeline_from_rest_to_rest(plug, calibration, wanted, clock, tmp_path):
    fake = plug()
    with ServoLog(tmp_path / "run.csv") as log:
        player = player_of(fake, calibration, clock, log=log)
        assert player.follow(frames_of(wanted)) == "the timeline ended"
    fake.finish()
    check_neutral_and_off(fake, calibration)
    assert fake.errors == 0 and player.worst_lateness == 0 and player.outcome == "switched off at neutral"
    rows = list(csv.DictReader((tmp_path / "run.csv").open()))
    for column, servo in enumerate(calibration.servos):
        sent = np.array(fake.pulses(servo.channel)[50 : 50 + N_FRAMES])  # after a second at neutral
        np.testing.assert_allclose(sent, wanted[:, column], rtol=0, atol=0.125 + 1e-9)
        # The controller limits the rate less than the host, so it never lags behind.
        assert fake.speeds[servo.channel] * 25.0 >= servo.max_rate_us
        logged = [row for row in rows if row["channel"] == str(servo.channel)]
        assert [float(row["sent"]) for row in logged if row["sent"]] == fake.pulses(servo.channel)  # down to 0: off
        assert [float(row["wanted"]) for row in logged if row["frame"]] == wanted[:, column].tolist()
        assert sum(row["event"] == "position" and float(row["position"]) > 0 for row in logged) > 50
    assert (np.diff([float(row["time"]) for row in rows]) >= 0).all()


@pytest.mark.parametrize(("loop", "duration", "n_frames"), [(False, 1.0, 50), (True, 10.0, 500), (False, 99.0, 201)])
def test_duration_and_loop(calibration, wanted, clock, loop, duration, n_frames):
    log = Memory()
    Player(DryRunController(), calibration.servos, log, StopRequest(), clock=clock).follow(
        frames_of(wanted, loop=loop, duration=duration)
    )
    played = [entry for entry in log.entries if entry.channel == 3 and entry.frame is not None]
    assert [entry.frame for entry in played] == list(range(n_frames))
    asked = np.array([entry.wanted for entry in played])
    np.testing.assert_array_equal(asked, wanted[np.arange(n_frames) % N_FRAMES, 1])
    np.testing.assert_allclose([entry.sent for entry in played], asked, rtol=0, atol=0.125 + 1e-9)


def test_unplugged_at_random_bytes(plug, calibration, wanted, clock):
    rng = np.random.default_rng(8)
    whole = plug()
    player_of(whole, calibration, clock).follow(frames_of(wanted))
    whole.finish()
    for n_bytes in rng.integers(1, whole.n_bytes, 20):
        fake = plug(unplug_after=int(n_bytes))
        player = player_of(fake, calibration, clock)
        with pytest.raises((PortLostError, ControllerError), match=fake.path):
            player.follow(frames_of(wanted))
        player.controller.close()
        fake.finish()
        check_what_it_was_sent(fake, calibration)
        # The log holds every pulse that reached the controller; the rest was lost on the line.
        for servo in calibration.servos:
            received = fake.pulses(servo.channel)
            assert player.log.sent(servo.channel)[: len(received)] == received
        if fake.targets:
            assert "NOT SWITCHED OFF" in player.outcome
            assert any("NOT SWITCHED OFF" in entry.event for entry in player.log.entries)


@pytest.mark.parametrize("seed", range(5))
def test_invalid_answers_return_to_neutral(plug, calibration, wanted, clock, seed):
    rng = np.random.default_rng(seed)
    fake, n_honest = plug(), int(rng.integers(2, 180))

    def garbage(answer: bytes) -> bytes:
        nonlocal n_honest
        n_honest -= 1
        return answer if n_honest > 0 else rng.bytes(int(rng.integers(6)))

    fake.answer = garbage
    player = player_of(fake, calibration, clock)
    player.controller._port.timeout = 0.1  # for reading: short answers are common here
    with pytest.raises(ControllerError):
        player.follow(frames_of(wanted))
    fake.finish()
    if fake.targets:
        check_neutral_and_off(fake, calibration)


class Full(Memory):
    def add(self, *entries: LogEntry) -> None:
        if len(self.entries) > 300:
            raise OSError(28, "No space left on device")
        super().add(*entries)


def raise_defect() -> None:
    raise RuntimeError("a defect")


@pytest.mark.parametrize(
    ("cause", "error", "said"),
    [
        (lambda fake, clock: setattr(fake, "errors", 1 << 2), ControllerError, "serial buffer full"),
        (lambda fake, clock: raise_defect(), RuntimeError, "a defect"),
        (lambda fake, clock: clock.sleep(2 * MAX_LATENESS), PuddleError, r"0\.\d\d s late, expected at most 0\.25 s"),
        (None, OSError, "No space left"),
    ],
)
def test_a_failure_returns_to_neutral(plug, calibration, wanted, clock, cause, error, said):
    fake = plug()
    player = player_of(fake, calibration, clock, log=None if cause else Full())
    if cause:
        player.show = lambda time, *_: cause(fake, clock) if time > 2 else clock.sleep(0.001)
    with pytest.raises(error, match=said):
        player.follow(frames_of(wanted))
    fake.finish()
    check_neutral_and_off(fake, calibration)
    if cause:
        assert any(entry.event.startswith(error.__name__) for entry in player.log.entries)
        assert [(entry.channel, entry.sent) for entry in player.log.entries if entry.sent is not None] == fake.targets


@pytest.mark.parametrize(
    ("limits", "said", "outcome"),
    [
        ((1450, 1550), r"to channel \d, it puts out 1[45]50 µs.*limits beyond", "switched off at neutral"),
        ((1600, 1700), "puts out 1600 µs", "switched off at an unknown position: "),  # neutral was sent
    ],
)
def test_limits_of_the_controller_narrower_than_the_calibration(
    plug, calibration, wanted, clock, limits, said, outcome
):
    fake = plug()
    fake.channel_range = tuple(4 * limit for limit in limits)
    player = player_of(fake, calibration, clock)
    with pytest.raises(ControllerError, match=said):
        player.follow(frames_of(wanted))
    fake.finish()
    check_neutral_and_off(fake, calibration)
    assert player.outcome.startswith(outcome)


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_return_to_neutral(plug, calibration, wanted, clock, kind):
    fake = plug()
    with stopped_by_signals() as stop:
        player = player_of(fake, calibration, clock, stop=stop)
        player.show = lambda time, *_: os.kill(os.getpid(), kind) if time == 1.5 else None
        assert player.follow(frames_of(wanted)) == "stopped by the user"
    fake.finish()
    check_neutral_and_off(fake, calibration)
    away = abs(wanted[75, 0] - 1500.0)
    assert away > 100  # mid-swing, so the return takes several frames
    back = fake.pulses(0)[50 + 76 : -1]
    assert np.abs(np.diff(back)).max() <= 0.5 * 1800 * 0.02 + 0.25  # at half of its speed


def test_a_second_signal_switches_off_at_once(plug, calibration, wanted, clock):
    fake, stop = plug(), StopRequest()

    class Impatient(type(clock)):
        def sleep(self, duration: float) -> None:
            super().sleep(duration)
            stop.count += self.time > 102.5  # once during the run and again during the return

    player = player_of(fake, calibration, Impatient(), stop=stop)
    player.follow(frames_of(wanted))
    fake.finish()
    check_what_it_was_sent(fake, calibration)
    assert not fake.on and abs(fake.pulses(0)[-2] - 1500.0) > 100
    angles = [np.degrees(servo.angle(fake.pulses(servo.channel)[-2])) for servo in calibration.servos]
    assert player.outcome == (
        f"switched off away from neutral, last sent to: joint 2 (channel 0) {angles[0]:+.0f}°, "
        f"joint 4 (channel 3) {angles[1]:+.0f}°"
    )
    assert player.log.entries[-1].event == f"servos: {player.outcome}"


def test_every_entry_is_in_the_file_at_once(tmp_path):
    """So that a process that is killed leaves its record."""
    with ServoLog(tmp_path / "run.csv") as log:
        for number in range(3):
            log.add(LogEntry(number / 50, frame=number, channel=0, sent=1500.0))
            assert len((tmp_path / "run.csv").read_text().splitlines()) == 2 + number
