"""Links placed by bodies, bodies pushed by links: every bit is kept where nothing fuses, momenta where it does."""

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


def test_links_move_with_their_body(fused: RigidBodies) -> None:
    """The velocity of a link is the derivative of its place, and all of it turns alike."""
    rng = np.random.default_rng(43)
    state, cos, sin = states(fused, rng)
    placed = place_links(fused, state, cos, sin)
    np.testing.assert_allclose(
        (placed.cos, placed.sin),
        (np.cos(placed.state[..., ANGLE]), np.sin(placed.state[..., ANGLE])),
        rtol=0,
        atol=8 * 5 * np.pi * ULP,
    )
    # The origin moves with the centre of mass and about it; its lever is the first link's.
    first = np.broadcast_to(fused.first_link, SHAPE)
    lever = np.stack([np.take_along_axis(of, first, axis=2) for of in (placed.lever_x, placed.lever_y)], axis=-1)
    double = {name: getattr(fused, name).astype(np.float64) for name in ("x", "y")}
    turn, h = state[..., OMEGA].astype(np.float64), 1e-6
    origin = state[..., VX : VY + 1] + turn[..., None] * np.stack([-lever[..., 1], lever[..., 0]], axis=-1)

    def place(time: float) -> np.ndarray:
        angle = state[..., ANGLE].astype(np.float64) + turn * time
        c, s = np.cos(angle), np.sin(angle)
        turned = np.stack([c * double["x"] - s * double["y"], s * double["x"] + c * double["y"]], axis=-1)
        return state[..., : Y + 1] + origin * time + turned

    expected = (place(h) - place(-h)) / (2 * h)
    # Levers within 18 m, |ω| within 15 rad/s; three roundings each. The difference quotient adds 1e-16 · 18 / 1e-6.
    np.testing.assert_allclose(placed.state[..., VX : VY + 1], expected, rtol=0, atol=3 * 18 * 15 * ULP)
    np.testing.assert_array_equal(placed.state[..., OMEGA], state[..., OMEGA])


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
