"""A design in MuJoCo moves as it does in Box2D, where it does not tumble."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tasks.design import kinematic_trees, random_designs
from tasks.simulation import simulate
from tasks.simulation.mjcf import mjcf
from tasks.world import DryLand, Physics

DESIGNS = random_designs(60, np.random.default_rng(1))
GENTLE = replace(
    DESIGNS, motor_on=np.ones_like(DESIGNS.motor_on), motion_range=np.clip(0.3 * DESIGNS.motion_range, 0.2, 1.5)
)


def displacement(model: mujoco.MjModel, seconds: float) -> float:
    data = mujoco.MjData(model)
    links = [model.actuator(number).name.removeprefix("motor-") for number in range(model.nu)]
    rest, amplitude, frequency, phase = np.array([model.numeric(f"gait-{link}").data for link in links]).T
    while data.time < seconds:
        data.ctrl[:] = rest + amplitude * np.sin(2 * np.pi * frequency * data.time + phase)
        mujoco.mj_step(model, data)
    return float(data.qpos[0])


@pytest.mark.parametrize("number", [11, 19, 20, 34])  # robots that slide two to five metres
def test_ten_seconds_on_dry_land_are_those_of_box2d(number):
    design = GENTLE[number]
    in_box2d = simulate(design, DryLand(0.0), n_settle=0, n_measure=600).displacement[0]
    assert displacement(mujoco.MjModel.from_xml_string(mjcf(design, 0.0)), 10.0) == pytest.approx(in_box2d, rel=0.15)


def test_masses_joints_and_collisions_are_those_of_the_physics():
    design = replace(DESIGNS[0], motor_on=np.array([[False, True, False, False, True, False]]))
    model = mujoco.MjModel.from_xml_string(mjcf(design, 2.0, Physics(passive_joints="locked", link_density=1.5)))
    assert (model.nu, model.nv) == (2, 3 + 2)  # the root's, and the motors' joints
    assert model.body_mass[1:] == pytest.approx([1.5] * 6)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.geom("ground").pos[2] == -2.0
    spawned = kinematic_trees(design, density=1.5)
    places = np.array([data.body(f"link-{link}").xpos for link in range(6)])
    assert places[:, 0] == pytest.approx(spawned.x[0], abs=1e-6)
    assert places[:, 2] == pytest.approx(spawned.y[0], abs=1e-6)
    assert data.ncon == 0  # links overlap, and pass through one another


@pytest.mark.parametrize("controller", ["open_loop", "reflex"])
def test_a_controller_that_the_model_lacks_is_named(controller):
    design = random_designs(1, np.random.default_rng(1), controller=controller)
    model = mujoco.MjModel.from_xml_string(mjcf(design, 2.0))
    assert model.text_data.rstrip(b"\0") == (b"reflex" if controller == "reflex" else b"")
