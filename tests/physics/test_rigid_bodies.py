"""Links that fuse and links that collide, in the reference engine: against Newton, Archimedes and each other."""

from dataclasses import replace

import numpy as np
import pytest

from tasks.design import Designs, Morphology, random_designs
from tasks.design.morphology import separation
from tasks.simulation import simulate
from tasks.world import DryLand, Physics, TrueSlush
from tasks.world.slush import submerged_part

DT, G = 1 / 60, 9.8
EPS32 = 2.0**-24
SKINS, SLOP = 0.02, 0.005
"""Box2D 2.3, b2Settings.h: resting polygons are two skins of 0.01 m apart, less the slop [m]."""
X, Y, ANGLE, VX, VY, OMEGA = range(6)
BUILT = Physics(max_motor_torque=30.0, passive_joints="locked", link_collisions=True)
BUILDABLE = Morphology(n_actuated=2, unjoined_links="apart")


@pytest.fixture(scope="module")
def buildable() -> Designs:
    return random_designs(16, np.random.default_rng(51), morphology=BUILDABLE)


def trace_of(designs: Designs, environment: DryLand | TrueSlush, n_steps: int, physics: Physics) -> np.ndarray:
    trace = simulate(
        designs, environment, n_settle=0, n_measure=n_steps, engine="reference", trace=True, physics=physics
    ).trace
    assert trace is not None
    return trace.astype(np.float64)


def locked(designs: Designs) -> Designs:
    """Turn all motors off: with locked passive joints a robot is a single rigid body."""
    return replace(designs, motor_on=np.zeros_like(designs.motor_on))


def gaps(designs: Designs, state: np.ndarray, *, joined: bool) -> np.ndarray:
    """Measure the separation of every pair of links that a joint ties (or does not); NaN for the other pairs.

    Args:
        designs: n_designs designs.
        state: (n_designs, n_steps, n_links, 6) of those designs.
        joined: whether a joint ties the pairs.

    Returns:
        (n_designs, n_steps, 15) [m]
    """
    half = np.stack([0.5 / designs.length_scale, designs.length_scale / 2], axis=-1)[:, None]
    pose = [state[..., X], state[..., Y], np.cos(state[..., ANGLE]), np.sin(state[..., ANGLE])]
    links = np.concatenate([np.stack(pose, axis=-1), np.broadcast_to(half, (*state.shape[:3], 2))], axis=-1)
    found = []
    for j in range(6):
        for i in range(j):
            gap = separation(links[:, :, i].reshape(-1, 6), links[:, :, j].reshape(-1, 6)).reshape(state.shape[:2])
            found.append(np.where((designs.parent[:, j] == i)[:, None] == joined, gap, np.nan))
    return np.stack(found, axis=-1)


def test_a_fused_body_floats_where_its_weight_and_its_moments_balance(buildable: Designs) -> None:
    # Drag vanishes with speed, so a robot keeps bobbing, ever less. Take the means over its last ten seconds.
    n_steps = 4800
    designs = locked(buildable)
    state = trace_of(designs, TrueSlush(50.0), n_steps, BUILT)[:, -600:]
    length = np.broadcast_to(designs.length_scale[:, None], state.shape[:3])
    area, _ = submerged_part(length, state[..., Y], np.cos(state[..., ANGLE]), np.sin(state[..., ANGLE]))
    # Archimedes: 6 kg of slush of 1.25 kg/m² are displaced; the bobbing cancels in the mean.
    np.testing.assert_allclose(area.sum(axis=2).mean(axis=1), 6 / 1.25, rtol=2e-3)
    # There is no moment about the centre of mass: less than that of 6 kg of buoyancy on a lever of 0.02 m.
    lever = state[..., X] - state[..., X].mean(axis=2, keepdims=True)
    moment = (area * lever).sum(axis=2).mean(axis=1)
    assert np.abs(moment).max() < 0.02 * 6 / 1.25
    assert np.abs(np.cos(state[..., ANGLE])).min() < 0.999  # not all links are upright, which would balance trivially


def stack() -> Designs:
    """Build a chain that folds: link 2 swings down and hits link 0.

    Link 0 stands upright; link 1 goes on from its top, bent over to the right; link 2 hangs from link 1's far end by a
    free joint, level at first and pointing back to link 0. The other links follow link 2.
    """
    design = random_designs(1, np.random.default_rng(53))
    half = np.pi / 2
    return replace(
        design,
        parent=np.array([[-1, 0, 1, 2, 2, 2]]),
        length_scale=np.array([[3.0, 1.5, 3.0, 1.0, 1.0, 1.0]]),
        parent_attachment=np.array([[0, 1, 1, 1, 1, 1]]),
        child_attachment=np.array([[0, -1, -1, 0, 0, 0]]),
        rest_angle=np.array([[0, -half, 2.0, 0, half / 2, -half / 2]]),
        motor_on=np.zeros((1, 6), dtype=bool),
    )


@pytest.mark.parametrize("collisions", [False, True])
def test_unjoined_links_do_not_pass_through_each_other(collisions: bool) -> None:
    design = stack()
    physics = Physics(link_collisions=collisions)
    trace = trace_of(design, DryLand(0.0), 240, physics)
    deepest = np.nanmin(gaps(design, trace, joined=False)[..., :3])  # pairs (0, 1), (0, 2), (1, 2); joined ones NaN
    if collisions:
        fastest = np.abs(trace[..., VX : VY + 1]).max() + np.abs(trace[..., OMEGA]).max() * 1.5
        assert deepest > SKINS - 2 * SLOP - fastest * DT  # overlap of one step before it is corrected
        assert deepest < SKINS + 0.05  # they did collide
    else:
        assert deepest < -0.3  # link 0 is a third of a metre thick, so link 2 passed through
