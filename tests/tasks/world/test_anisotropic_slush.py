"""Anisotropic slush: drag along and across a link by itself, and what that does to a plate that sinks."""

import numpy as np
import pytest

from tasks.simulation.free_links import FreeLinks
from tasks.world import LinkStates, Physics, Slush
from tasks.world.anisotropic_slush import AnisotropicSlush

PHYSICS = Physics()


def submerged(angle, vx, vy, omega=0.0):
    """Return states of links of 2 m far below the surface."""
    angle, vx, vy, omega = np.broadcast_arrays(*(np.array(of, dtype=np.float64) for of in (angle, vx, vy, omega)))
    one = np.ones_like(angle)
    return LinkStates(2 * one, one, one * 4.25 / 12, -9 * one, np.cos(angle), np.sin(angle), vx, vy, omega)


def test_equal_coefficients_along_an_axis_are_the_slush() -> None:
    links = submerged([0.0, np.pi / 2], [1.0, 2.0], 0.0, 0.7)
    ours = AnisotropicSlush(drag_along=10.0, drag_across=10.0).velocity_change(links, PHYSICS)
    slush = Slush().velocity_change(links, PHYSICS)
    for name in ("vx", "vy", "omega"):
        np.testing.assert_allclose(getattr(ours, name), getattr(slush, name), atol=1e-12)


def test_drag_along_and_across_the_long_axis() -> None:
    # One step of dv/dt = -k v² from 2 m/s with k = ½ 1.25 C, upright links: y is along the axis, x across.
    medium, dt = AnisotropicSlush(), PHYSICS.time_step
    lift = 1.25 * 9.8 * dt
    change = medium.velocity_change(submerged(0.0, [2.0, 0.0], [0.0, 2.0]), PHYSICS)
    across, along = (2 / (1 + 0.625 * C * 2 * dt) - 2 for C in (medium.drag_across, medium.drag_along))
    np.testing.assert_allclose(change.vx, [across, 0.0], atol=1e-12)
    np.testing.assert_allclose(change.vy, [lift, along + lift], atol=1e-12)


def test_drag_turns_with_the_link() -> None:
    """A tilted link that moves as an upright one, all turned by its angle, loses as much along and across itself."""
    medium, air, turn = AnisotropicSlush(), Physics(gravity=0.0), 0.4
    upright, c, s = medium.velocity_change(submerged(0.0, 2.0, -1.0), air), np.cos(turn), np.sin(turn)
    tilted = medium.velocity_change(submerged(turn, 2 * c + s, 2 * s - c), air)
    np.testing.assert_allclose(tilted.vx, c * upright.vx - s * upright.vy, atol=1e-12)
    np.testing.assert_allclose(tilted.vy, s * upright.vx + c * upright.vy, atol=1e-12)


@pytest.mark.parametrize("angle", [0.4, -0.4])
def test_a_tilted_plate_that_sinks_is_pushed_to_the_side_of_its_lower_end(angle: float) -> None:
    heavy = Physics(link_density=3.0)
    links, state = FreeLinks(np.array([3.0]), heavy), np.array([[0, -5, angle, 0, 0, 0]], dtype=np.float32)
    for _ in range(120):
        state = links.step(state, AnisotropicSlush())
    # The long axis (-sin θ, cos θ) points down at (sin θ, -cos θ), where motion is easiest.
    assert np.sign(state[0, 0]) == np.sign(angle) and abs(state[0, 3]) > 0.1
