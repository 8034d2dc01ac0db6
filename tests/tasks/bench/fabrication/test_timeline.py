"""Timelines against closed forms, and their limits."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.bench.fabrication.calibration import Calibration, ServoCalibration
from tasks.bench.fabrication.timeline import Timeline, TimelineError, envelope, pulses, timeline_of
from tasks.design import random_designs

SERVO = {"joint": 1, "channel": 0, "centre_us": 1500.0, "direction": 1, "us_per_rad": 600.0}
SERVO |= {"min_us": 900.0, "max_us": 2100.0, "max_speed": 6.0}


def servo(**changes) -> ServoCalibration:
    return ServoCalibration(**{**SERVO, **changes})


def design(**genes):
    robot = random_designs(1, np.random.default_rng(0))
    on = np.array([[False, True, False, True, False, False]])
    return replace(robot, motor_on=on, **{name: np.asarray(value, dtype=float) for name, value in genes.items()})


def test_the_timeline_is_the_simulated_controller_in_bench_time():
    phase = [[0.0, 0.5, 0.0, 2.0, 0.0, 0.0]]
    amplitude = [[0.0, 0.4, 0.2, 1.2, 0.2, 0.2]]
    robot = design(frequency=[0.25], phase=phase, motion_range=amplitude)
    made = timeline_of(robot, time_scale=0.5, duration=40.0, ramp=3.0)
    assert made.joints == (1, 3) and made.angle.shape == (2001, 2)
    steady = (made.time >= 3.0) & (made.time <= 37.0)
    # A quarter of a turn a second in simulation is half a turn a second on the bench.
    for column, joint in enumerate(made.joints):
        expected = amplitude[0][joint] * np.sin(2 * np.pi * 0.5 * made.time + phase[0][joint])
        np.testing.assert_allclose(made.angle[steady, column], expected[steady], rtol=0, atol=1e-12)
        assert (np.abs(made.angle[:, column]) <= np.abs(expected) + 1e-12).all()
    assert (made.angle[[0, -1]] == 0).all()


@given(duration=st.floats(0.1, 300.0), ramp=st.floats(0.01, 60.0))
def test_an_envelope_rises_and_falls_without_a_jump(duration: float, ramp: float):
    time = np.linspace(0, duration, 4001)
    e = envelope(time, duration=duration, ramp=ramp)
    assert e[0] == 0 and abs(e[-1]) < 1e-12 and e.min() >= 0 and e.max() <= 1 + 1e-12
    assert e[2000] == pytest.approx(1.0)
    # 6 s^5 - 15 s^4 + 10 s^3 is steepest at s = 1/2, by 15/8; its second derivative is 10/sqrt(3) at most.
    dt, rise = time[1], min(ramp, duration / 2)
    assert np.abs(np.diff(e)).max() <= 15 / 8 * dt / rise + 1e-12
    assert np.abs(np.diff(e, 2)).max() <= 10 / np.sqrt(3) * (dt / rise) ** 2 + 1e-12


def test_pulses_are_linear_in_the_angle():
    angle = np.linspace(-0.9, 0.9, 1001)[:, None]
    line = Timeline(joints=(1,), angle=angle)
    both = Calibration(servos=(servo(), servo(channel=4, direction=-1, centre_us=1520.0)))
    sent = pulses(line, both)
    np.testing.assert_allclose(sent[:, 0], 1500 + 600 * angle[:, 0])
    np.testing.assert_allclose(sent[:, 1], 1520 - 600 * angle[:, 0])
    for column, calibrated in enumerate(both.servos):
        assert calibrated.angle(sent[7, column]) == pytest.approx(angle[7, 0])


def test_a_timeline_beyond_a_limit_is_refused_with_joint_time_and_limit():
    rising = Timeline(joints=(1,), angle=np.linspace(0.0, 1.2, 101)[:, None])
    with pytest.raises(TimelineError, match=r"joint 1 \(channel 0\) at 1\.68 s: .* 2105 µs.*900 to 2100 µs; .*68\.8°"):
        pulses(rising, Calibration(servos=(servo(),)))  # 600 · 0.012 · 84 is the first above 600
    with pytest.raises(TimelineError, match=r"2\.50 rad/s, expected at most 2"):
        pulses(Timeline((1,), np.array([[0.0], [0.05]])), Calibration(servos=(servo(max_speed=2.0),)))
    with pytest.raises(TimelineError, match="for joints 1, 3, the calibration has them for 1"):
        pulses(Timeline((1, 3), np.zeros((5, 2))), Calibration(servos=(servo(),)))


def test_a_controller_that_senses_is_refused_by_what_servos_lack():
    robot = random_designs(1, np.random.default_rng(0), controller="reflex")
    with pytest.raises(TimelineError, match="reflex needs angle, speed, tilt, spin, wet, contact, which serv"):
        timeline_of(replace(robot, motor_on=np.ones((1, 6), bool)), time_scale=1.0)
