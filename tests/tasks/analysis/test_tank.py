"""The tank: crossings of robots whose way is known beforehand, and the champion that is nearest the mean."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.analysis.tank import Crossings, Tank, TankTrials, count_crossings, crossings, nearest_the_mean, restarted
from tasks.bench.fabrication.scaling import Scaling, scales_of
from tasks.bench.fabrication.servos import KG_CM
from tasks.design import random_designs
from tasks.simulation import OK, Rollouts

DT, N_SETTLE = 0.1, 3
TANK = Tank(length=2.0, depth=0.2, scale=0.1, seconds=40.0 * np.sqrt(0.1))  # 20 m by 2 m and 400 steps to it
SQUARE = replace(random_designs(1, np.random.default_rng(71)), length_scale=np.ones((1, 6)))  # links of 1 m by 1 m


def gliding(speed, apart):
    """(1, n_steps, 6) places of links in a row, `apart` from each other, let go at the settled state's time."""
    time = (np.arange(N_SETTLE + 400) - (N_SETTLE - 1)) * DT
    return (speed * time[:, None] + apart * np.arange(6))[None]


def cross(x, *, design=SQUARE, angle=0.0, tank=TANK):
    """Cross with links at (1, n_steps, 6) places along the tank."""
    trace = np.zeros((*x.shape, 6), dtype=np.float32)
    trace[..., 0], trace[..., 2] = x, angle
    rolled = Rollouts(np.zeros(1), np.zeros(1), np.zeros(1), np.full(1, OK), trace)
    found = crossings(design, rolled, tank, n_settle=N_SETTLE)
    return Crossings(*(values[0] for values in found))


def test_the_paper_s_tank_is_this_large_to_the_robot_by_froude_s_law():
    """v² / (g L) is the same in both: a robot that goes its own length in a second does so in √0.07 s as built."""
    tank = Tank()
    assert (tank.simulated_length, tank.simulated_depth) == pytest.approx((16.714, 2.143), abs=1e-3)
    assert tank.n_steps(1 / 60) == round(60 * 150 / np.sqrt(0.07)) == 34017


def test_a_robot_has_crossed_when_its_front_has_come_to_the_end():
    found = cross(gliding(speed=0.5, apart=1.0))  # 6 m long: 5 m between centres, half a link at each end
    assert found.length == pytest.approx(6.0) and found.crossed
    assert found.travelled == pytest.approx(14, abs=0.5 * DT)


REACHING = gliding(speed=0.0, apart=1.0)  # a front far beyond the end, of a robot whose centre of mass has moved 5 m
REACHING[0, N_SETTLE + 100 :, 5] += 30


@pytest.mark.parametrize(
    ("x", "travelled"),
    [(gliding(0.3, 1.0), 0.3 * 40), (gliding(-1.0, 1.0), -40.0), (REACHING, 5.0), (gliding(1.0, 4.0), 40.0)],
    ids=["too slow", "backwards", "reaching ahead", "as long as the tank"],
)
def test_who_has_not_crossed(x, travelled):
    found = cross(x)
    assert not found.crossed and found.travelled == pytest.approx(travelled)


@pytest.mark.parametrize(("angle", "length"), [(np.pi / 2, 2.0), (0.0, 0.5), (np.pi / 4, 2.5 / np.sqrt(2))])
def test_length_is_from_corner_to_corner(angle, length):
    found = cross(gliding(0.0, apart=0.0), design=replace(SQUARE, length_scale=np.full((1, 6), 2.0)), angle=angle)
    assert found.length == pytest.approx(length)


@pytest.mark.parametrize(("width", "crossed"), [(0.33, True), (0.32, False)])
def test_a_robot_that_is_wider_than_the_tank_does_not_cross(width, crossed):
    """Pontoons of 25 mm, 300 mm from one to the other, are 325 mm wide."""
    assert cross(gliding(0.5, 1.0), tank=TANK.model_copy(update={"width": width})).crossed == crossed


def test_who_diverges_has_not_crossed():
    x = gliding(0.5, 1.0)
    x[0, N_SETTLE + 7 :] = np.nan
    assert not cross(x).crossed and np.isnan(cross(x).travelled)


def test_a_tank_holds_its_filling():
    with pytest.raises(ValueError, match=r"depth is 0\.3 m and height 0\.27 m.*expected a height of at least"):
        Tank(depth=0.3)
    assert Tank(depth=0.3, height=0.3).simulated_depth == pytest.approx(0.3 / 0.07)


@pytest.mark.parametrize("law", ["froude", "kept_frequencies"])
@pytest.mark.parametrize("link_density", [1.0, 2.0])
def test_a_servo_s_torque_at_scale_is_that_of_the_kit(law, link_density):
    """Six links of 1 m² are 2 × 25 mm thick and 29 400 mm² large as built: 1.47 l, and at 800 kg/m³ 1.176 kg."""
    tank = Tank()
    scales = scales_of(Scaling(law=law), length=0.07, mass_kg=1.176, simulated_mass_kg=6 * link_density)
    assert tank.simulated_servo_torque(link_density) * scales.torque == pytest.approx(tank.servo_torque)
    assert tank.simulated_servo_torque(1.0) == pytest.approx(142.9, abs=0.1)
    assert tank.servo_torque == pytest.approx(20 * KG_CM, abs=0.002)


@pytest.mark.parametrize(
    ("scores", "chosen"), [([1.0, 2.0, 9.0], 1), ([3.0, 5.0], 0), ([np.nan, 7.0, np.nan], 1), ([np.nan, np.nan], None)]
)
def test_the_champion_to_build_is_the_nearest_the_mean(scores, chosen):
    assert nearest_the_mean(np.array(scores)) == chosen


def test_further_trials_begin_at_other_moments_of_the_same_gait():
    """Joints keep their phases to each other, and lie where printing can't tell them from the first trial's."""
    design = random_designs(1, np.random.default_rng(4))
    tries = restarted(design, 5, np.random.default_rng(9))
    assert (tries.table[0] == design.table[0]).all() and len(tries) == 5
    shift = np.angle(np.exp(1j * (tries.phase - design.phase)))
    assert np.ptp(np.exp(1j * shift), axis=1) == pytest.approx(np.zeros(5), abs=1e-9)
    assert len(np.unique(shift[:, 0].round(6))) == 5
    for name in ("parent_attachment", "child_attachment"):
        moved = np.abs(getattr(tries, name) - getattr(design, name))
        assert (moved[0] == 0).all() and (moved[1:, 1:] > 0).all() and moved.max() < 1.01e-4
    for name in ("parent", "length_scale", "rest_angle", "motion_range", "motor_on", "frequency"):
        assert (getattr(tries, name) == getattr(design, name)).all()


def test_trials_that_cross_and_that_go_nowhere_are_counted():
    travelled = np.array([14.0, 14.0, 14.0, 0.49, -0.49, 0.51, -0.51, np.nan])  # 5 cm are 0.5 m to it
    trials = Crossings(np.full(8, 6.0), travelled, np.arange(8) < 3)
    assert count_crossings(trials, TANK) == TankTrials(n=8, n_crossed=3, n_immobile=2)
