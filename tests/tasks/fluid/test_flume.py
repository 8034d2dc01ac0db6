"""A flume of water against closed forms: still water, Archimedes, added mass, momentum, energy."""

import os
import subprocess
import sys

import numpy as np
import pytest

from tasks.fluid import Flume
from tasks.fluid.buoyancy import displaced
from tasks.fluid.cover import covered
from tasks.fluid.transport import carry

DT, G, RHO = 1 / 60, 9.8, 1.25


class FreeLinks:
    """Links without joints in a flume, moved as an engine does: the fluid's change, gravity, then the move."""

    def __init__(self, length_scale, pose, velocity=(0.0, 0.0, 0.0), mass=1.0, spacing=0.25, **settings):
        a = np.array(length_scale, float)
        masses = np.full(len(a), mass)
        self.flume = Flume(a, masses, masses * (a**2 + a**-2) / 12, spacing=spacing, **settings)
        self.pose = np.broadcast_to(np.array(pose, float), (len(a), 3)).copy()
        self.velocity = np.broadcast_to(np.array(velocity, float), (len(a), 3)).copy()

    def change(self):
        return np.stack(self.flume.step(*self.pose.T, *self.velocity.T), axis=1)

    def step(self):
        self.velocity += self.change()
        self.velocity[:, 1] -= self.flume.grid.gravity * DT
        self.pose += DT * self.velocity

    def momentum(self):
        """Of the water in the open parts of faces and of the links, along x."""
        flume, links = self.flume, self.flume.links
        of_water = flume.water.u.copy()
        rows = (np.arange(of_water.shape[1]) + 0.5) * flume.grid.spacing + flume.grid.floor
        for share, velocity, pose in zip(flume.cover.of_u, links.velocity, links.pose, strict=True):
            of_water -= share * (velocity[0] - velocity[2] * (rows - pose[1]))
        return (
            RHO * flume.grid.spacing**2 * (of_water.sum() + flume.water.store.sum()) + links.mass @ links.velocity[:, 0]
        )

    def energy(self):
        """Of the water, and of links of the water's density, which all are under water."""
        water, cover, grid, links = self.flume.water, self.flume.cover, self.flume.grid, self.flume.links
        half = np.ones(water.v.shape[1])
        half[-1] = 0.5  # of the cell below the surface
        squares = (cover.open_u * water.u**2).sum() + (half * cover.open_v * water.v**2).sum()
        of_water = RHO / 2 * grid.spacing**2 * squares
        of_surface = RHO * G / 2 * grid.spacing * (water.rise**2).sum()
        speeds = np.square(links.velocity)
        return of_water + of_surface + (links.mass @ (speeds[:, 0] + speeds[:, 1]) + links.inertia @ speeds[:, 2]) / 2


def test_particles_go_with_the_water():
    """A current of 3 m/s carries them around a ring of 4 m, and their rows stay; one that sinks ends on the floor."""
    flume = Flume(*np.ones((3, 1)), length=4.0, depth=1.0)
    places = flume.places(0.5)
    assert len(places) == 16 and (np.diff(np.unique(places[:, 1])) == 0.5).all()
    flume.water.u[:] = 3.0
    np.testing.assert_allclose(flume.carried(flume.carried(places)) - places, [[6 * DT, 0.0]] * 16, atol=1e-12)
    flume.water.v[:] = -30.0
    assert (flume.carried(places)[:, 1] == np.maximum(places[:, 1] - 30 * DT, -1.0)).all()


def test_still_water_is_still():
    """Without a link, and around one that weighs what it displaces, which neither sinks nor turns."""
    links = FreeLinks([2.0], (12.0, -2.0, 0.4), mass=RHO)
    for _ in range(60):
        links.step()
    # ρ g A_s / m = g exactly but for the rounding of the clipped area, a few 1e-16 of g; it adds up over 60 steps.
    rounding = 60 * 60 * 1e-14
    assert abs(links.pose - (12.0, -2.0, 0.4)).max() < rounding
    assert max(abs(links.flume.water.u).max(), abs(links.flume.water.v).max()) < rounding


