"""The fluid carries its momentum along.

A second-order upwind scheme in flux form: what leaves a control volume enters the next one. Its limiter, Koren's
(1993), makes no new extremes. Covered faces take part, with the velocity of the links.
"""

# mypy: warn-return-any=False

import numpy as np

from tasks.arrays import Float64
from tasks.compiled import compiled, inline
from tasks.fluid.grid import Grid, Water

_MOST = 0.5  # most of a cell that flows through its faces in a substep
_LARGEST = 50.0  # cells in a step that a flow of 750 m/s fills: nothing sound does


@inline
def _carried(before: float, upwind: float, downwind: float, share: float) -> float:
    """Return what a flow carries through a side, of three values along it; a share of the upwind cell flows out."""
    left, right = upwind - before, downwind - upwind
    if left * right <= 0.0:
        return upwind
    slope = min(2.0 * abs(left), abs(left + 2.0 * right) / 3.0, 2.0 * abs(right))
    return upwind + (1.0 - share) / 2 * (slope if left > 0.0 else -slope)


@inline
def _through(flow: float, a: float, b: float, c: float, d: float) -> float:
    """Return what a flow takes through the side between b and c of four values in a row."""
    return flow * (_carried(a, b, c, flow) if flow > 0.0 else _carried(d, c, b, -flow))


@inline
def _flows(grid: Grid, water: Water, of_u: Float64, of_v: Float64) -> float:
    """Write what flows through the faces in a step [cells], and return the most that flows through two of a cell.

    To the half cells of the last faces along y a flow is twice as much.
    """
    of_u[:] = grid.time_step / grid.spacing * water.u
    of_v[:] = grid.time_step / grid.spacing * water.v
    of_half = np.abs(of_u[:, -1:]) + 2.0 * np.abs(of_v[:, -2:])
    return max((np.abs(of_u) + np.abs(of_v[:, :-1])).max(), of_half.max())


@inline
def _carry_u(water: Water, old: Float64, of_u: Float64, of_v: Float64, share: float, per_velocity: float) -> None:
    """Carry the momentum along x, around each left face; what leaves through y = 0 is stored, but none in a trough."""
    n_columns, n_rows = old.shape
    for i in range(n_columns):
        left, right, further = i - 1, (i + 1) % n_columns, (i + 2) % n_columns
        for j in range(n_rows):
            below, above = max(j - 1, 0), min(j + 1, n_rows - 1)
            lowest, highest = max(j - 2, 0), min(j + 2, n_rows - 1)
            west, east = share * (of_u[left, j] + of_u[i, j]) / 2, share * (of_u[i, j] + of_u[right, j]) / 2
            south, north = share * (of_v[left, j] + of_v[i, j]) / 2, share * (of_v[left, j + 1] + of_v[i, j + 1]) / 2
            if j == n_rows - 1:
                is_trough = water.rise[left] + water.rise[i] < 0.0
                north = 0.0 if is_trough else share * per_velocity * (water.outflow[left] + water.outflow[i]) / 2
                water.store[i] += north * old[i, j]
            water.u[i, j] = (
                old[i, j]
                + _through(west, old[i - 2, j], old[left, j], old[i, j], old[right, j])
                - _through(east, old[left, j], old[i, j], old[right, j], old[further, j])
                + _through(south, old[i, lowest], old[i, below], old[i, j], old[i, above])
                - _through(north, old[i, below], old[i, j], old[i, above], old[i, highest])
            )
        water.u[i, n_rows - 1] -= share * per_velocity * (water.lift[left] + water.lift[i]) / 2


@inline
def _carry_v(water: Water, old: Float64, of_u: Float64, of_v: Float64, share: float) -> None:
    """Carry the momentum along y, around each lower face; half a cell below y = 0 belongs to the last.

    What flows down into a trough brings none. What rises takes its own, or jets would grow.
    """
    n_columns, n_rows = of_u.shape
    for i in range(n_columns):
        left, right, further = i - 1, (i + 1) % n_columns, (i + 2) % n_columns
        for j in range(1, n_rows + 1):
            lowest, above, highest = max(j - 2, 0), min(j + 1, n_rows), min(j + 2, n_rows)
            west, east = of_u[i, j - 1], of_u[right, j - 1]
            if j < n_rows:
                west, east = west + of_u[i, j], east + of_u[right, j]
            west, east = share * west / 2, share * east / 2
            south, north = share * (of_v[i, j - 1] + of_v[i, j]) / 2, share * (of_v[i, j] + of_v[i, above]) / 2
            if j == n_rows and water.rise[i] < 0.0:
                north = max(north, 0.0)
            gain = (
                _through(west, old[i - 2, j], old[left, j], old[i, j], old[right, j])
                - _through(east, old[left, j], old[i, j], old[right, j], old[further, j])
                + _through(south, old[i, lowest], old[i, j - 1], old[i, j], old[i, above])
                - _through(north, old[i, j - 1], old[i, j], old[i, above], old[i, highest])
            )
            water.v[i, j] = old[i, j] + (gain if j < n_rows else 2.0 * gain)


@inline
def _share_store(grid: Grid, water: Water) -> None:
    """Let the water over y = 0 move like the water right below it; in a trough there is none.

    The grid has water in a trough that the flume has not. It came without momentum, and goes without.
    """
    for i in range(len(water.rise)):
        cells = max(water.rise[i - 1] + water.rise[i], 0.0) / (2.0 * grid.spacing)
        given = (water.store[i] - cells * water.u[i, -1]) / (1.0 + cells)
        water.u[i, -1] += given
        water.store[i] -= given


def _carry(grid: Grid, water: Water) -> None:
    """Carry the momentum of the water along for a step."""
    of_u, of_v = np.empty_like(water.u), np.empty_like(water.v)
    n_substeps = int(np.ceil(min(_flows(grid, water, of_u, of_v), _LARGEST) / _MOST))
    for _ in range(n_substeps):
        _carry_u(water, water.u.copy(), of_u, of_v, 1.0 / n_substeps, grid.time_step / grid.spacing)
        _carry_v(water, water.v.copy(), of_u, of_v, 1.0 / n_substeps)
    _share_store(grid, water)


carry = compiled(_carry, seconds=5)
