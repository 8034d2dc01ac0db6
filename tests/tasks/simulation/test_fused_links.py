"""Bodies pushed by their links: momenta are kept. What links do with their body, tests/parity compares with Box2D."""

import numpy as np
import pytest

from tasks.design import Morphology, RigidBodies, kinematic_trees, random_designs, rigid_bodies
from tasks.simulation.fused_links import body_change, place_links
from tasks.world import VelocityChange

N = 200
ULP = 2.0**-23
"""Relative spacing of float32."""
X, Y, ANGLE, VX, VY, OMEGA = range(6)
SHAPE = (2, N, 6)


def states(rigid: RigidBodies, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States of bodies, the same for each link of one, with cosines and sines of their angles."""
    state = rng.normal(scale=3, size=(*SHAPE, 6)).astype(np.float32)
    state = np.take_along_axis(state, np.broadcast_to(rigid.first_link, SHAPE)[..., None], axis=2)
    return state, np.cos(state[..., ANGLE]), np.sin(state[..., ANGLE])


def change(rng: np.random.Generator) -> VelocityChange:
    return VelocityChange(*(rng.normal(size=SHAPE).astype(np.float32) for _ in range(3)))


@pytest.fixture(scope="module")
def fused() -> RigidBodies:
    designs = random_designs(N, np.random.default_rng(41), morphology=Morphology(n_actuated=2))
    return rigid_bodies(designs, passive_joints="locked")


def test_pushes_of_links_add_up_as_momenta(fused: RigidBodies) -> None:
    rng = np.random.default_rng(44)
    designs = random_designs(N, np.random.default_rng(41), morphology=Morphology(n_actuated=2))
    trees = kinematic_trees(designs, density=1.0)
    state, cos, sin = states(fused, rng)
    placed, pushes = place_links(fused, state, cos, sin), change(rng)
    of_body = body_change(fused, placed.lever_x, placed.lever_y, pushes)
    m, inertia = trees.mass.astype(np.float64), trees.inertia.astype(np.float64)
    for first in range(6):
        mine = np.broadcast_to(fused.first_link == first, SHAPE)
        is_body = fused.is_first[:, first]

        def total(of_link: np.ndarray, mine: np.ndarray = mine, is_body: np.ndarray = is_body) -> np.ndarray:
            return np.where(mine, of_link, 0).sum(axis=2)[:, is_body]

        x, y = placed.lever_x.astype(np.float64), placed.lever_y.astype(np.float64)
        mass, about = total(m), total(inertia + m * (x**2 + y**2))
        for found, expected in (
            (of_body.vx, total(m * pushes.vx) / mass),
            (of_body.vy, total(m * pushes.vy) / mass),
            (of_body.omega, total(m * (x * pushes.vy - y * pushes.vx) + inertia * pushes.omega) / about),
        ):
            # Six terms of a few factors; pushes within 5 m/s, m r / I below 1.5 /m for every body of several links.
            np.testing.assert_allclose(found[:, is_body, first], expected, rtol=0, atol=6 * 5 * 5 * 2 * ULP)
            assert not found[:, ~is_body, first].any()
