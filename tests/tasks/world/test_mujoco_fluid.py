"""MuJoCo's fluid: closed forms of its forces, and what is under water."""

import numpy as np
import pytest
from pydantic import ValidationError

from tasks.design import random_designs
from tasks.residual.throws import Starts, simulate_throws
from tasks.simulation import batch, simulate
from tasks.simulation.engine import links_in
from tasks.world import DryLand, Physics
from tasks.world.environment import Pool
from tasks.world.medium import MediumError
from tasks.world.mujoco_fluid import MujocoFluid

PHYSICS = Physics(gravity=0.0)
LENGTHS = np.array([1.0, 2.0, 3.0])
NONE = {"blunt_drag": 0, "slender_drag": 0, "angular_drag": 0, "kutta_lift": 0, "magnus_lift": 0}


def moved(fluid, *, y=-5.0, angle=0.0, vx=0.0, vy=0.0, omega=0.0, physics=PHYSICS):
    """Return the (3, 3) changes of the velocities of three links in a step."""
    state = np.tile(np.array([0.0, y, angle, vx, vy, omega], np.float32), (3, 1))
    return (links_in(fluid, LENGTHS, physics)(state) - state)[:, 3:]


def test_buoyancy_is_the_weight_of_what_is_displaced():
    """A link in 1.25 kg/m² with a share A_s under water accelerates by g (1.25 A_s - 1)."""
    physics, still = Physics(time_step=1e-4), MujocoFluid(density=1.25, **NONE)
    for y, share in ((-5.0, 1.0), (0.0, 0.5), (5.0, 0.0)):
        change = moved(still, y=y, physics=physics)
        assert change[:, 1] == pytest.approx(9.8 * (1.25 * share - 1) * 1e-4, rel=1e-3)
        assert not change[:, [0, 2]].any()


def test_drag_is_the_ellipsoid_s():
    """A broadside ellipsoid with semi-axes r is slowed down by ρ C A v², in MuJoCo without ½, with A = π r_y r_z."""
    physics, fluid = Physics(gravity=0.0, time_step=1e-4), MujocoFluid(**{**NONE, "blunt_drag": 0.5})
    area = np.pi * 0.5 * LENGTHS / 2
    change = moved(fluid, vx=2.0, physics=physics)
    assert change[1:, 0] == pytest.approx(-1.25 * 0.5 * area[1:] * 4.0 * 1e-4, rel=0.02)
    half_wet = moved(fluid, y=0.0, vx=2.0, physics=physics)
    assert half_wet[:, 0] == pytest.approx(change[:, 0] / 2, rel=1e-3)


def test_a_spinning_link_is_lifted_by_magnus_force_and_slowed_down():
    lifting, plain = MujocoFluid(**NONE | {"magnus_lift": 1.0}), MujocoFluid(**NONE)
    lifts = [moved(lifting, vx=2.0, omega=omega) - moved(plain, vx=2.0, omega=omega) for omega in (3.0, -3.0)]
    assert (lifts[0][:, 1] > 1e-3).all()
    assert lifts[1][:, 1] == pytest.approx(-lifts[0][:, 1], rel=0.01)
    assert (moved(MujocoFluid(), omega=3.0)[:, 2] < -1e-3).all()


def test_above_the_water_only_gravity_acts():
    """In an implicit step as well, which the derivatives of forces that do not act would slow down."""
    dry = moved(MujocoFluid(density=100.0), y=5.0, vx=3.0, vy=-2.0, omega=4.0, physics=Physics())
    assert dry == pytest.approx(np.tile([0.0, -9.8 / 60, 0.0], (3, 1)), abs=1e-6)


def test_a_throw_does_not_depend_on_the_throws_beside_it():
    rng = np.random.default_rng(2)
    state = rng.uniform(-2, 2, (5, 6)).astype(np.float32)
    starts = Starts(np.arange(5), rng.uniform(1, 3, 5), state)
    together = simulate_throws(starts, 8, MujocoFluid(), Physics())
    alone = simulate_throws(starts[2:3], 8, MujocoFluid(), Physics())
    assert (together[together.throw == 2].residual == alone.residual).all()
    assert abs(alone.residual[:, 3:]).max() > 1e-3


def test_robots_in_an_empty_fluid_move_as_on_dry_land_in_mujoco():
    designs, steps = random_designs(2, np.random.default_rng(8)), {"n_settle": 0, "n_measure": 40, "trace": True}
    dry = simulate(designs, DryLand(9.0), engine="mujoco", **steps)
    empty = simulate(designs, Pool(9.0, MujocoFluid(density=1e-12, **NONE)), **steps)
    assert empty.trace == pytest.approx(dry.trace, abs=1e-4)
    wet = simulate(designs, Pool(9.0, MujocoFluid()), **steps)
    assert abs(wet.trace - dry.trace).max() > 0.1


def test_its_engine_alone_simulates_it():
    design = random_designs(1, np.random.default_rng(8))
    with pytest.raises(MediumError, match="MujocoFluid acts in the engine mujoco alone"):
        batch.roll_out(design, Pool(9.0, MujocoFluid()), Physics(), n_settle=0, n_measure=3, trace=False)
    with pytest.raises(ValidationError, match="density"):
        MujocoFluid(density=-1.0)
