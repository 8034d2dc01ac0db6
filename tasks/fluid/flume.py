"""A flume: a ring of water in which rigid links move.

The flume closes upon itself along x, so momentum along x and volume are conserved without a bank that reflects waves
or a window that follows. A robot that goes around it meets its own wake.
"""

# mypy: warn-return-any=False

import numpy as np

from tasks.arrays import Float64
from tasks.compiled import compiled, inline
from tasks.fluid.cover import cover_faces
from tasks.fluid.grid import Cover, Grid, Links, Water, cell_order, face_height, n_wet
from tasks.fluid.pressure import project, wrapped
from tasks.fluid.surface import float_links
from tasks.fluid.transport import carry


@inline
def _velocity_u(links: Links, velocity: Float64, link: int, y: float) -> float:
    """Return the velocity along x of a link at a height."""
    return velocity[link, 0] - velocity[link, 2] * (y - links.pose[link, 1])


@inline
def _velocity_v(links: Links, velocity: Float64, link: int, x: float, length: float) -> float:
    """Return the velocity along y of a link at a place."""
    return velocity[link, 1] + velocity[link, 2] * wrapped(x - links.pose[link, 0], length)


def _rub(grid: Grid, links: Links, water: Water, cover: Cover, before: Float64) -> None:
    """Give links the momentum that the flow carried into or out of what they cover.

    Inside a link the fluid has the link's velocity. What the transport mixes across a link's edge, in the thickness of
    about a cell, is the friction of the fluid on the link, and no momentum is lost.

    Args:
        grid: constants.
        links: links, whose velocities change.
        water: velocities after the transport.
        cover: what the links cover.
        before: (n_links, 3) velocities that the links had in the transport.
    """
    h, (n_columns, n_rows) = grid.spacing, water.u.shape
    per_velocity = grid.density * h * h
    for link in range(len(links.mass)):
        x, y, _ = links.pose[link]
        along_x = along_y = around = 0.0
        for i in range(n_columns):
            for j in range(n_rows):
                if cover.of_u[link, i, j] > 0.0:
                    mass = per_velocity * cover.of_u[link, i, j] * face_height(water, i, j)
                    at = (j + 0.5) * h + grid.floor
                    impulse = mass * (water.u[i, j] - _velocity_u(links, before, link, at))
                    along_x, around = along_x + impulse, around - impulse * (at - y)
                if cover.of_v[link, i, j] > 0.0 and 0 < j <= n_wet(water, i):
                    mass, at = per_velocity * cover.of_v[link, i, j], (i + 0.5) * h
                    impulse = mass * (water.v[i, j] - _velocity_v(links, before, link, at, n_columns * h))
                    along_y, around = along_y + impulse, around + impulse * wrapped(at - x, n_columns * h)
        links.velocity[link, 0] += along_x / links.mass[link]
        links.velocity[link, 1] += along_y / links.mass[link]
        links.velocity[link, 2] += around / links.inertia[link]


def _fill(grid: Grid, links: Links, water: Water, cover: Cover) -> None:
    """Give what links cover their velocity, and the air above the surface the velocity at the surface."""
    h, (n_columns, n_rows) = grid.spacing, water.u.shape
    for i in range(n_columns):
        for j in range(n_rows):
            if cover.open_u[i, j] < 1.0:
                water.u[i, j] *= cover.open_u[i, j]
                for link in range(len(links.mass)):
                    at = (j + 0.5) * h + grid.floor
                    water.u[i, j] += cover.of_u[link, i, j] * _velocity_u(links, links.velocity, link, at)
            if cover.open_v[i, j] < 1.0:
                water.v[i, j] *= cover.open_v[i, j]
                for link in range(len(links.mass)):
                    at = _velocity_v(links, links.velocity, link, (i + 0.5) * h, n_columns * h)
                    water.v[i, j] += cover.of_v[link, i, j] * at
        wet = max(n_wet(water, i - 1), n_wet(water, i))
        water.u[i, wet:] = water.u[i, wet - 1] if wet else 0.0
        water.v[i, n_wet(water, i) + 1 :] = water.v[i, n_wet(water, i)]


rub, fill = compiled(_rub, seconds=3), compiled(_fill, seconds=3)


class Flume:
    """Water around the links of one robot."""

    def __init__(
        self,
        length_scale: Float64,
        mass: Float64,
        inertia: Float64,
        *,
        length: float = 24.0,
        depth: float = 4.0,
        headroom: float = 2.0,
        spacing: float = 0.25,
        density: float = 1.25,
        gravity: float = 9.8,
        time_step: float = 1 / 60,
    ) -> None:
        """Fill a flume with still water.

        Args:
            length_scale: (n_links,) long axes a of the links [m]; the short ones are 1 / a.
            mass: (n_links,) [kg].
            inertia: (n_links,) moments of inertia [kg·m²].
            length: around the flume [m].
            depth: of the water [m].
            headroom: height over the water up to which the surface may rise [m].
            spacing: edge of a cell [m].
            density: of the water [kg/m²].
            gravity: [m/s²].
            time_step: [s].
        """
        n_links, n_columns = len(length_scale), max(4, round(length / spacing))
        shape = n_columns, max(1, round((depth + headroom) / spacing))
        faces = n_columns, shape[1] + 1
        self.grid = Grid(spacing, -depth, density, gravity, time_step)
        self.water = Water(np.zeros(shape), np.zeros(faces), np.full(n_columns, depth / spacing))
        pose, velocity = np.zeros((n_links, 3)), np.zeros((n_links, 3))
        self.links = Links(length_scale, 1 / length_scale, mass, inertia, pose, velocity)
        self.cover = Cover(
            np.zeros((n_links, *shape)), np.zeros((n_links, *faces)), np.ones(shape), np.ones(faces), np.ones(n_links)
        )
        self._order, self._number = cell_order(n_columns), np.empty(shape, np.int64)
        self._volume = -1.0

    def step(
        self, x: Float64, y: Float64, angle: Float64, vx: Float64, vy: Float64, omega: Float64
    ) -> tuple[Float64, Float64, Float64]:
        """Take a step, and return the changes of the links' velocities.

        The links' engine adds gravity after these changes and then moves the links.

        Args:
            x: (n_links,) [m].
            y: (n_links,) height over the mean water level [m].
            angle: (n_links,) of the long axes with the vertical [rad].
            vx: (n_links,) [m/s].
            vy: (n_links,) [m/s].
            omega: (n_links,) [rad/s].
        """
        grid, links, water, cover = self.grid, self.links, self.water, self.cover
        before = links.velocity.copy()
        links.pose[:] = np.stack((x, y, angle), axis=1)
        links.velocity[:] = np.stack((vx, vy - grid.gravity * grid.time_step, omega), axis=1)
        tentative = links.velocity.copy()
        carry(grid, water)
        cover_faces(grid, links, cover)
        rub(grid, links, water, cover, before)
        self._volume = float_links(grid, links, water, cover, self._volume)
        project(grid, links, water, cover, self._order, self._number)
        fill(grid, links, water, cover)
        dvx, dvy, domega = (links.velocity - tentative).T
        return dvx, dvy, domega