@pytest.mark.parametrize("row", [-1, -2, -3])
def test_transport_makes_no_new_extremes(row):
    """Rising water in one row of faces; the last one has half a cell, which 0.9 of a cell in a step would empty."""
    flume = Flume(*np.ones((3, 1)), length=4.0, depth=1.0)
    flume.water.u[:] = 0.1
    flume.water.v[:, row] = fastest = 0.9 * flume.grid.spacing / DT
    carry(flume.grid, flume.water)
    assert flume.water.v.min() >= 0.0 and flume.water.v.max() <= fastest


@pytest.mark.parametrize(("length_scale", "angle"), [(1.0, 0.0), (2.0, np.pi / 2), (3.0, np.pi / 2)])
def test_a_link_floats_as_archimedes_says(length_scale, angle):
    """It lets 1 / 1.25 of its 1 m² under water, within 5 %."""
    height = length_scale if angle == 0.0 else 1 / length_scale
    links = FreeLinks([length_scale], (4.0, -0.3 * height, angle), length=8.0, depth=2.0)
    under = []
    for step in range(600):
        links.step()
        if step >= 300:
            flume = links.flume
            rise = flume.water.rise.mean()  # by what the link displaces
            under.append(displaced(flume.links, 0)[0] + rise / height)
    assert np.mean(under) == pytest.approx(1 / RHO, rel=0.05)


@pytest.mark.parametrize(
    ("length_scale", "angle", "coefficient"),
    [(1.0, 0.0, 1.51 * 0.5**2), (1.0, 0.6, 1.51 * 0.5**2), (3.0, 0.0, 1.14 * 1.5**2), (3.0, 0.5, 1.14 * 1.5**2)],
)
def test_added_mass_is_that_of_potential_flow(length_scale, angle, coefficient):
    """Across the long axis it is C π ρ b² with b half the long axis: Newman (1977), "Marine Hydrodynamics", table 4.3.

    C is 1.51 for a square and about 1.14 for 9:1, in any direction for a square; within 15 %.
    """
    direction = np.array([np.cos(angle), np.sin(angle), 0.0])
    links = FreeLinks([length_scale], (12.1, -6.07, angle), direction, depth=12.0, gravity=0.0)
    after = 1.0 + links.change()[0] @ direction
    assert 1 / after - 1 == pytest.approx(coefficient * np.pi * RHO, rel=0.15)


SUBMERGED = [
    (1.0, (12.0, -2.0, 0.3), (2.0, 0.0, 0.0)),
    (3.0, (12.0, -2.0, 0.7), (2.0, 0.0, 1.0)),
    (2.0, (12.0, -2.0, 0.5), (6.0, -3.0, 2.0)),
]


PIERCING = [
    (2.0, (12.0, -0.1, np.pi / 2), (3.0, 0.0, 0.0)),
    (2.0, (12.0, 0.5, 0.5), (3.0, -3.0, 0.0)),
    (1.0, (12.0, 0.0, 0.3), (3.0, -1.0, 2.0)),
    (2.0, (12.0, -1.0, 0.5), (3.0, 3.0, 0.0)),
]


PLUNGING = [
    (3.0, (12.0, 1.6, 0.7), (3.0, -3.0, 0.0)),
    (2.0, (12.0, 1.2, 0.5), (3.0, -5.0, 0.0)),
    (1.0, (12.0, 1.0, 0.3), (3.0, -5.0, 0.0)),
    (3.0, (12.0, 1.6, -0.7), (3.0, -3.0, 0.0)),  # slams flat on the surface
]


