"""The tank: crossings of robots whose way is known beforehand, and the champion that is nearest the mean."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.analysis.tank import Crossing, Tank, count_crossings, crossings, nearest_the_mean, restarted
from tasks.design import Designs, random_designs
from tasks.fabrication.scaling import Scaling, scales_of
from tasks.fabrication.servos import KG_CM
from tasks.simulation import OK, Rollouts

DT = 0.1
N_SETTLE = 3
TANK = Tank(length=2.0, depth=0.2, scale=0.1, seconds=40.0 * np.sqrt(0.1))  # 20 m by 2 m and 400 steps to it


def upright(n_designs: int) -> Designs:
    """Robots whose links are all 1 m by 1 m."""
    designs = random_designs(n_designs, np.random.default_rng(71))
    return replace(designs, length_scale=np.ones((n_designs, 6)))


def rolled_out(x: np.ndarray, angle: np.ndarray | float = 0.0, y: np.ndarray | float = 0.0) -> Rollouts:
    """Rollouts whose links are at given (n_designs, n_steps, 6) places along the tank."""
    trace = np.zeros((*x.shape, 6), dtype=np.float32)
    trace[..., 0], trace[..., 1], trace[..., 2] = x, y, angle
    n = len(x)
    return Rollouts(np.zeros(n), np.zeros(n), np.zeros(n), np.full(n, OK), trace)


def gliding(speed: float, apart: float, n_steps: int = N_SETTLE + 400) -> np.ndarray:
    """(1, n_steps, 6) places of links in a row, `apart` from each other, let go at the settled state's time."""
    time = (np.arange(n_steps) - (N_SETTLE - 1)) * DT
    return (speed * time[:, None] + apart * np.arange(6))[None]


def cross(x: np.ndarray, designs: Designs | None = None, angle: np.ndarray | float = 0.0):
    return crossings(designs or upright(len(x)), rolled_out(x, angle), TANK, n_settle=N_SETTLE, time_step=DT)


def test_the_paper_s_tank_is_this_large_to_the_robot() -> None:
    tank = Tank()
    assert tank.simulated_length == pytest.approx(16.714, abs=1e-3)
    assert tank.simulated_depth == pytest.approx(2.143, abs=1e-3)
    assert tank.n_steps(1 / 60) == round(60 * 150 / np.sqrt(0.07))
    assert tank.n_steps(1 / 60) == 34017


def test_built_times_and_speeds_are_those_of_froude_s_law() -> None:
    tank = Tank()
    # v² / (g L) is the same in both: a robot that goes its own length in a second does so in √0.07 s as built.
    assert tank.built_speed(1.0) ** 2 / (9.8 * tank.scale * 1.0) == pytest.approx(1.0 / (9.8 * 1.0))
    assert tank.built_seconds(tank.simulated_length / 1.0) * tank.built_speed(1.0) == pytest.approx(tank.length)
    assert tank.built_seconds(150 / np.sqrt(0.07)) == pytest.approx(tank.seconds)


def test_a_robot_that_glides_has_crossed_when_its_front_has_come_to_the_end() -> None:
    (found,) = cross(gliding(speed=0.5, apart=1.0))  # 5 m between centres, half a link at each end
    assert found.length == pytest.approx(6.0)
    assert found.distance == pytest.approx(14.0)
    assert found.crossed
    assert found.seconds == pytest.approx(14.0 / 0.5, abs=DT)
    assert found.travelled == pytest.approx(14.0, abs=0.5 * DT)
    assert found.speed == pytest.approx(0.5, rel=1e-6)


def test_a_robot_that_is_too_slow_has_not_crossed() -> None:
    (found,) = cross(gliding(speed=0.3, apart=1.0))
    assert not found.crossed
    assert np.isnan(found.seconds)
    assert found.travelled == pytest.approx(0.3 * 40)
    assert found.speed == pytest.approx(0.3)


def test_a_link_that_reaches_ahead_is_no_crossing() -> None:
    x = gliding(speed=0.0, apart=1.0)
    x[0, N_SETTLE + 100 :, 5] += 30  # its front is far beyond the end; its centre of mass has moved 5 m
    (found,) = cross(x)
    assert not found.crossed
    assert found.travelled == pytest.approx(5.0)


def test_who_goes_back_has_not_crossed() -> None:
    (found,) = cross(gliding(speed=-1.0, apart=1.0))
    assert not found.crossed
    assert found.travelled == pytest.approx(-40.0)


def test_a_robot_as_long_as_the_tank_does_not_cross_it() -> None:
    (found,) = cross(gliding(speed=1.0, apart=4.0))
    assert found.length == pytest.approx(21.0)
    assert found.distance < 0
    assert not found.crossed


def test_length_and_height_are_from_corner_to_corner() -> None:
    designs = replace(upright(1), length_scale=np.full((1, 6), 2.0))
    flat, upright_, tilted = (
        cross(gliding(0.0, apart=0.0), designs, angle)[0] for angle in (np.pi / 2, 0.0, np.pi / 4)
    )
    assert (flat.length, flat.height) == (pytest.approx(2.0), pytest.approx(0.5))
    assert (upright_.length, upright_.height) == (pytest.approx(0.5), pytest.approx(2.0))
    assert (tilted.length, tilted.height) == (pytest.approx(2.5 / np.sqrt(2)), pytest.approx(2.5 / np.sqrt(2)))


