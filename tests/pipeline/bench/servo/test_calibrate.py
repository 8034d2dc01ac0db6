"""``puddle servo calibrate`` and ``off`` against a simulated controller."""

import os
from collections.abc import Iterator
from itertools import pairwise
from math import radians
from pathlib import Path

import pytest
from command_line import call, refused

from pipeline.bench.fabrication.kit_files import calibration_yaml
from pipeline.bench.servo import play
from pipeline.bench.servo.calibrate import calibrate
from pipeline.commands.servo import TypedLines
from pipeline.config.loading import load
from pipeline.errors import PuddleError
from tasks.bench.fabrication.calibration import Calibration, ServoCalibration

FRAMES_PER_LINE = 20  # that the user takes to type a line


@pytest.fixture
def kit(tmp_path, calibration) -> Path:
    (tmp_path / "kit").mkdir()
    (tmp_path / "kit" / "calibration.yaml").write_bytes(calibration_yaml(calibration, "of a test"))
    return tmp_path / "kit"


class User:
    """A user who types lines, slowly, and answers questions."""

    def __init__(self, typed: str, *answers: bool) -> None:
        self.lines: list[str] = []
        self.questions: list[str] = []
        self._typed: Iterator[str] = iter(typed.split("|"))
        self._answers = iter(answers)
        self._n_asked = 0

    def read(self) -> str | None:
        self._n_asked += 1
        if self._n_asked % FRAMES_PER_LINE:
            return None
        line = next(self._typed, None)
        if line is None:
            raise EOFError
        return line

    def confirm(self, question: str) -> bool:
        self.questions.append(question)
        return next(self._answers)

    def on_the_terminal(self) -> play.User:
        return play.User(self.confirm, self.lines.append, self.read)


JOINT_2 = "+40|-2.5||100|100|100|20||abc|30|-100|-100|-100|-100|-100|-100|-90||" + 14 * "100|"
"""Rest at 1537.5 µs; 320 µs more turn it by 30°; 590 µs less and 810 µs more are the limits."""


def measured(kit: Path, user: User, clock, port=None, joints=()) -> bool:
    connection = play.Connection(port, timeout=10.0, dry_run=port is None)
    return calibrate(kit, connection, user.on_the_terminal(), joints=joints, clock=clock)


def test_a_servo_is_measured_and_the_previous_calibration_stays(kit, plug, clock, calibration):
    fake, user = plug(), User(JOINT_2, True, True)
    before = (kit / "calibration.yaml").read_bytes()
    assert measured(kit, user, clock, port=fake.path, joints=(2,)), user.lines
    fake.finish()
    other = calibration.servos[1]
    expected = {"centre_us": 1537.5, "us_per_rad": round(320 / radians(30), 3), "direction": 1}
    expected |= {"joint": 2, "channel": 0, "min_us": 1167.5, "max_us": 2467.5, "max_speed": 3.0}
    assert load(Calibration, kit / "calibration.yaml") == Calibration(servos=(ServoCalibration(**expected), other))
    assert (kit / "calibration-1.yaml").read_bytes() == before
    assert user.questions[0] == "Move the servos?" and "stays as calibration-1.yaml" in user.questions[1]
    said = "\n".join(user.lines)
    assert "Expected a number, got 'abc'" in said and "Servos: switched off at neutral" in said
    assert not fake.on and {channel for channel, _ in fake.targets} == {0}  # no other servo was moved
    pulses = fake.pulses(0)[:-1]
    assert pulses[0] == 1500.0 and max(pulses) == 2467.5 and min(pulses) == 1167.5
    # 0.5 rad/s at 600 µs/rad is 6 µs a frame.
    assert max(abs(b - a) for a, b in pairwise(pulses)) <= 6.0
    assert len(pulses) > FRAMES_PER_LINE * JOINT_2.count("|")  # it was held while the user typed