@pytest.mark.parametrize(
    ("length_scale", "pose", "velocity", "share"),
    [(*link, 0.02) for link in (*SUBMERGED, *PIERCING)] + [(*link, 0.07) for link in PLUNGING],
)
def test_momentum_is_conserved(length_scale, pose, velocity, share):
    """In a second, of the water and a link that was kicked, and that loses most of its speed meanwhile."""
    links = FreeLinks([length_scale], pose, velocity)
    for _ in range(60):
        links.step()
        assert links.momentum() == pytest.approx(velocity[0], rel=share)
    assert abs(links.velocity[0, 0]) < 0.4 * velocity[0]


@pytest.mark.parametrize(("length_scale", "pose", "velocity"), SUBMERGED)
def test_energy_is_never_gained(length_scale, pose, velocity):
    links = FreeLinks([length_scale], pose, velocity, mass=RHO)
    energy = []
    for _ in range(90):
        links.step()
        energy.append(links.energy())
    # The surface of a step is that before the pressure, so energy is known to the order of dt: waves of 0.5 m and less
    # at 3 rad/s and more move 1e-3 of it to and fro. It must not grow over more than that.
    assert (np.array(energy) <= np.minimum.accumulate(energy) * 1.002).all()
    assert energy[-1] < 0.7 * energy[0]


@pytest.mark.parametrize("spacing", [0.25, 0.125])
def test_energy_is_not_gained_where_water_falls_through_the_surface(spacing):
    """At 20 m/s, in a jet of half a metre; far away a link floats in the water."""
    links = FreeLinks([1.0], (4.0, -3.0, 0.0), mass=RHO, spacing=spacing)
    x, y = np.ogrid[0.0:24.0:spacing, -4.0:0.01:spacing]
    links.flume.water.v[:] = -40.0 * np.exp(-(((x - 12.0) / 0.3) ** 2) + y)
    links.step()  # makes the flow incompressible
    energy = [links.energy()]
    for _ in range(60):
        links.step()
        energy.append(links.energy())
    assert max(energy) == energy[0] and energy[-1] < 0.5 * energy[0]


def test_the_mirror_image_moves_as_a_mirror_image():
    poses = np.array([[12.0, -1.0, 0.3], [12.4, -1.5, 1.2], [11.8, -0.2, 2.0]])
    velocities = np.array([[1.0, 0.5, 2.0], [0.2, -1.0, 0.0], [-0.5, 0.3, -1.0]])
    mirror = np.array([-1.0, 1.0, -1.0])
    links = FreeLinks([1.0, 2.0, 3.0], poses, velocities)
    image = FreeLinks([1.0, 2.0, 3.0], poses * mirror + (24.0, 0.0, 0.0), velocities * mirror)
    for _ in range(20):
        links.step()
        image.step()
    # Sums of a few thousand terms in another order, which 20 steps amplify little.
    np.testing.assert_allclose(image.velocity, links.velocity * mirror, atol=1e-8)


def test_a_face_is_covered_by_the_share_that_is_inside():
    """Faces along an axis of a link of 2 × 0.5 m, or cut by one of its edges."""
    assert covered(0.0, 0.0, 1.0, 0.0, 2.0, 0.5, 0.25) == 1.0
    assert covered(1.0, 0.0, 1.0, 0.0, 2.0, 0.5, 0.25) == 0.5
    assert covered(0.0, 0.25, np.cos(1.2), np.sin(1.2), 2.0, 0.5, 0.25) == pytest.approx(0.5)
    assert covered(0.0, 0.5, 1.0, 0.0, 2.0, 0.5, 0.25) == 0.0


def three_steps() -> str:
    """Return the bits of a few steps of two links that overlap at the surface."""
    links = FreeLinks([1.0, 2.0], (2.0, -0.3, 0.4), (1.0, 0.0, 1.0), length=4.0, depth=1.0)
    for _ in range(3):
        links.step()
    return links.velocity.tobytes().hex()


def test_plain_python_has_the_same_bits():
    script = f"import runpy; print(runpy.run_path({__file__!r})['three_steps']())"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    assert done.stdout.strip() == three_steps(), done.stderr