def settled_at(y: np.ndarray, tank: Tank, apart: float = 1.0) -> Crossing:
    """A robot of upright links of 1 m by 1 m that glides through a tank, with links at heights y, (6,) [m]."""
    rollouts = rolled_out(gliding(0.5, apart), y=y)
    (found,) = crossings(upright(1), rollouts, tank, n_settle=N_SETTLE, time_step=DT)
    return found


def test_a_robot_higher_than_the_walls_does_not_fit_but_may_cross() -> None:
    """The walls are 2.7 m high to it; 1.7 m between the middles of links of 1 m just fit."""
    y = np.zeros(6)
    for middle, misfit in ((1.69, ""), (1.71, "too high")):
        y[2] = middle
        found = settled_at(y, TANK)
        assert found.height == pytest.approx(middle + 1.0) and found.crossed
        assert found.misfit == misfit


def test_a_robot_wider_than_the_tank_does_not_cross_it() -> None:
    """Pontoons of 25 mm, 300 mm from one to the other, are 325 mm wide."""
    assert TANK.robot_width == pytest.approx(0.325)
    for width, misfit in ((0.33, ""), (0.32, "too wide")):
        tank = TANK.model_copy(update={"width": width})
        found = settled_at(np.zeros(6), tank)
        assert found.misfit == misfit and found.crossed == (not misfit) == tank.lets_pass(found.distance)
    narrow = TANK.model_copy(update={"width": 0.3})
    assert settled_at(np.zeros(6), narrow, apart=4.0).misfit == "too long and too wide"


def test_a_tank_holds_its_filling() -> None:
    with pytest.raises(
        ValueError, match=r"depth is 0\.3 m and height 0\.27 m.*expected a height of at least the depth"
    ):
        Tank(depth=0.3)
    assert Tank(depth=0.3, height=0.3).simulated_depth == pytest.approx(0.3 / 0.07)


@pytest.mark.parametrize("law", ["froude", "kept_frequencies"])
@pytest.mark.parametrize("link_density", [1.0, 2.0])
def test_a_servo_s_torque_at_scale_is_that_of_the_kit(law: str, link_density: float) -> None:
    """Six links of 1 m² are 2 × 25 mm thick and 29 400 mm² large as built: 1.47 l, and at 800 kg/m³ 1.176 kg."""
    tank = Tank()
    scales = scales_of(Scaling(law=law), length=0.07, mass_kg=1.176, simulated_mass_kg=6 * link_density)
    assert tank.simulated_servo_torque(link_density) * scales.torque == pytest.approx(tank.servo_torque)
    assert tank.simulated_servo_torque(1.0) == pytest.approx(142.9, abs=0.1)
    assert tank.servo_torque == pytest.approx(20 * KG_CM, abs=0.002)


def test_who_diverges_touches_no_other() -> None:
    x = np.concatenate([gliding(0.5, 1.0), gliding(0.5, 1.0)])
    x[0, N_SETTLE + 7 :] = np.nan
    lost, found = cross(x)
    assert not lost.crossed
    assert np.isnan(lost.travelled)
    assert found.crossed


def test_a_trace_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match=r"trace has shape \(1, 100, 6, 6\), expected \(1, 403, \.\.\.\)"):
        cross(gliding(0.5, 1.0, n_steps=100))
    with pytest.raises(ValueError, match="no trace"):
        crossings(upright(1), replace(rolled_out(gliding(0.5, 1.0)), trace=None), TANK, n_settle=3, time_step=DT)


def test_a_robot_that_never_settled_is_refused() -> None:
    rollouts = rolled_out(gliding(0.5, 1.0, n_steps=400))  # whose first state is already a step after the spawn
    with pytest.raises(ValueError, match=r"n_settle is 0, expected at least 1"):
        crossings(upright(1), rollouts, TANK, n_settle=0, time_step=DT)


@pytest.mark.parametrize(
    ("scores", "chosen"),
    [
        ([1.0, 2.0, 9.0], 1),  # mean 4
        ([3.0, 5.0, 4.0], 2),
        ([3.0, 5.0], 0),  # as near: the first
        ([np.nan, 7.0, np.nan], 1),
        ([np.nan, np.nan], None),
        ([], None),
    ],
)
def test_the_champion_to_build_is_the_nearest_the_mean(scores: list[float], chosen: int | None) -> None:
    assert nearest_the_mean(np.array(scores)) == chosen


def test_further_trials_begin_at_other_moments_of_the_same_gait() -> None:
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


def test_crossings_are_counted_by_both_laws_of_scaling() -> None:
    """At kept frequencies the limit of 12.6 s is as many simulated seconds; by Froude's law it is 40 of them."""
    assert TANK.seconds == pytest.approx(12.65, abs=0.01)

    def trial(seconds: float, travelled: float = 14.0) -> Crossing:
        return Crossing(6.0, 1.0, "", 14.0, travelled, np.isfinite(seconds), seconds, 0.5)

    nowhere = [trial(np.nan, travelled) for travelled in (0.49, -0.49, 0.51, -0.51, np.nan)]  # 5 cm are 0.5 m to it
    counted = count_crossings([trial(10.0), trial(12.0), trial(30.0), *nowhere], TANK)
    assert (counted.n, counted.n_crossed, counted.n_crossed_at_kept_frequencies) == (8, 3, 2)
    assert counted.n_immobile == 2
