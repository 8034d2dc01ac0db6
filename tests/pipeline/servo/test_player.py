"""The player on a simulated Maestro: it keeps the limits and ends at neutral and off, whatever fails."""

import os
import signal

import numpy as np
import pytest

from pipeline.servo.limits import LONGEST_STEP
from pipeline.servo.log import JOURNAL, LogEntry, ServoLog
from pipeline.servo.maestro import open_maestro
from pipeline.servo.player import MAX_LATENESS, LateHostError, Player, StopRequest, frames_of, stopped_by_signals
from pipeline.servo.servo_controller import ControllerError, DryRunController, PortLostError
from pipeline.store.encoding import decode_table
from tasks.fabrication.timeline import Playback, Timeline, envelope, pulses

N_FRAMES = 201


@pytest.fixture(scope="module")
def wanted(calibration):
    """Four seconds of a 40° swing at 0.5 Hz. Its speed, 0.7 · π plus ramps, is below 3 rad/s."""
    playback, time = Playback(duration=4.0, ramp=1.0), np.arange(N_FRAMES) / 50
    rise = envelope(time, duration=playback.duration, ramp=playback.ramp)
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
    controller = open_maestro(fake.path, baud=115200, baud_detection=False, timeout=10.0)
    return Player(controller, calibration.servos, log or Memory(), stop or StopRequest(), clock=clock)


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
    assert not fake.on
    for servo in calibration.servos:
        *_, last, off = fake.pulses(servo.channel)
        assert off == 0 and last == servo.centre_us


def test_a_timeline_from_rest_to_rest(plug, calibration, wanted, clock):
    fake = plug()
    player = player_of(fake, calibration, clock)
    assert player.follow(frames_of(wanted)) == "the timeline ended"
    fake.finish()
    check_what_it_was_sent(fake, calibration)
    check_neutral_and_off(fake, calibration)
    assert fake.errors == 0 and player.worst_lateness == 0 and player.outcome == "switched off at neutral"
    for column, servo in enumerate(calibration.servos):
        sent = np.array(fake.pulses(servo.channel)[50 : 50 + N_FRAMES])  # after a second at neutral
        np.testing.assert_allclose(sent, wanted[:, column], rtol=0, atol=0.125 + 1e-9)
        # The controller limits the rate less than the host, so it never lags behind.
        assert fake.speeds[servo.channel] * 25.0 >= servo.max_rate_us
        assert player.log.sent(servo.channel) == fake.pulses(servo.channel)  # down to 0, which is off


@pytest.mark.parametrize(("loop", "duration", "n_frames"), [(False, 1.0, 50), (True, 10.0, 500), (False, 99.0, 201)])
def test_duration_and_loop(calibration, wanted, clock, loop, duration, n_frames):
    log = Memory()
    Player(DryRunController(), calibration.servos, log, StopRequest(), clock=clock).follow(
        frames_of(wanted, loop=loop, duration=duration)
    )
    frames = [entry.frame for entry in log.entries if entry.channel == 0 and entry.frame >= 0]
    assert frames == list(range(n_frames))
    played = [entry for entry in log.entries if entry.channel == 3 and entry.frame >= 0]
    asked = np.array([entry.wanted for entry in played])
    np.testing.assert_array_equal(asked, wanted[np.arange(n_frames) % N_FRAMES, 1])
    np.testing.assert_allclose([entry.sent for entry in played], asked, rtol=0, atol=0.125 + 1e-9)


def test_unplugged_at_100_random_bytes(plug, calibration, wanted, clock):
    rng = np.random.default_rng(8)
    whole = plug()
    player_of(whole, calibration, clock).follow(frames_of(wanted))
    whole.finish()
    for n_bytes in rng.integers(1, whole.n_bytes, 100):
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


