"""A flume: a ring of water in which rigid links move.

The flume closes upon itself along x, so momentum along x and volume are conserved without a bank that reflects waves
or a window that follows. A robot that goes around it meets its own wake.
"""

# mypy: warn-return-any=False

from functools import lru_cache

import numpy as np
from scipy.ndimage import map_coordinates

from tasks.arrays import Float64
from tasks.compiled import compiled, inline
from tasks.fluid.buoyancy import float_links
from tasks.fluid.cover import cover_faces
from tasks.fluid.grid import Cover, Grid, Links, Water, cell_order
from tasks.fluid.pressure import project, push, wrapped
from tasks.fluid.transport import carry


@inline
def _velocity_u(links: Links, velocity: Float64, link: int, y: float) -> float:
    """Return the velocity along x of a link at a height."""
    return velocity[link, 0] - velocity[link, 2] * (y - links.pose[link, 1])


@inline
def _velocity_v(links: Links, velocity: Float64, link: int, x: float, length: float) -> float:
    """Return the velocity along y of a link at a place."""
    return velocity[link, 1] + velocity[link, 2] * wrapped(x - links.pose[link, 0], length)


@inline
def _earlier(velocity: Float64, turn: Float64, link: int, x: float, y: float) -> tuple[float, float]:
    """Return the velocity that what a link has at x, y from its centre had before the link turned.

    To take the link's velocity field at the place instead would be a centrifugal force on what is under water, which
    cancels only if all of the link is.
    """
    cos, sin, omega = np.cos(turn[link]), np.sin(turn[link]), velocity[link, 2]
    return velocity[link, 0] - omega * (cos * y - sin * x), velocity[link, 1] + omega * (cos * x + sin * y)


def _rub(grid: Grid, links: Links, water: Water, cover: Cover, before: Float64, turn: Float64) -> None:
    """Give links the momentum that the flow carried into or out of what they cover.

    Inside a link the fluid has the link's velocity. What the transport mixes across a link's edge, in the thickness of
    about a cell, is the friction of the fluid on the link, and no momentum is lost.

    Args:
        grid: constants.
        links: links, whose velocities change.
        water: velocities after the transport.
        cover: what the links cover.
        before: (n_links, 3) velocities that the links had in the transport.
        turn: (n_links,) angles by which they turned since.
    """
    h, (n_columns, n_rows) = grid.spacing, water.u.shape
    per_velocity, length, n_links = grid.density * h * h, n_columns * h, len(links.mass)
    for i in range(n_columns):
        x = (i + 0.5) * h
        for j in range(n_rows + 1):
            y = (j + 0.5) * h + grid.floor
            if j < n_rows and cover.open_u[i, j] < 1.0:
                slip = (1.0 - cover.open_u[i, j]) * water.u[i, j]
                for link in range(n_links):
                    along, up = wrapped(i * h - links.pose[link, 0], length), y - links.pose[link, 1]
                    slip -= cover.of_u[link, i, j] * _earlier(before, turn, link, along, up)[0]
                slip *= per_velocity / (1.0 - cover.open_u[i, j])
                for link in range(n_links):
                    arm = links.pose[link, 1] - y
                    push(links, link, 0, cover.of_u[link, i, j] * slip, arm)
            if j > 0 and cover.open_v[i, j] < 1.0:
                slip = (1.0 - cover.open_v[i, j]) * water.v[i, j]
                for link in range(n_links):
                    along, up = wrapped(x - links.pose[link, 0], length), j * h + grid.floor - links.pose[link, 1]
                    slip -= cover.of_v[link, i, j] * _earlier(before, turn, link, along, up)[1]
                slip *= per_velocity * (1.0 if j < n_rows else 0.5) / (1.0 - cover.open_v[i, j])
                for link in range(n_links):
                    arm = wrapped(x - links.pose[link, 0], length)
                    push(links, link, 1, cover.of_v[link, i, j] * slip, arm)


def _fill(grid: Grid, links: Links, water: Water, cover: Cover) -> None:
    """Let the surface rise, and give what links cover their velocity."""
    h, (n_columns, n_rows) = grid.spacing, water.u.shape
    for i in range(n_columns):
        water.outflow[i] = cover.open_v[i, n_rows] * water.v[i, n_rows]
        water.rise[i] += grid.time_step * water.outflow[i]
        water.lift[i] = 0.0
        for link in range(len(links.mass)):
            up = cover.of_v[link, i, n_rows] * _velocity_v(links, links.velocity, link, (i + 0.5) * h, n_columns * h)
            water.lift[i] += up * _velocity_u(links, links.velocity, link, 0.0)
        for j in range(n_rows + 1):
            if j < n_rows and cover.open_u[i, j] < 1.0:
                water.u[i, j] *= cover.open_u[i, j]
                for link in range(len(links.mass)):
                    at = (j + 0.5) * h + grid.floor
                    water.u[i, j] += cover.of_u[link, i, j] * _velocity_u(links, links.velocity, link, at)
            if cover.open_v[i, j] < 1.0:
                water.v[i, j] *= cover.open_v[i, j]
                for link in range(len(links.mass)):
                    at = _velocity_v(links, links.velocity, link, (i + 0.5) * h, n_columns * h)
                    water.v[i, j] += cover.of_v[link, i, j] * at


