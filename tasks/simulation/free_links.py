"""Free links: Box2D's step of bodies without contacts or joints, in NumPy, with the bits of the reference engine."""

import numpy as np

from tasks.arrays import Float32, Floats
from tasks.compiled import compiled
from tasks.simd import rotation
from tasks.simd.lanes import Block
from tasks.simulation.box2d import Column, limited
from tasks.world.medium import LinkStates, Medium, change_in
from tasks.world.physics import Physics

_N_LANES = 16


def _rotate(block: Block, n_rows: int) -> None:
    """Write the sines of the first n_rows rows to the next n_rows, and the cosines to those after them."""
    for row in range(n_rows):
        block[n_rows + row], block[2 * n_rows + row] = rotation.sincos(block[row])


_run = compiled(_rotate, seconds=1)


def sines_and_cosines(angle: Float32) -> tuple[Float32, Float32]:
    """Compute sines and cosines of (n,) angles [rad] with Box2D's bits, each (n,)."""
    n_rows = -(-len(angle) // _N_LANES)
    block = Block(3 * n_rows, _N_LANES)
    flat = block.rows.reshape(3, -1)
    flat[0, : len(angle)] = angle
    _run(block, n_rows)
    return flat[1, : len(angle)], flat[2, : len(angle)]


def link_constants(length_scale: Floats, physics: Physics) -> tuple[Float32, Float32, Float32]:
    """Return (n_links,) long axes [m], masses [kg] and moments of inertia [kg·m²] in the precision of the engines."""
    width = 1.0 / length_scale
    mass = physics.link_density * width * length_scale
    inertia = mass * (width**2 + length_scale**2) / 12
    return length_scale.astype(np.float32), mass.astype(np.float32), inertia.astype(np.float32)


class FreeLinks:
    """Single links without ground or joints, to be thrown. Paper, "Dataset Collection"."""

    def __init__(self, length_scale: Floats, physics: Physics) -> None:
        """Create (n_links,) links with the given long axes [m]."""
        self._physics, self._constants = physics, link_constants(length_scale, physics)

    def step(self, state: Float32, medium: Medium | None) -> Float32:
        """Return (n_links, 6) states one step after the given ones, both in the order of :class:`Column`."""
        velocity = state[:, Column.VX :]
        if medium is not None:
            sin, cos = sines_and_cosines(state[:, Column.ANGLE])
            length, mass, inertia = self._constants
            x, y, _, vx, vy, omega = state.T
            of_bars = (length, mass, inertia, y, cos, sin, vx, vy, omega, x)
            links = LinkStates(*(of[None, :, None] for of in of_bars))  # each bar is alone in its world
            change = change_in(medium, links, self._physics)
            changes = np.stack((change.vx, change.vy, change.omega), axis=-1)[0, :, 0]
            velocity = (velocity + changes).astype(np.float32)
        dt = np.float32(self._physics.time_step)
        vx, vy, omega = velocity.T
        vy = vy + dt * np.float32(-self._physics.gravity)

        with np.errstate(divide="ignore", invalid="ignore"):  # of links at rest, where another is too fast
            velocity = np.stack(limited(vx, vy, omega, dt), axis=1)
        return np.concatenate((state[:, : Column.ANGLE + 1] + dt * velocity, velocity), axis=1)
