"""Whole robots against conservation laws, a resting place and Archimedes."""

from dataclasses import replace

import numpy as np

from tasks.design import Designs, Morphology, random_designs
from tasks.simulation import simulate
from tasks.world import DryLand, Physics, TrueSlush
from tasks.world.slush import submerged_part

DT, G = 1 / 60, 9.8
EPS32 = 2.0**-24
"""Relative rounding of float32."""
POLYGON_RADIUS, SLOP = 0.01, 0.005
"""Box2D 2.3, b2Settings.h: every polygon has a skin, contacts keep a little overlap of skins."""

X, Y, ANGLE, VX, VY, OMEGA = range(6)


def still(designs: Designs) -> Designs:
    return replace(designs, motor_on=np.zeros_like(designs.motor_on))


def driven(designs: Designs) -> Designs:
    """All motors on, at the highest frequency."""
    return replace(designs, motor_on=np.ones_like(designs.motor_on), frequency=np.full_like(designs.frequency, 0.3))


def test_motors_do_not_move_the_centre_of_mass_of_a_robot_that_falls() -> None:
    n_steps = 120
    designs = driven(random_designs(24, np.random.default_rng(31)))
    rollouts = simulate(designs, DryLand(100.0), n_settle=0, n_measure=n_steps, engine="reference", trace=True)
    assert rollouts.trace is not None
    mean = rollouts.trace.astype(np.float64).mean(axis=2)  # links of one mass
    fastest = np.abs(rollouts.trace[..., VX : VY + 1]).max()
    # Joint impulses act equal and opposite; what they leave is rounding. A step adds to the velocities of the two links
    # of each of 5 joints in the warm start and 8 sweeps: 90 roundings, and as many of an impulse times 1/m, over 6
    # links. They fall either way, so they add up like a walk; six deviations of it are allowed. dt and g dt are rounded
    # alike in each step, which shows in the fall.
    step = np.arange(1, n_steps + 1)
    walk = 6 * np.sqrt(2 * 90 * step) / 6 * EPS32 * fastest
    assert (np.abs(mean[..., VX]) <= walk).all()
    assert (np.abs(mean[..., VY] + G * step * DT) <= walk + 3 * EPS32 * G * step * DT).all()
    # The position moves by the mean velocity, and the position solver's corrections (3 sweeps of 5 joints at most) are
    # equal and opposite too, up to the rounding of places within 40 m.
    drift = walk.sum() * DT + 6 * np.sqrt(n_steps * (6 + 2 * 15)) / 6 * EPS32 * 40
    assert np.abs(rollouts.com_displacement).max() <= drift
    assert np.abs(rollouts.displacement).max() > 100 * drift  # the root itself does move


def test_a_robot_at_rest_on_the_ground_stays() -> None:
    # Six upright links on the ground, hinged at their centres, with nothing to push them over.
    designs = still(random_designs(3, np.random.default_rng(32)))
    designs = replace(
        designs,
        length_scale=np.array([np.full(6, 1.0), np.full(6, 1.5), np.full(6, 3.0)]),
        **{name: np.zeros((3, 6)) for name in ("parent_attachment", "child_attachment", "rest_angle")},
    )
    rollouts = simulate(designs, DryLand(0.0), engine="reference", trace=True)
    assert rollouts.trace is not None
    assert np.abs(rollouts.displacement).max() < 1e-4
    # They rest on the skins of two polygons, less the slop.
    height = rollouts.trace[..., Y] - designs.length_scale[:, None] / 2
    assert (height[:, 200:] <= 2 * POLYGON_RADIUS).all()
    assert (height[:, 200:] >= 2 * POLYGON_RADIUS - 2 * SLOP).all()
    assert np.abs(rollouts.trace[:, 200:, :, ANGLE]).max() < 1e-3


def test_a_fused_body_floats_where_its_weight_and_its_moments_balance() -> None:
    # With locked joints and no motor a robot is a single body. Drag vanishes with speed, so it keeps bobbing, ever
    # less. Take the means over its last ten seconds.
    buildable = Morphology(n_actuated=2, unjoined_links="apart")
    designs = still(random_designs(6, np.random.default_rng(51), morphology=buildable))
    physics = Physics(max_motor_torque=30.0, passive_joints="locked", link_collisions=True)
    rollouts = simulate(
        designs, TrueSlush(50.0), n_settle=0, n_measure=4800, engine="reference", trace=True, physics=physics
    )
    assert rollouts.trace is not None
    state = rollouts.trace[:, -600:].astype(np.float64)
    length = np.broadcast_to(designs.length_scale[:, None], state.shape[:3])
    area, _ = submerged_part(length, state[..., Y], np.cos(state[..., ANGLE]), np.sin(state[..., ANGLE]))
    # Archimedes: 6 kg of slush of 1.25 kg/m² are displaced; the bobbing cancels in the mean.
    np.testing.assert_allclose(area.sum(axis=2).mean(axis=1), 6 / 1.25, rtol=2e-3)
    # There is no moment about the centre of mass: less than that of 6 kg of buoyancy on a lever of 0.02 m.
    lever = state[..., X] - state[..., X].mean(axis=2, keepdims=True)
    moment = (area * lever).sum(axis=2).mean(axis=1)
    assert np.abs(moment).max() < 0.02 * 6 / 1.25
    assert np.abs(np.cos(state[..., ANGLE])).min() < 0.999  # not all links are upright, which would balance trivially
