"""The staggered grid of a flume, and what of it is water.

Harlow and Welch (1965): velocities along x are at the middle of the vertical faces of cells, those along y at the
middle of the horizontal ones. The flume closes upon itself along x. The surface is that of linear waves (Newman 1977,
"Marine Hydrodynamics", chapter 6): it rises and falls, and its weight presses on the plane y = 0, where the grid ends.
The momentum of what is over that plane is stored beside the grid.
"""

# mypy: warn-return-any=False

from typing import NamedTuple

import numpy as np

from tasks.arrays import Float64, Int64


class Grid(NamedTuple):
    """Constants of a flume."""

    spacing: float  # h, edge of a cell [m]
    floor: float  # height of the floor; the surface is at 0 [m]
    density: float  # ρ of the fluid [kg/m²]
    gravity: float  # [m/s²]
    time_step: float  # [s]


class Water(NamedTuple):
    """State of the fluid; where links are, the velocity is theirs, in proportion to what they cover of a face."""

    u: Float64  # (n_columns, n_rows) velocity along x at the left faces of cells [m/s]
    v: Float64  # (n_columns, n_rows + 1) velocity along y at the lower faces of cells [m/s]
    rise: Float64  # (n_columns,) of the surface over y = 0 [m]
    store: Float64  # (n_columns,) momentum along x of the water over y = 0 at left faces, per mass of a cell [m/s]
    outflow: Float64  # (n_columns,) of water up through y = 0 [m/s]
    lift: Float64  # (n_columns,) share of links in y = 0, by their velocities up and along x [m²/s²]


class Links(NamedTuple):
    """Rectangles of the same robot; arrays of (n_links,)."""

    length: Float64  # long axis [m], upright at angle 0
    width: Float64  # [m]
    mass: Float64  # [kg]
    inertia: Float64  # [kg·m²]
    pose: Float64  # (n_links, 3) x, y [m], angle [rad]
    velocity: Float64  # (n_links, 3) of these


class Cover(NamedTuple):
    """What links cover of the faces."""

    of_u: Float64  # (n_links, n_columns, n_rows) share of each left face that counts as a link's
    of_v: Float64  # (n_links, n_columns, n_rows + 1) the same of lower faces
    open_u: Float64  # (n_columns, n_rows) share of each left face that is open
    open_v: Float64  # (n_columns, n_rows + 1)
    single: Float64  # (n_links,) share of each link that is its own where links overlap


def cell_order(n_columns: int, last: int) -> Int64:
    """Return columns from both sides to the last, so that neighbours around the flume are at most two places apart."""
    order = np.empty(n_columns, np.int64)
    order[0::2] = np.arange((n_columns + 1) // 2)
    order[1::2] = np.arange(n_columns - 1, (n_columns + 1) // 2 - 1, -1)
    return (order + last - n_columns // 2) % n_columns
