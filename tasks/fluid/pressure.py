"""The pressure that makes the fluid incompressible and pushes the links.

Batty, Bertails and Bridson (2007, "A fast variational framework for accurate solid-fluid coupling"): of all velocities
of the fluid and the links that neither open nor close a cell, those are taken that are nearest to the tentative ones,
weighed by mass. With velocities u of the open parts of faces, of masses m, and V of the links, of masses M,

    D u + Kᵀ V = 0        the volume that flows out of each cell, by the fluid and by the links,
    u = u* + m⁻¹ Dᵀ p     the impulse of the pressure on the fluid,
    V = V* + M⁻¹ K p      the impulse of the pressure on the links,

    so A p = -D u* - Kᵀ V with A = D m⁻¹ Dᵀ, and (M + K A⁻¹ Kᵀ) V = M V* - K A⁻¹ D u*.

K A⁻¹ Kᵀ is the added mass. Both systems are solved by elimination: A is a band, and links are few. The elimination
begins on the other side of the flume and ends at the links, so that its first part is always that of open water.
"""

# mypy: warn-return-any=False

import numpy as np

from tasks.arrays import Float64, Int64
from tasks.compiled import compiled, inline
from tasks.fluid.grid import Cover, Grid, Links, Water

_LEAK = 0.01  # what of a face leads from a cell that links cover out of the fluid: pockets that they squeeze give way


@inline
def _eliminate(band: Float64, right: Float64, first: int) -> None:
    """Eliminate what is below the diagonal of a symmetric matrix: ``band[i, k]`` is the element (i, i + k).

    The rows before the first are done.
    """
    n, width = band.shape
    for i in range(first, n):
        for k in range(1, min(width, n - i)):
            factor = band[i, k] / band[i, 0]
            if factor != 0.0:
                for m in range(width - k):
                    band[i + k, m] -= factor * band[i, k + m]
                for column in range(right.shape[1]):
                    right[i + k, column] -= factor * right[i, column]


@inline
def _eliminate_known(band: Float64, factor: Float64, right: Float64, n_known: int) -> None:
    """Eliminate the first rows, whose band is known after that, and which have only the first right-hand side."""
    n, width = band.shape
    flow = right[:, 0].copy()
    for i in range(n_known):
        here, below = flow[i], flow[i + 1 : i + width]
        for k in range(len(below)):
            below[k] -= factor[i, 1 + k] * here
        for k in range(n_known - i, min(width, n - i)):
            for m in range(width - k):
                band[i + k, m] -= factor[i, k] * band[i, k + m]
    right[:, 0] = flow


@inline
def _substitute(band: Float64, right: Float64) -> None:
    """Replace one right-hand side by the solution, after the elimination."""
    n, width = band.shape
    for i in range(n - 1, -1, -1):
        for k in range(1, min(width, n - i)):
            right[i] -= band[i, k] * right[i + k]
        right[i] /= band[i, 0]


@inline
def _count(cover: Cover, order: Int64, number: Int64) -> tuple[int, int]:
    """Write the numbers of the cells that have a pressure, -1 for others.

    Returns:
        How many there are, and how many come before the first column of cells that links touch.
    """
    n, n_before, is_before = 0, 0, True
    number[:] = -1
    for i in order:
        right = (i + 1) % len(order)
        is_before = (
            is_before and min(cover.open_u[i].min(), cover.open_u[right].min(), cover.open_v[i, 1:].min()) == 1.0
        )
        for j in range(number.shape[1]):
            top = cover.open_v[i, j + 1]
            if cover.open_u[i, j] + cover.open_u[right, j] + cover.open_v[i, j] + top > 0.0:
                number[i, j] = n
                n += 1
        if is_before:
            n_before = n
    return n, n_before


@inline
def _add_face(
    band: Float64, right: Float64, n_known: int, lower: int, upper: int, flow: float, area_by_mass: float
) -> None:
    """Add the open part of a face between two cells, -1 for the air: its flow, and its area² / mass."""
    if lower >= 0:
        right[lower, 0] -= flow
    if upper >= 0:
        right[upper, 0] += flow
    if lower >= n_known:
        band[lower, 0] += area_by_mass
    if upper >= n_known:
        band[upper, 0] += area_by_mass
    if min(lower, upper) >= n_known:
        band[min(lower, upper), abs(upper - lower)] -= area_by_mass


@inline
def _add_links(right: Float64, lower: int, upper: int, link: int, part: int, area: float, arm: float) -> None:
    """Add a link's part of a face: its area times its velocity along x (part 0) or y (part 1), and by its rotation."""
    for column, flow in ((1 + 3 * link + part, area), (3 + 3 * link, area * arm)):
        if lower >= 0:
            right[lower, column] += flow
        if upper >= 0:
            right[upper, column] -= flow


@inline
def push(links: Links, link: int, part: int, impulse: float, arm: float) -> None:
    """Push a link by an impulse along x (part 0) or y (part 1), with its arm about the link's centre."""
    links.velocity[link, part] += impulse / links.mass[link]
    links.velocity[link, 2] += impulse * arm / links.inertia[link]


@inline
def wrapped(distance: float, length: float) -> float:
    """Return the shortest distance around a flume of a length."""
    return distance - length * np.round(distance / length)