@pytest.mark.parametrize("seed", range(20))
def test_invalid_answers_return_to_neutral(plug, calibration, wanted, clock, seed):
    rng = np.random.default_rng(seed)
    fake, n_honest = plug(), int(rng.integers(2, 180))
    honest = fake.answer

    def garbage(answer: bytes) -> bytes:
        nonlocal n_honest
        n_honest -= 1
        return honest(answer) if n_honest > 0 else rng.bytes(int(rng.integers(6)))

    fake.answer = garbage
    player = player_of(fake, calibration, clock)
    player.controller._port.timeout = 0.1  # for reading: short answers are common here
    with pytest.raises(ControllerError):
        player.follow(frames_of(wanted))
    fake.finish()
    check_what_it_was_sent(fake, calibration)
    if fake.targets:
        check_neutral_and_off(fake, calibration)
        # After "home", the only commands are "off" and questions.
        home = [command for command, *_ in fake.commands].index(0xA2)
        assert all(command == 0x90 or data[1:] == [0, 0] for command, *data in fake.commands[home + 1 :])


def test_an_error_reported_by_the_controller(plug, calibration, wanted, clock):
    fake = plug()
    player = player_of(fake, calibration, clock)
    player.show = lambda state: setattr(fake, "errors", 1 << 2 if state.time > 2 else 0)
    with pytest.raises(ControllerError, match="serial buffer full"):
        player.follow(frames_of(wanted))
    fake.finish()
    check_what_it_was_sent(fake, calibration)
    check_neutral_and_off(fake, calibration)
    assert any("serial buffer full" in entry.event for entry in player.log.entries)


def test_controller_limits_narrower_than_the_calibration(plug, calibration, wanted, clock):
    fake = plug()
    fake.channel_range = (4 * 1450, 4 * 1550)
    with pytest.raises(ControllerError, match=r"to channel \d, it puts out 1[45]50 µs.*limits beyond"):
        player_of(fake, calibration, clock).follow(frames_of(wanted))
    fake.finish()
    check_neutral_and_off(fake, calibration)


def test_any_exception_returns_to_neutral(plug, calibration, wanted, clock):
    fake = plug()
    player = player_of(fake, calibration, clock)

    def show(state) -> None:
        if state.time > 1.5:
            raise RuntimeError("a defect")

    player.show = show
    with pytest.raises(RuntimeError, match="a defect"):
        player.follow(frames_of(wanted))
    fake.finish()
    check_what_it_was_sent(fake, calibration)
    check_neutral_and_off(fake, calibration)


def test_a_late_host(plug, calibration, wanted, clock):
    fake = plug()
    player = player_of(fake, calibration, clock)

    def show(state) -> None:
        clock.time += 0.01  # slightly late, which the next frame makes up for
        if state.time > 2:
            clock.time += 2 * MAX_LATENESS  # the lid was closed

    player.show = show
    with pytest.raises(LateHostError, match=r"0\.\d\d s late, expected at most 0\.25 s"):
        player.follow(frames_of(wanted))
    fake.finish()
    check_what_it_was_sent(fake, calibration)
    check_neutral_and_off(fake, calibration)
    lateness = [entry.lateness for entry in player.log.entries if entry.lateness is not None]
    assert max(lateness) < MAX_LATENESS < player.worst_lateness


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_return_to_neutral(plug, calibration, wanted, clock, kind):
    fake = plug()
    with stopped_by_signals() as stop:
        player = player_of(fake, calibration, clock, stop=stop)
        player.show = lambda state: os.kill(os.getpid(), kind) if state.time == 1.5 else None
        assert player.follow(frames_of(wanted)) == "stopped by the user"
    fake.finish()
    check_what_it_was_sent(fake, calibration)
    check_neutral_and_off(fake, calibration)
    away = abs(wanted[75, 0] - 1500.0)
    assert away > 100  # mid-swing, so the return takes several frames
    back = fake.pulses(0)[50 + 76 :]
    assert len(back) > away / (0.5 * 1800 * 0.02)


def test_a_second_signal_switches_off_at_once(plug, calibration, wanted):
    fake, stop = plug(), StopRequest()

    class Impatient:
        time = 0.0

        def now(self) -> float:
            return self.time

        def sleep(self, duration: float) -> None:
            self.time += duration
            stop.count += self.time > 2.5  # once during the run and again during the return

    player = player_of(fake, calibration, Impatient(), stop=stop)
    player.follow(frames_of(wanted))
    fake.finish()
    check_what_it_was_sent(fake, calibration)
    assert not fake.on and fake.pulses(0)[-1] == 0
    assert abs(fake.pulses(0)[-2] - 1500.0) > 100
    angles = [np.degrees(servo.angle(fake.pulses(servo.channel)[-2])) for servo in calibration.servos]
    assert player.outcome == (
        f"switched off away from neutral, last sent to: joint 2 (channel 0) {angles[0]:+.0f}°, "
        f"joint 4 (channel 3) {angles[1]:+.0f}°"
    )
    assert player.log.entries[-1].event == f"servos: {player.outcome}"


