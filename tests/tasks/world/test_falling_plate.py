"""Falling plates: the published equations, their fluttering and tumbling, added mass, and energy."""

from dataclasses import replace

import numpy as np
import pytest
from both_engines import assert_equal
from scipy.integrate import solve_ivp

from tasks.design import random_designs
from tasks.simulation.free_links import FreeLinks
from tasks.world import LinkStates, Physics, Pool
from tasks.world.falling_plate import FallingPlate

BETA, START = 1 / 8, (0.1, -0.1, 0.0, 0.2)  # thickness to width; u, v, ω and θ of the plate's width to the horizontal


def published(_, state, inertia):
    """Andersen, Pesavento and Wang (2005, p. 91) in units of the half width and the speed of fall, with their I*."""
    u, v, omega, theta, *_ = state
    q = np.hypot(u, v)
    circulation = 2 / np.pi * (-1.2 * u * v / q + np.pi * omega)
    drag = (1.4 - (u * u - v * v) / q**2) * q / np.pi
    along, across = inertia + BETA**2, inertia + 1
    turning = 0.25 * (inertia * (1 + BETA**2) + 0.5 * (1 - BETA**2) ** 2)
    return (
        (across * omega * v - circulation * v - np.sin(theta) - drag * u) / along,
        (-along * omega * u + circulation * u - np.cos(theta) - drag * v) / across,
        (-(1 - BETA**2) * u * v - 0.2 * (1 + abs(omega)) * omega) / turning,
        omega,
        u * np.cos(theta) - v * np.sin(theta),
        u * np.sin(theta) + v * np.cos(theta),
    )


def falling(inertias: list[float], dt: float, duration: float) -> np.ndarray:
    """Return (n_steps, 3, n_plates) angles, x and y of plates of these I* in the base simulator, in the same units.

    They are ellipses. The first takes steps of dt, the others of the same time in seconds.
    """
    a, (u, v, omega, theta) = BETA**-0.5 / 2, START
    mass = np.array(inertias) * np.pi * a**2
    speed = np.sqrt((mass - 1) * 9.8 / (np.pi * a))
    links = FreeLinks(np.full(len(mass), 2 * a), Physics(time_step=dt * a / speed[0]))
    links._constants = tuple(
        (of * np.ones_like(mass)).astype(np.float32) for of in (2 * a, mass, mass * a**2 * (1 + BETA**2) / 4)
    )
    state = np.zeros((len(mass), 6), np.float32)
    state[:, 2] = theta - np.pi / 2
    state[:, 3] = speed * (u * np.cos(theta) - v * np.sin(theta))
    state[:, 4] = speed * (u * np.sin(theta) + v * np.cos(theta))
    state[:, 5] = omega * speed / a
    sunk, seen = np.zeros(len(mass)), []
    for _ in range(round(duration / dt)):
        sunk, state[:, 1] = sunk + state[:, 1], 0
        seen.append((state[:, 2] + np.pi / 2, state[:, 0] / a, sunk / a))
        under_water = state - np.array((0, 99, 0, 0, 0, 0), np.float32)
        state = links.step(under_water, FallingPlate(density=1.0))
        state[:, 1] += 99
    return np.array(seen)


@pytest.mark.parametrize("inertia", [1.1, 1.4])
def test_it_converges_to_the_published_equations(inertia):
    """The error is of first order in the time step; without that order, it is 1 % of the way."""
    true = solve_ivp(published, (0, 10), (*START, 0, 0), rtol=1e-9, atol=1e-9, dense_output=True, args=(inertia,)).sol
    coarse, fine = falling([inertia], 0.02, 10)[..., 0], falling([inertia], 0.01, 10)[::2, :, 0]
    path = true(0.02 * np.arange(len(coarse)))[3:].T
    error, of_coarse = (np.abs(steps - path).max(axis=0) for steps in (fine, coarse))
    assert of_coarse / error == pytest.approx([2, 2, 2], rel=0.15)
    assert (np.abs(2 * fine - coarse - path).max(axis=0) < 0.01 * np.ptp(path, axis=0)).all()


def test_heavy_plates_tumble_and_light_ones_flutter():
    """The published equations change from one to the other at I* = 1.21 ± 0.01; from 1.3 on no tumble is reversed."""
    late = falling([1.4, 1.3, 1.25, 1.2, 1.1, 0.5], 0.02, 150)[3000:, 0]
    turns = np.ptp(late, axis=0) / (2 * np.pi)
    assert (turns[:3] > 2).all() and (turns[3:] > 0.1).all() and (turns[3:] < 0.6).all()
    assert (np.abs(np.sign(np.diff(late[:, :2], axis=0)).sum(axis=0)) == len(late) - 1).all()