@inline
def _assemble(
    grid: Grid, links: Links, water: Water, cover: Cover, number: Int64, band: Float64, right: Float64, n_known: int
) -> None:
    """Write A to ``band``, and -D u* and the columns of Kᵀ to ``right``; subtract the pressure of the surface from u*.

    Pressures are over those of still water, -ρ g y: the rise of the surface is what drives the water, and still water
    is still.
    """
    h, (n_columns, n_rows) = grid.spacing, water.u.shape
    for i in range(n_columns):
        water.v[i, n_rows] -= grid.gravity * grid.time_step * water.rise[i] / (h / 2)
        for j in range(n_rows):
            lower, upper, opening = number[i - 1, j], number[i, j], cover.open_u[i, j]
            _add_face(band, right, n_known, lower, upper, h * opening * water.u[i, j], opening / grid.density)
            for link in range(len(links.length)):
                if cover.of_u[link, i, j] > 0.0:
                    arm = links.pose[link, 1] - grid.floor - (j + 0.5) * h
                    _add_links(right, lower, upper, link, 0, h * cover.of_u[link, i, j], arm)
            if upper >= n_known:
                right_u, bottom = cover.open_u[(i + 1) % n_columns, j], cover.open_v[i, j] if j else 1.0
                open_part = (opening + right_u + bottom + cover.open_v[i, j + 1]) / 4
                band[upper, 0] += _LEAK / grid.density * (1.0 - open_part)
        for j in range(1, n_rows + 1):
            lower, upper, opening = number[i, j - 1], number[i, j] if j < n_rows else -1, cover.open_v[i, j]
            reach = 1.0 if j < n_rows else 0.5
            _add_face(band, right, n_known, lower, upper, h * opening * water.v[i, j], opening / (grid.density * reach))
            for link in range(len(links.length)):
                if cover.of_v[link, i, j] > 0.0:
                    arm = wrapped((i + 0.5) * h - links.pose[link, 0], n_columns * h)
                    _add_links(right, lower, upper, link, 1, h * cover.of_v[link, i, j], arm)


@inline
def _push_links(links: Links, band: Float64, right: Float64, n_known: int) -> None:
    """Solve for the velocities of the links, after the elimination."""
    n = 3 * len(links.length)
    system, impulse = np.zeros((n, n)), np.zeros((n, 1))
    for link in range(len(links.length)):
        for part in range(3):
            mass = links.inertia[link] if part == 2 else links.mass[link]
            system[3 * link + part, 0] = mass
            impulse[3 * link + part, 0] = mass * links.velocity[link, part]
    for cell in range(n_known, len(band)):
        for a in range(n):
            of_a = right[cell, 1 + a] / band[cell, 0]
            if of_a != 0.0:
                impulse[a, 0] += of_a * right[cell, 0]
                for b in range(a, n):
                    system[a, b - a] += of_a * right[cell, 1 + b]
    _eliminate(system, impulse, 0)
    _substitute(system, impulse[:, 0])
    for link in range(len(links.length)):
        for part in range(3):
            links.velocity[link, part] = impulse[3 * link + part, 0]


@inline
def _push_water(grid: Grid, water: Water, number: Int64, pressure: Float64) -> None:
    """Add the impulse of the pressure to the open parts of faces."""
    n_columns, n_rows = number.shape
    per_pressure = 1.0 / (grid.density * grid.spacing)
    for i in range(n_columns):
        for j in range(n_rows):
            lower = pressure[number[i - 1, j]] if number[i - 1, j] >= 0 else 0.0
            here = pressure[number[i, j]] if number[i, j] >= 0 else 0.0
            below = pressure[number[i, j - 1]] if j and number[i, j - 1] >= 0 else 0.0
            water.u[i, j] += (lower - here) * per_pressure
            if j:
                water.v[i, j] += (below - here) * per_pressure
            if j == n_rows - 1:
                water.v[i, n_rows] += here * per_pressure / 0.5


def _project(
    grid: Grid,
    links: Links,
    water: Water,
    cover: Cover,
    order: Int64,
    number: Int64,
    band: Float64,
    factor: Float64,
    is_known: bool,
) -> None:
    """Replace tentative velocities of the fluid and the links by those without divergence.

    Args:
        grid: constants.
        links: links, whose velocities change.
        water: fluid, whose velocities change.
        cover: what the links cover.
        order: columns of cells in the order of elimination, links last.
        number: (n_columns, n_rows) place for the numbers of the cells.
        band: (n_columns · n_rows, 2 · n_rows + 1) A after the elimination; where is_known, first of open water.
        factor: (n_columns · n_rows, 2 · n_rows + 1) of rows in the elimination of open water.
        is_known: whether the elimination begins where links are.
    """
    n, n_known = _count(cover, order, number)
    if not is_known:
        n_known = 0
    band, right = band[:n], np.zeros((n, 1 + 3 * len(links.length)))
    band[n_known:] = 0.0
    _assemble(grid, links, water, cover, number, band, right, n_known)
    _eliminate_known(band, factor, right, n_known)
    _eliminate(band, right, n_known)
    _push_links(links, band, right, n_known)
    for link in range(len(links.length)):
        for part in range(3):
            right[:, 0] -= links.velocity[link, part] * right[:, 1 + 3 * link + part]
    pressure = right[:, 0].copy()
    _substitute(band, pressure)
    _push_water(grid, water, number, pressure)


project = compiled(_project, seconds=5)
