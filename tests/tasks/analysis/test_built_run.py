"""A built robot's run: the part in which its gait is steady, its frequency, and its speed."""

import numpy as np
import pytest

from tasks.analysis.built_run import (
    BuiltRobot,
    RunError,
    compare_with_simulation,
    gait_frequency,
    steady_part,
    steady_speed,
)
from tasks.analysis.estimates import Estimate
from tasks.simulation import simulate
from tasks.world import Physics, TrueSlush, froude_time

TIME = np.arange(0, 12, 1 / 60)
SCALE = 0.07  # bench metres per simulated metre
LOCKED = Physics(passive_joints="locked", link_collisions=True)


def swinging(frequency, envelope=1.0):
    return envelope * np.sin(2 * np.pi * frequency * TIME)


def test_the_simulation_as_a_robot_is_as_simulated(crane):
    """Seen by a camera of 60 frames a second that starts its clock somewhere else."""
    robot = BuiltRobot(
        "crane", crane, SCALE, froude_time(SCALE), TrueSlush(depth=2.0), LOCKED, 200, np.array([0.0, 2.0])
    )
    trace = simulate(crane, robot.environment, n_settle=200, n_measure=1500, trace=True, physics=LOCKED).trace[0, 200:]
    steps = LOCKED.time_step * robot.time_scale * np.arange(1500)
    frame = np.arange(0.0, steps[-1], 1 / 60)
    paths = {
        link: (
            frame + 3.7,
            np.column_stack([np.interp(frame, steps, trace[:, link, i]) for i in range(3)]) * (SCALE, SCALE, 1.0),
        )
        for link in (0, 2, 4)
    }
    found = compare_with_simulation(robot, paths)
    assert found.measured.x == pytest.approx(np.interp(found.measured.time, found.simulated.time, found.simulated.x))
    assert found.measured.frequency == pytest.approx(robot.frequency, rel=0.02)
    assert found.simulated.frequency == pytest.approx(robot.frequency, rel=0.02)
    assert found.prediction == Estimate(1.0, -1.0, 3.0)
    assert [row.run for row in found.rows()] == ["measured", "simulated", "predicted by the kit's ensemble"]
    for lacking in ({0: paths[0]}, {2: paths[2], 4: paths[4]}):
        with pytest.raises(RunError, match="expected tags of link 0, the root, and of a link that moves"):
            compare_with_simulation(robot, lacking)


def test_the_gait_is_steady_where_it_has_its_full_swing():
    """Servos rise from rest between 2 and 4 s and return to it between 9 and 11 s; one is stuck."""
    envelope = np.interp(TIME, (2, 4, 9, 11), (0, 1, 1, 0))
    found = steady_part(TIME, np.column_stack((swinging(1.0, envelope), np.full(len(TIME), 0.3))), 1.0)
    assert TIME[found.start] == pytest.approx(4.0, abs=0.3) and TIME[found.stop - 1] == pytest.approx(9.0, abs=0.3)
    with pytest.raises(RunError, match=r"expected at least two periods, 10\.0 s"):
        steady_part(TIME, swinging(1.0, envelope)[:, None], 5.0)


@pytest.mark.parametrize("frequency", [0.8, 0.83])
def test_the_frequency_of_a_gait_is_measured(frequency):
    noise = 0.05 * np.random.default_rng(0).normal(size=(len(TIME), 2))
    angle = noise + np.column_stack((swinging(frequency), np.full(len(TIME), 0.3)))
    assert gait_frequency(TIME, angle, 0.8) == pytest.approx(frequency, rel=0.005)


@pytest.mark.parametrize("still", [0.0, 1e-8])
def test_a_joint_that_is_locked_has_no_say(still):
    """It has no variance to compare with, or only that of rounding."""
    angle = np.column_stack((swinging(0.8), 0.3 + still * (np.arange(len(TIME)) % 2)))
    assert gait_frequency(TIME, angle, 0.8) == pytest.approx(0.8, rel=0.005)


@pytest.mark.parametrize(("frequency", "swing", "why"), [(1.2, 1.0, r"swing at 1\.20 Hz"), (0.8, 0.0, "do not swing")])
def test_another_gait_or_none_is_not_of_this_kit(frequency, swing, why):
    angle = swing * swinging(frequency)[:, None] + 0.01 * np.random.default_rng(0).normal(size=(len(TIME), 1))
    with pytest.raises(RunError, match=rf"joints {why}, expected a gait of 0\.80 Hz"):
        gait_frequency(TIME, angle, 0.8)


def test_the_swing_of_the_gait_does_not_count_as_speed():
    assert steady_speed(TIME, 0.05 * TIME + 0.02 * swinging(0.5), 2.0) == pytest.approx(0.05, rel=0.01)