rub, fill = compiled(_rub, seconds=3), compiled(_fill, seconds=3)


@lru_cache(maxsize=8)
def _eliminated(grid: Grid, n_columns: int) -> tuple[Float64, Float64, Float64]:
    """Return A of open water after the elimination, its rows over their diagonal, and a place for A with links.

    Flumes of a grid share them: a place of its own in each step would cost as much as the elimination.
    """
    shape = n_columns, round(-grid.floor / grid.spacing)
    faces = n_columns, shape[1] + 1
    water = Water(np.zeros(shape), np.zeros(faces), *np.zeros((4, n_columns)))
    links = Links(*np.zeros((4, 0)), *np.zeros((2, 0, 3)))
    cover = Cover(np.zeros((0, *shape)), np.zeros((0, *faces)), np.ones(shape), np.ones(faces), np.ones(0))
    number, band = np.empty(shape, np.int64), np.zeros((n_columns * shape[1], 2 * shape[1] + 1))
    project(grid, links, water, cover, cell_order(n_columns, 0), number, band, np.zeros_like(band), False)
    return band, band / band[:, :1], np.empty_like(band)


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
        spacing: float = 0.125,
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
            depth: of the water, to the nearest cell [m].
            spacing: edge of a cell [m].
            density: of the water [kg/m²].
            gravity: [m/s²].
            time_step: [s].
        """
        n_links, n_columns = len(length_scale), max(4, round(length / spacing))
        shape = n_columns, max(1, round(depth / spacing))
        faces = n_columns, shape[1] + 1
        self.grid = Grid(spacing, -spacing * shape[1], density, gravity, time_step)
        self.water = Water(np.zeros(shape), np.zeros(faces), *np.zeros((4, n_columns)))
        pose, velocity = np.zeros((n_links, 3)), np.zeros((n_links, 3))
        self.links = Links(length_scale, 1 / length_scale, mass, inertia, pose, velocity)
        self.cover = Cover(
            np.zeros((n_links, *shape)), np.zeros((n_links, *faces)), np.ones(shape), np.ones(faces), np.ones(n_links)
        )
        self._number = np.empty(shape, np.int64)
        self._open_water, self._factor, self._band = _eliminated(self.grid, n_columns)

    @property
    def length(self) -> float:
        """Around the flume [m]."""
        return len(self.water.rise) * self.grid.spacing

    @property
    def surface(self) -> Float64:
        """(n_columns, 2) x, y of the surface [m]."""
        rise = self.water.rise
        return np.stack(((np.arange(len(rise)) + 0.5) * self.grid.spacing, rise), axis=1)

    def places(self, every: float) -> Float64:
        """Return (n_places, 2) x, y over all of the water, in rows at a distance [m], every other one shifted."""
        y, x = np.mgrid[self.grid.floor + every / 2 : 0.0 : every, 0.0 : self.length : every]
        x += every / 2 * (np.arange(len(x)) % 2)[:, None]
        return np.stack((x.ravel(), y.ravel()), axis=1)

    def carried(self, places: Float64) -> Float64:
        """Return where what floats at (n_places, 2) x, y [m] is a step later; it stays between floor and surface."""
        (x, y), (grid, water) = places.T, (self.grid, self.water)
        n_rows, column, row = water.u.shape[1], x / grid.spacing, (y - grid.floor) / grid.spacing
        at_u, at_v = (column, np.clip(row - 0.5, 0, n_rows - 1)), (column - 0.5, np.clip(row, 0, n_rows))
        u = map_coordinates(water.u, at_u, order=1, mode="grid-wrap")
        v = map_coordinates(water.v, at_v, order=1, mode="grid-wrap")
        x = x + grid.time_step * u
        surface = self.surface
        top = np.interp(x, surface[:, 0], surface[:, 1], period=self.length)
        return np.stack((x, np.clip(y + grid.time_step * v, grid.floor, top)), axis=1)

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
        before, turn = links.velocity.copy(), angle - links.pose[:, 2]
        links.pose[:] = np.stack((x, y, angle), axis=1)
        links.velocity[:] = np.stack((vx, vy - grid.gravity * grid.time_step, omega), axis=1)
        tentative = links.velocity.copy()
        carry(grid, water)
        cover_faces(grid, links, cover)
        rub(grid, links, water, cover, before, turn)
        float_links(grid, links, cover)
        order = cell_order(len(water.rise), round(links.pose[:, 0].mean() / grid.spacing))
        self._band[:] = self._open_water
        project(grid, links, water, cover, order, self._number, self._band, self._factor, True)
        fill(grid, links, water, cover)
        dvx, dvy, domega = (links.velocity - tentative).T
        return dvx, dvy, domega