def test_controller_limits_that_exclude_neutral(plug, calibration, wanted, clock):
    fake = plug()
    fake.channel_range = (4 * 1600, 4 * 1700)
    player = player_of(fake, calibration, clock)
    with pytest.raises(ControllerError, match="puts out 1600 µs"):
        player.follow(frames_of(wanted))
    fake.finish()
    check_neutral_and_off(fake, calibration)  # these are the pulses sent, not those put out
    assert player.outcome.startswith("switched off at an unknown position: ")
    assert "controller does not confirm" in player.outcome


def test_a_failed_return_is_not_reported_as_neutral(calibration, wanted, clock):
    class Blocked(DryRunController):
        """Accepts no bytes on the way back to neutral, then works again."""

        n_sent = 0

        def send(self, pulses_us) -> None:
            self.n_sent += 1
            if self.n_sent > 120:
                raise PortLostError("blocked")

    player = Player(Blocked(), calibration.servos, Memory(), StopRequest(), clock=clock)
    with pytest.raises(PortLostError, match="blocked"):
        player.follow(frames_of(wanted))
    assert "switched off away from neutral" in player.outcome


def test_a_full_disk_stops_the_robot_safely(plug, calibration, wanted, clock):
    fake = plug()

    class Full(Memory):
        def add(self, *entries: LogEntry) -> None:
            if len(self.entries) > 300:
                raise OSError(28, "No space left on device")
            super().add(*entries)

    with pytest.raises(OSError, match="No space left"):
        player_of(fake, calibration, clock, log=Full()).follow(frames_of(wanted))
    fake.finish()
    check_what_it_was_sent(fake, calibration)
    check_neutral_and_off(fake, calibration)


def test_a_log_is_a_table_of_what_was_sent(plug, calibration, wanted, clock, tmp_path):
    fake, log = plug(), ServoLog(tmp_path / "run.parquet", print)
    player_of(fake, calibration, clock, log=log).follow(frames_of(wanted))
    fake.finish()
    assert (tmp_path / f"run.parquet{JOURNAL}").exists()
    log.close()
    assert [path.name for path in tmp_path.iterdir()] == ["run.parquet"]
    table = decode_table(log.path.read_bytes(), schema="servo_log", version=1, source="log")
    assert table["sent"][table["event"] == "off"].tolist() == [0.0, 0.0]
    played = (table["channel"] == 3) & (table["frame"] >= 0)
    np.testing.assert_array_equal(table["wanted"][played], wanted[:, 1])
    assert (np.diff(table["time"]) >= 0).all()
    read = table["event"] == "position"
    assert read.sum() > 100 and np.isfinite(table["position"][read]).all()


def test_every_command_to_the_controller_has_its_row(plug, calibration, wanted, clock):
    fake = plug()
    player = player_of(fake, calibration, clock)
    player.show = lambda state: setattr(fake, "errors", 1 << 2 if state.time > 2 else 0)  # leads to "home"
    with pytest.raises(ControllerError, match="serial buffer full"):
        player.follow(frames_of(wanted))
    fake.finish()
    rows = player.log.entries
    targets = [(row.channel, row.sent) for row in rows if row.sent is not None]
    assert targets == fake.targets
    assert [(row.event, row.channel) for row in rows[:2]] == [("at most 1800 µs/s", 0), ("at most 1800 µs/s", 3)]
    assert [row.event for row in rows].count("home") == [command for command, *_ in fake.commands].count(0xA2) == 1
    asked = [channel for command, channel, *_ in (c for c in fake.commands if c[0] == 0x90)]
    assert [row.channel for row in rows if row.event == "position"] == asked
    off = [row for row in rows if row.sent == 0]
    assert [(row.event, row.channel, row.frame) for row in off] == [("off", 0, -1), ("off", 3, -1)]