def test_values_that_cannot_be_true_are_asked_again(kit, clock):
    typed = (
        "200|nan||"  # a step that is too long; then rest, at 1500 µs
        "10||30|"  # too small a turn
        "90||0.5|"  # too small an angle
        "|6000|"  # degrees? 100 µs are then 1 µs/rad
        "|-10|"  # against the pulse
        "|-100|-50||"  # the shortest pulse can't be longer than that at rest
        "|100|100||"
    )
    user = User(typed, True)
    assert measured(kit, user, clock, joints=(2,)), user.lines
    said = "\n".join(user.lines)
    for problem in (
        "at most 100 µs, got 200",
        "got 'nan'",
        "at least 50 µs and 5°, got 10 µs and 30°",
        "got 100 µs and 0.5°",
        "got 1. Is the angle in degrees?",
        "less than the pulse at rest, 1500 µs, got 1600",
        "more than the pulse at rest, 1500 µs, got 1450",
    ):
        assert problem in said, problem
    (servo, _) = load(Calibration, kit / "calibration.yaml").servos
    assert (servo.min_us, servo.centre_us, servo.max_us, servo.direction) == (1450.0, 1500.0, 1650.0, -1)


@pytest.mark.parametrize(("typed", "rest"), [("+40|", 1500.0), ("+40||100|", 1540.0)])
def test_an_input_that_ends_leaves_the_calibration_and_the_servos_off(kit, plug, clock, calibration, typed, rest):
    """At what was at rest before, which may be beyond what the servo touches, only until the rest is measured."""
    fake = plug()
    with pytest.raises(PuddleError, match=r"the input ended.*\n?.*Servos: switched off at neutral"):
        measured(kit, User(typed.rstrip("|"), True), clock, port=fake.path)
    fake.finish()
    assert not fake.on and fake.pulses(0)[-2:] == [rest, 0.0]
    assert load(Calibration, kit / "calibration.yaml") == calibration


def test_no_servo_moves_without_being_announced(kit, plug, clock, calibration):
    fake, user = plug(), User(JOINT_2, True, False)
    assert not measured(kit, user, clock, port=fake.path)
    fake.finish()
    assert user.questions == [
        "Move the servos?",
        f"Move the servo of joint 4 on channel {calibration.servos[1].channel}?",
    ]
    assert {channel for channel, _ in fake.targets} == {0}
    assert load(Calibration, kit / "calibration.yaml") == calibration


def test_mistakes_of_calibrate_and_off(kit, tmp_path, capsys):
    assert "for joints 2, 4, got 3" in refused(capsys, "servo", "calibrate", str(kit), "--dry-run", "--joint", "3")
    for command in ("calibrate", "off"):
        for arguments, said in (
            ((), "{kit}"),
            ((str(kit),), "--port: expected"),
            ((str(tmp_path / "none.yaml"), "--dry-run"), "none.yaml: expected a settings file"),
        ):
            assert said in refused(capsys, "servo", command, *arguments)


def test_servos_are_switched_off(kit, plug, capsys):
    fake = plug()
    fake.on = {0: 1600.0, 3: 1400.0, 5: 1500.0}
    fake.errors = 1 << 5  # a time-out since the last run
    assert call("servo", "off", str(kit), "--port", fake.path, "--timeout", "10") == 0
    assert capsys.readouterr().out == "Servos on channels 0, 3: switched off.\n"
    fake.finish()
    assert set(fake.on) == {5} and fake.targets == [(0, 0.0), (3, 0.0)]


def test_typed_lines_do_not_wait():
    end, typed = os.pipe()
    lines = TypedLines(end)
    assert lines() is None
    os.write(typed, b"+2")
    assert lines() is None
    os.write(typed, b"0\n\nx\n")
    assert [lines(), lines(), lines(), lines()] == ["+20", "", "x", None]
    os.close(typed)
    with pytest.raises(EOFError):
        lines()
    os.close(end)
