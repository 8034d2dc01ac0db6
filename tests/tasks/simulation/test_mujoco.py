"""The engine MuJoCo: what it must share with Box2D, and what it lacks."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.simulation.engine import links_in
from tasks.simulation.mujoco import EngineError
from tasks.world import DryLand, EnsembleMedium, LinkStates, Physics, ResidualSlush, Slush, TrueSlush, VelocityChange
from tasks.world.mujoco_fluid import MujocoFluid

DESIGNS = random_designs(3, np.random.default_rng(8))
SWIMS = {"motor_on": np.ones_like(DESIGNS.motor_on), "frequency": np.full(3, 0.25)}
SWIMMERS = replace(DESIGNS, **SWIMS)


class Twice(EnsembleMedium):
    """The slush, as two members."""

    n_members = 2

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        return Slush().velocity_change(links, physics)


@pytest.mark.parametrize("controller", ["open_loop", "reflex", "phase"])
def test_robots_swim_as_in_box2d_with_the_same_steps(controller):
    """Motors and joints differ, so paths part; after four seconds by less than a tenth of what links have moved."""
    swimmers = replace(random_designs(3, np.random.default_rng(8), controller=controller), **SWIMS)
    physics, steps = Physics(time_step=1 / 240), {"n_settle": 0, "n_measure": 960, "trace": True}
    in_box2d, in_mujoco = (
        simulate(swimmers, TrueSlush(9.0), engine=engine, physics=physics, **steps).trace
        for engine in ("batch", "mujoco")
    )
    moved = np.abs(np.diff(in_box2d[..., :2], axis=1)).sum(axis=1).mean()
    assert np.abs(in_mujoco - in_box2d)[:, -1, :, :2].mean() < 0.1 * moved
    assert moved > 1.0
    unfelt = replace(swimmers, gains=np.zeros_like(swimmers.gains))
    there = simulate(unfelt, TrueSlush(9.0), engine="mujoco", physics=physics, **steps).trace
    assert (there == in_mujoco).all() == (controller == "open_loop")


def test_velocities_are_those_by_which_links_move():
    """By central differences of positions and angles, whose error is that of the third derivative."""
    trace = simulate(SWIMMERS, TrueSlush(9.0), engine="mujoco", n_settle=0, n_measure=90, trace=True).trace
    moved = (trace[:, 2:, :, :3] - trace[:, :-2, :, :3]) * 30
    assert moved[:, 20:] == pytest.approx(trace[:, 21:-1, :, 3:], abs=0.05)


def test_members_of_an_ensemble_are_simulated_each_by_itself():
    alone = simulate(SWIMMERS, TrueSlush(9.0), engine="mujoco", n_settle=4, n_measure=20, motor_work=True)
    both = simulate(SWIMMERS, ResidualSlush(9.0, Twice()), engine="mujoco", n_settle=4, n_measure=20, motor_work=True)
    assert (both.displacement == alone.displacement).all() and both.displacement.shape == (2, 3)
    assert (both.motor_work == alone.motor_work).all() and (alone.motor_work > 0).all()


@pytest.mark.parametrize("rate", [50, 60, 90, 100, 120])
def test_a_thrown_bar_falls_for_a_whole_step_whatever_its_length(rate):
    step = links_in(MujocoFluid(), np.ones(1), Physics(time_step=1 / rate))
    fallen = step(np.array([[0.0, 5.0, 0.0, 1.0, 0.0, 0.0]], np.float32))
    assert fallen[0, [0, 4]] == pytest.approx([1 / rate, -9.8 / rate], rel=1e-5)


@pytest.mark.parametrize(("name", "value", "expected"), [("restitution", 0.5, 0.0), ("max_motor_speed", 3.0, None)])
def test_physics_that_it_lacks_are_refused(name, value, expected):
    said = f"physics.{name} is {value}, which the engine mujoco lacks: expected {expected}"
    with pytest.raises(EngineError, match=said):
        simulate(SWIMMERS, DryLand(0.0), engine="mujoco", physics=Physics(**{name: value}))


def test_a_package_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(EngineError, match="mujoco is not installed; run `make setup EXTRAS=mujoco`"):
        simulate(SWIMMERS, DryLand(0.0), engine="mujoco")