def some_links(**fixed: float) -> LinkStates:
    rng, n = np.random.default_rng(3), 2000
    length, angle, moving = rng.uniform(1, 3, n), rng.uniform(-9, 9, n), rng.normal(size=(3, n)) * [[15], [15], [10]]
    inertia = (length**2 + length**-2) / 12
    links = LinkStates(length, np.ones(n), inertia, np.zeros(n), np.cos(angle), np.sin(angle), *moving)
    return replace(links, **{name: np.full(n, float(number)) for name, number in fixed.items()})


def test_the_fluid_gives_no_energy():
    """That of a link and the fluid that it carries never grows, in steps of any length."""
    links, still = some_links(y=-9), Physics(gravity=0.0)
    a, b = links.length_scale / 2, 0.5 / links.length_scale
    masses = 1 + 1.25 * np.pi * b**2, 1 + 1.25 * np.pi * a**2
    inertia = links.inertia + np.pi * 1.25 / 8 * (a**2 - b**2) ** 2

    def energy(vx, vy, omega):
        along, across = links.cos * vy - links.sin * vx, links.cos * vx + links.sin * vy
        return masses[0] * along**2 + masses[1] * across**2 + inertia * omega**2

    for dt in (1 / 60, 0.3):
        change = FallingPlate().velocity_change(links, still.model_copy(update={"time_step": dt}))
        after = energy(links.vx + change.vx, links.vy + change.vy, links.omega + change.omega)
        assert (after <= energy(links.vx, links.vy, links.omega) * (1 + 1e-12)).all()


def test_at_rest_gravity_acts_on_the_weight_less_buoyancy_and_moves_the_carried_mass_too():
    links = some_links(y=-9, vx=0, vy=0, omega=0)
    change, dt = FallingPlate(density=1.25).velocity_change(links, Physics()), 1 / 60
    a, b = links.length_scale / 2, 0.5 / links.length_scale
    masses, lift = np.array((1 + 1.25 * np.pi * b**2, 1 + 1.25 * np.pi * a**2)), 0.25 * 9.8 * dt
    along, across = lift * links.cos / masses[0], lift * links.sin / masses[1]
    np.testing.assert_allclose(change.vy - 9.8 * dt, links.sin * across + links.cos * along, atol=1e-12)
    np.testing.assert_allclose(change.vx, links.cos * across - links.sin * along, atol=1e-12)


def test_a_kick_moves_the_carried_mass_too():
    kick = np.array((0.3, -0.2, 0.1))
    still = some_links(y=-9, vx=0, vy=0, omega=0)
    kicked = replace(still, kick_vx=kick[:1], kick_vy=kick[1:2], kick_omega=kick[2:])
    change, before = (FallingPlate().velocity_change(links, Physics()) for links in (kicked, still))
    a, b, cos, sin = still.length_scale / 2, 0.5 / still.length_scale, still.cos, still.sin
    kept = kick[:, None] + [getattr(change, name) - getattr(before, name) for name in ("vx", "vy", "omega")]
    along, across = cos * kept[1] - sin * kept[0], cos * kept[0] + sin * kept[1]
    np.testing.assert_allclose(along * (1 + 1.25 * np.pi * b**2), cos * kick[1] - sin * kick[0], atol=1e-12)
    np.testing.assert_allclose(across * (1 + 1.25 * np.pi * a**2), cos * kick[0] + sin * kick[1], atol=1e-12)
    whole = still.inertia + np.pi * 1.25 / 8 * (a**2 - b**2) ** 2
    np.testing.assert_allclose(kept[2] * whole, kick[2] * still.inertia, atol=1e-12)


def test_dry_links_feel_nothing():
    change = FallingPlate().velocity_change(some_links(y=2), Physics())
    assert not np.any([change.vx, change.vy, change.omega])


@pytest.mark.parametrize(
    "physics", [Physics(), Physics(passive_joints="locked", link_collisions=True)], ids=["trees", "rigid bodies"]
)
def test_both_engines_agree(physics):
    designs = random_designs(5, np.random.default_rng(4))
    assert_equal(designs, Pool(1.5, FallingPlate()), physics, n_settle=20, n_measure=100)
