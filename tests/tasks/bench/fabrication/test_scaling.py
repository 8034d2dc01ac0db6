"""Scales, loads and the torque–speed line against closed forms; a simulated motor's torque against m g r."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.bench.fabrication.scaling import Scales, Scaling, joint_loads, line_use, scales_of
from tasks.bench.fabrication.servos import SERVOS
from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.world import DryLand, Physics

SERVO = SERVOS["ds3225"]


def test_scales_of_both_laws():
    froude = scales_of(Scaling(), length=0.07, mass_kg=1.2, simulated_mass_kg=6.0)
    assert froude.time == pytest.approx(np.sqrt(0.07)) and froude.frequency * 0.3 == pytest.approx(1.1339, abs=1e-4)
    assert froude.torque * 30 == pytest.approx(0.42)  # 1.2/6 · 0.07 · 30
    kept = scales_of(Scaling(law="kept_frequencies"), length=0.07, mass_kg=1.2, simulated_mass_kg=6.0)
    assert (kept.time, kept.torque) == (1.0, froude.torque)


def test_line_use():
    stall, fastest = SERVO.stall_torque_nm, SERVO.no_load_speed_rad_s
    torque = np.array([stall, 0.0, stall / 2, stall / 2, -stall / 2, 0.0])
    speed = np.array([0.0, fastest, fastest / 2, -fastest / 4, -fastest / 2, -2 * fastest])
    np.testing.assert_allclose(line_use(torque, speed, SERVO), [1.0, 1.0, 1.0, 0.5, 1.0, 2.0])


def test_loads_of_a_known_run():
    scales = Scales(length=0.1, time=0.5, mass=0.2)
    torque = np.array([[30.0, 3.0], [-15.0, 4.0]])
    speed = np.array([[0.0, 1.0], [0.5, -1.0]])
    common = {"scales": scales, "servo": SERVO, "servos_per_joint": 2, "max_motor_torque": 30.0}
    first, second = joint_loads((2, 4), torque, speed, **common, commanded_speed=(0.2, 0.3))
    assert (first.joint, second.joint) == (2, 4)
    assert first.peak_torque == pytest.approx(30 * 0.02 / 2) and first.saturated == 0.5 and second.saturated == 0
    assert first.peak_speed == pytest.approx(1.0) and second.peak_speed == pytest.approx(2.0)
    assert first.use == pytest.approx(0.3 / SERVO.stall_torque_nm)  # at rest; the other step brakes
    assert second.use == pytest.approx(0.03 / SERVO.stall_torque_nm + 2.0 / SERVO.no_load_speed_rad_s)
    assert first.margin == pytest.approx(1 / first.use)
    assert first.rms_torque == pytest.approx(0.01 * np.sqrt((30**2 + 15**2) / 2))
    # A joint that stays at rest although commanded: the servo must keep up with its timeline.
    (still,) = joint_loads((2,), 0 * torque[:, :1], 0 * speed[:, :1], **common, commanded_speed=(1.0,))
    assert still.peak_speed == 2.0 and still.use == pytest.approx(2.0 / SERVO.no_load_speed_rad_s)


def arm(angle: float):
    """Return a robot with one link held out by a motor at the top of its parent; all others are locked at the root."""
    zeros, last = np.zeros((1, 6)), np.eye(6)[5:]
    return replace(
        random_designs(1, np.random.default_rng(0)),
        length_scale=np.ones((1, 6)),
        parent=np.array([[-1, 0, 0, 0, 0, 0]]),
        parent_attachment=last,  # at the top, clear of the ground
        child_attachment=-last,  # the last link is held by its end
        rest_angle=angle * last,
        phase=zeros,
        motion_range=np.full((1, 6), 0.2),
        motor_on=last > 0,
        frequency=np.zeros(1),
    )


@pytest.mark.parametrize("angle", [np.pi / 2, -np.pi / 2, np.pi / 3])
def test_holding_a_pendulum_takes_m_g_r(angle: float):
    physics = Physics(passive_joints="locked")
    rollouts = simulate(
        arm(angle), DryLand(depth=0.0), n_settle=600, n_measure=60, engine="reference", trace=True, physics=physics
    )
    torque, trace = rollouts.motor_torque[0], rollouts.trace[0]
    assert np.abs(trace[-60:, :, 5]).max() < 1e-3  # it stands still
    assert (torque[:, :5] == 0).all()
    # The arm's centre is half a metre from the joint, at x = -sin θ / 2, so gravity's torque is m g sin θ / 2 and the
    # motor balances it. Because of its finite gain the link sags by less than 0.02 rad.
    held = trace[-1, 5, 2] - trace[-1, 0, 2]
    expected = -1.0 * 9.8 * 0.5 * np.sin(held + trace[-1, 0, 2])
    np.testing.assert_allclose(torque[-60:, 5], expected, rtol=0.01)
    assert abs(held - angle) < 0.02
