"""A built robot's run: its gait, its start and its identity."""

import numpy as np
import pytest

from tasks.analysis.built_run import (
    BuiltRobot,
    RunError,
    check_frequency,
    compare_with_simulation,
    fit_gait,
    joint_angles,
    speed_prediction,
    start_of_run,
    steady_speed,
)
from tasks.design import rest_pose
from tasks.fabrication.timeline import Playback, timeline_of
from tasks.simulation import simulate
from tasks.world import Physics, TrueSlush, froude_time

TIME = np.arange(0, 6, 1 / 60)
SCALE = 0.07  # bench metres per simulated metre
LOCKED = Physics(passive_joints="locked", link_collisions=True)
STEP = LOCKED.time_step * froude_time(SCALE)  # [s of the bench]
BEGAN = 1.7  # when the servos begin on the clock of the tracks [s]


@pytest.fixture(scope="module")
def robot(crane):
    playback = Playback(duration=10.0)
    line = timeline_of(crane, playback, time_scale=froude_time(SCALE))
    return BuiltRobot(
        name="crane",
        design=crane,
        scale=SCALE,
        time_scale=froude_time(SCALE),
        joints=line.joints,
        commanded_time=line.time,
        commanded=line.angle,
        ramp=playback.ramp,
        environment=TrueSlush(depth=2.0),
        physics=LOCKED,
        n_settle=200,
        predicted=None,
    )


@pytest.fixture(scope="module")
def trace(robot):
    """(n_steps, n_links, 6) states of its simulation."""
    return simulate(robot.design, robot.environment, n_settle=0, n_measure=1900, trace=True, physics=LOCKED).trace[0]


def filmed(trace, links=(0, 2, 4)):
    """What a camera sees of a simulated run at bench scale, 60 times a second."""
    steps = STEP * (1 + np.arange(len(trace)))
    frame = np.arange(0.0, steps[-1], 1 / 60)
    found = {}
    for link in links:
        pose = [np.interp(frame, steps, trace[:, link, i]) for i in range(3)]
        found[link] = (frame + BEGAN, np.column_stack(pose) * (SCALE, SCALE, 1.0))
    return found


def test_lags_are_the_simulations_own(robot, trace):
    """A joint lags behind its command as in the simulation; a servo that is 100 ms late is as much later."""
    n_late = round(0.1 / STEP)
    late = trace.copy()
    turned = late[:-n_late, 4:, 2] - late[:-n_late, :1, 2]
    late[n_late:, 4:, 2] = late[n_late:, :1, 2] + turned
    lags = [
        compare_with_simulation(robot, filmed(run), start=BEGAN).lags / (2 * np.pi * robot.frequency)
        for run in (trace, late)
    ]
    assert robot.joints == (2, 4)
    assert (lags[1] - lags[0])[0] == pytest.approx([0.0, 0.1], abs=0.01)  # [s]
    assert abs((lags[1] - lags[0])[0, 0]) < 0.002 and (lags[0][1] == lags[1][1]).all()


def test_an_unknown_start_is_where_the_joints_lag_as_simulated(robot, trace):
    """The figure of the joints would otherwise show all of them ahead of their simulation."""
    found = compare_with_simulation(robot, filmed(trace), start=None)
    pairs = zip(found.measured.gaits, found.simulated.gaits, strict=True)
    assert np.mean([real.phase - expected.phase for real, expected in pairs]) == pytest.approx(0, abs=np.radians(0.5))
    assert not found.start_known and found.lags.mean(axis=1) == pytest.approx([0, 0], abs=1e-12)


def test_a_gait_is_its_amplitude_and_phase():
    found = fit_gait(TIME, 0.2 + 0.7 * np.sin(2 * np.pi * 0.8 * TIME - 1.1), 0.8)
    assert (found.amplitude, found.phase, found.left) == pytest.approx((0.7, -1.1, 0.0), abs=1e-9)


def test_angles_of_joints_follow_from_any_link_of_a_part(crane):
    """At rest they are 0; link 3 is fixed to link 2, and link 1 to the root."""
    rest = rest_pose(crane)[2][0]
    turned = {0: rest[0] + 0.1 * TIME, 3: rest[3] + 0.3 * TIME, 4: np.full(len(TIME), rest[4] + 4 * np.pi)}
    found = joint_angles(crane, (2, 4), turned)
    wrapped = (found - np.column_stack((0.2 * TIME, -0.1 * TIME)) + np.pi) % (2 * np.pi) - np.pi
    assert wrapped == pytest.approx(np.zeros_like(found), abs=1e-9)
    with pytest.raises(RunError, match="expected link 4 or 5"):
        joint_angles(crane, (2, 4), {0: TIME, 2: TIME})


@pytest.mark.parametrize("reached", [(1.0, 1.0), (0.3, 0.4)])
def test_the_start_of_a_run_is_found_by_its_ramp(crane, reached):
    """Also where weak servos reach less than half of the command: no command at all would be the closest one."""
    line = timeline_of(crane, Playback(duration=10.0), time_scale=np.sqrt(0.07))
    time = TIME + 20.0
    angle = np.column_stack([np.interp(time - 20.713, line.time, of, left=0, right=0) for of in line.angle.T]) * reached
    assert start_of_run(time, angle, line.time, line.angle) == pytest.approx(20.713, abs=0.005)


def test_joints_that_do_not_follow_the_timeline_have_no_start(crane):
    line = timeline_of(crane, Playback(duration=10.0), time_scale=np.sqrt(0.07))
    jammed = np.column_stack((np.full(len(TIME), 0.4), np.where(TIME < 1, 0.0, -0.9)))
    with pytest.raises(RunError, match=r"follow the kit's timeline .* or give --start"):
        start_of_run(TIME, jammed, line.time, line.angle)


@pytest.mark.parametrize(("frequency", "right"), [(0.8, True), (0.83, True), (1.2, False), (0.45, False)])
def test_a_gait_of_another_frequency_is_not_of_this_kit(frequency, right):
    angle = np.sin(2 * np.pi * frequency * TIME)[:, None]
    if right:
        check_frequency(TIME, angle, 0.8)
    else:
        with pytest.raises(RunError, match=r"Hz, expected 0\.80 Hz"):
            check_frequency(TIME, angle, 0.8)


def test_a_joint_that_is_stuck_hides_no_gait_and_joints_that_do_not_swing_have_none():
    noise = 0.01 * np.random.default_rng(0).normal(size=(len(TIME), 2))
    stuck = noise + np.column_stack((np.sin(2 * np.pi * 0.8 * TIME), np.full(len(TIME), 0.3)))
    check_frequency(TIME, stuck, 0.8)
    with pytest.raises(RunError, match=r"joints do not swing, expected a gait of 0\.80 Hz"):
        check_frequency(TIME, noise, 0.8)


def test_the_swing_of_the_gait_does_not_count_as_speed():
    x = 0.05 * TIME + 0.02 * np.sin(2 * np.pi * 0.5 * TIME)
    assert steady_speed(TIME, x, 2.0) == pytest.approx(0.05, rel=0.01)
    with pytest.raises(RunError, match=r"expected at least two periods, 8\.0 s"):
        steady_speed(TIME, x, 4.0)


def test_a_prediction_is_two_deviations_to_either_side():
    assert speed_prediction(np.array([1.0, 3.0])) == (2.0, 0.0, 4.0)
