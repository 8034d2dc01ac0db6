"""The fluid carries its momentum and its surface along.

A second-order upwind scheme in flux form: what leaves a control volume enters the next one. Its limiter, Koren's
(1993), makes no new extremes. Covered faces take part, with the velocity of the links.
"""

# mypy: warn-return-any=False

import numpy as np

from tasks.arrays import Float64
from tasks.compiled import compiled, inline
from tasks.fluid.grid import Grid, Water, face_height, n_wet

_MOST = 0.5  # most of a cell that flows through its faces in a substep


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
    """Write what flows through the faces in a step [cells], and return the most that flows out of or into a cell."""
    share, most = grid.time_step / grid.spacing, 0.0
    n_columns = len(water.level)
    of_u[:], of_v[:] = 0.0, 0.0
    for i in range(n_columns):
        for j in range(max(n_wet(water, i - 1), n_wet(water, i))):
            of_u[i, j] = share * face_height(water, i, j) * water.u[i, j]
        for j in range(1, n_wet(water, i)):
            of_v[i, j] = share * water.v[i, j]
            most = max(most, abs(of_u[i, j]) + abs(of_v[i, j]))
    return most


@inline
def _after(value: float, mass: float, out: float, carried_out: float) -> float:
    """Return the value of a control volume after flows out of it, which carry values away."""
    return value + (value * out - carried_out) / max(mass - out, 0.5)


@inline
def _carry_u(water: Water, old: Float64, of_u: Float64, of_v: Float64, share: float) -> None:
    """Carry the momentum along x, around each left face."""
    n_columns, n_rows = old.shape
    for i in range(n_columns):
        left, right = i - 1, (i + 1) % n_columns
        for j in range(max(n_wet(water, left), n_wet(water, i))):
            west, east = share * (of_u[left, j] + of_u[i, j]) / 2, share * (of_u[i, j] + of_u[right, j]) / 2
            south, north = share * (of_v[left, j] + of_v[i, j]) / 2, share * (of_v[left, j + 1] + of_v[i, j + 1]) / 2
            further, below, above = (i + 2) % n_columns, max(j - 1, 0), min(j + 1, n_rows - 1)
            lowest, highest = max(j - 2, 0), min(j + 2, n_rows - 1)
            here = old[i, j]
            carried = (
                _through(east, old[left, j], here, old[right, j], old[further, j])
                - _through(west, old[i - 2, j], old[left, j], here, old[right, j])
                + _through(north, old[i, below], here, old[i, above], old[i, highest])
                - _through(south, old[i, lowest], old[i, below], here, old[i, above])
            )
            water.u[i, j] = _after(here, face_height(water, i, j), east - west + north - south, carried)


@inline
def _carry_v(water: Water, old: Float64, of_u: Float64, of_v: Float64, share: float) -> None:
    """Carry the momentum along y, around each lower face."""
    n_columns, n_rows = of_u.shape
    for i in range(n_columns):
        left, right, further = i - 1, (i + 1) % n_columns, (i + 2) % n_columns
        n = n_wet(water, i)
        for j in range(1, n + 1):
            top = min(j, n_rows - 1)
            west, east = (
                share * (of_u[i, j - 1] + of_u[i, top]) / 2,
                share * (of_u[right, j - 1] + of_u[right, top]) / 2,
            )
            south, north = share * (of_v[i, j - 1] + of_v[i, j]) / 2, share * (of_v[i, j] + of_v[i, min(j + 1, n)]) / 2
            if j == n:
                north = 0.0
            lowest, above, highest = max(j - 2, 0), min(j + 1, n_rows), min(j + 2, n_rows)
            here = old[i, j]
            carried = (
                _through(east, old[left, j], here, old[right, j], old[further, j])
                - _through(west, old[i - 2, j], old[left, j], here, old[right, j])
                + _through(north, old[i, j - 1], here, old[i, above], old[i, highest])
                - _through(south, old[i, lowest], old[i, j - 1], here, old[i, above])
            )
            mass = water.level[i] - n + 0.5 if j == n else 1.0
            water.v[i, j] = _after(here, mass, east - west + north - south, carried)


def _carry(grid: Grid, water: Water) -> None:
    """Carry the momentum and the surface along for a step."""
    of_u, of_v = np.empty_like(water.u), np.empty_like(water.v)
    n_substeps = int(np.ceil(_flows(grid, water, of_u, of_v) / _MOST))
    for _ in range(n_substeps):
        _carry_u(water, water.u.copy(), of_u, of_v, 1.0 / n_substeps)
        _carry_v(water, water.v.copy(), of_u, of_v, 1.0 / n_substeps)
    for i in range(len(water.level)):
        right = (i + 1) % len(water.level)
        for j in range(water.u.shape[1]):
            water.level[i] += of_u[i, j] - of_u[right, j]


carry = compiled(_carry, seconds=5)
