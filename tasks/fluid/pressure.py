"""The pressure that makes the fluid incompressible and pushes the links.

Batty, Bertails and Bridson (2007, "A fast variational framework for accurate solid-fluid coupling"): of all velocities
of the fluid and the links that neither open nor close a cell, those are taken that are nearest to the tentative ones,
weighed by mass. With velocities u of the open parts of faces, of masses m, and V of the links, of masses M,

    D u + Kᵀ V = 0        the volume that flows out of each cell, by the fluid and by the links,
    u = u* + m⁻¹ Dᵀ p     the impulse of the pressure on the fluid,
    V = V* + M⁻¹ K p      the impulse of the pressure on the links,

    so A p = -D u* - Kᵀ V with A = D m⁻¹ Dᵀ, and (M + K A⁻¹ Kᵀ) V = M V* - K A⁻¹ D u*.

K A⁻¹ Kᵀ is the added mass. Both systems are solved by elimination: A is a band, and links are few.
"""

# mypy: warn-return-any=False

import numpy as np

from tasks.arrays import Float64, Int64
from tasks.compiled import compiled, inline
from tasks.fluid.grid import Cover, Grid, Links, Water, face_height, n_wet

_THINNEST = 0.1  # least water between a cell's middle and the surface [spacings]


@inline
def _eliminate(band: Float64, right: Float64) -> None:
    """Eliminate what is below the diagonal of a symmetric matrix: ``band[i, k]`` is the element (i, i + k)."""
    n, width = band.shape
    for i in range(n):
        for k in range(1, min(width, n - i)):
            factor = band[i, k] / band[i, 0]
            if factor != 0.0:
                for m in range(width - k):
                    band[i + k, m] -= factor * band[i, k + m]
                for column in range(right.shape[1]):
                    right[i + k, column] -= factor * right[i, column]


@inline
def _substitute(band: Float64, right: Float64) -> None:
    """Replace one right-hand side by the solution, after the elimination."""
    n, width = band.shape
    for i in range(n - 1, -1, -1):
        for k in range(1, min(width, n - i)):
            right[i] -= band[i, k] * right[i + k]
        right[i] /= band[i, 0]


@inline
def _count(water: Water, cover: Cover, order: Int64, number: Int64) -> int:
    """Count the cells that have a pressure, and write their numbers, -1 for others."""
    n = 0
    number[:] = -1
    for i in order:
        right = (i + 1) % len(order)
        for j in range(n_wet(water, i)):
            top = cover.open_v[i, j + 1]
            if cover.open_u[i, j] + cover.open_u[right, j] + cover.open_v[i, j] + top > 0.0:
                number[i, j] = n
                n += 1
    return n


@inline
def _width(number: Int64) -> int:
    """Return the width of the band."""
    width = 1
    n_columns, n_rows = number.shape
    for i in range(n_columns):
        for j in range(n_rows):
            if number[i, j] >= 0 and number[i - 1, j] >= 0:
                width = max(width, abs(number[i, j] - number[i - 1, j]) + 1)
    return width


@inline
def _add_face(band: Float64, right: Float64, lower: int, upper: int, flow: float, area_by_mass: float) -> None:
    """Add the open part of a face between two cells, -1 for the air: its flow, and its area² / mass."""
    if lower >= 0:
        band[lower, 0] += area_by_mass
        right[lower, 0] -= flow
    if upper >= 0:
        band[upper, 0] += area_by_mass
        right[upper, 0] += flow
    if lower >= 0 and upper >= 0:
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
def _push_at_surface(links: Links, link: int, part: int, impulse: float, arm: float) -> None:
    """Push a link by the pressure of the surface along x (part 0) or y (part 1)."""
    links.velocity[link, part] += impulse / links.mass[link]
    links.velocity[link, 2] += impulse * arm / links.inertia[link]


@inline
def wrapped(distance: float, length: float) -> float:
    """Return the shortest distance around a flume of a length."""
    return distance - length * np.round(distance / length)


@inline
def _reach_u(water: Water, i: int, j: int) -> float:
    """Return the water between the middles of the cells beside a left face, or of one and the surface [spacings]."""
    left, right = water.level[i - 1], water.level[i]
    if j < min(n_wet(water, i - 1), n_wet(water, i)):
        return 1.0
    return max(_THINNEST, (max(left, right) - j - 0.5) / abs(right - left))


@inline
def _assemble(
    grid: Grid, links: Links, water: Water, cover: Cover, number: Int64, band: Float64, right: Float64
) -> None:
    """Write A to ``band``, and -D u* and the columns of Kᵀ to ``right``; subtract the pressure of the surface from u*.

    Pressures are over those of still water, -ρ g y, so gravity acts at the surface alone, and still water is still.
    """
    h, n_columns = grid.spacing, len(water.level)
    weight = grid.gravity * grid.time_step
    for i in range(n_columns):
        for j in range(max(n_wet(water, i - 1), n_wet(water, i))):
            lower, upper, area = number[i - 1, j], number[i, j], h * face_height(water, i, j)
            reach, head = h * _reach_u(water, i, j), 0.0
            if j >= n_wet(water, i - 1):
                head = weight * ((j + 0.5) * h + grid.floor)
            elif j >= n_wet(water, i):
                head = -weight * ((j + 0.5) * h + grid.floor)
            water.u[i, j] += head / reach
            area_open = area * cover.open_u[i, j]
            _add_face(band, right, lower, upper, area_open * water.u[i, j], area_open / (grid.density * reach))
            for link in range(len(links.length)):
                if cover.of_u[link, i, j] > 0.0:
                    arm = links.pose[link, 1] - grid.floor - (j + 0.5) * h
                    _add_links(right, lower, upper, link, 0, area * cover.of_u[link, i, j], arm)
                    _push_at_surface(links, link, 0, grid.density * head * area * cover.of_u[link, i, j], arm)
        n = n_wet(water, i)
        for j in range(1, n + 1):
            lower, upper, reach, head = number[i, j - 1], number[i, j] if j < n else -1, h, 0.0
            if j == n:
                reach = h * max(_THINNEST, water.level[i] - n + 0.5)
                head = -weight * (water.level[i] * h + grid.floor)
            water.v[i, j] += head / reach
            area_open = h * cover.open_v[i, j]
            _add_face(band, right, lower, upper, area_open * water.v[i, j], area_open / (grid.density * reach))
            for link in range(len(links.length)):
                if cover.of_v[link, i, j] > 0.0:
                    arm = wrapped((i + 0.5) * h - links.pose[link, 0], n_columns * h)
                    _add_links(right, lower, upper, link, 1, h * cover.of_v[link, i, j], arm)
                    _push_at_surface(links, link, 1, grid.density * head * h * cover.of_v[link, i, j], arm)


@inline
def _push_links(links: Links, band: Float64, right: Float64) -> None:
    """Solve for the velocities of the links, after the elimination."""
    n = 3 * len(links.length)
    system, impulse = np.zeros((n, n)), np.zeros((n, 1))
    for link in range(len(links.length)):
        for part in range(3):
            mass = links.inertia[link] if part == 2 else links.mass[link]
            system[3 * link + part, 0] = mass
            impulse[3 * link + part, 0] = mass * links.velocity[link, part]
    for cell in range(len(band)):
        for a in range(n):
            of_a = right[cell, 1 + a] / band[cell, 0]
            if of_a != 0.0:
                impulse[a, 0] += of_a * right[cell, 0]
                for b in range(a, n):
                    system[a, b - a] += of_a * right[cell, 1 + b]
    _eliminate(system, impulse)
    _substitute(system, impulse[:, 0])
    for link in range(len(links.length)):
        for part in range(3):
            links.velocity[link, part] = impulse[3 * link + part, 0]


@inline
def _push_water(grid: Grid, water: Water, number: Int64, pressure: Float64) -> None:
    """Add the impulse of the pressure to the open parts of faces."""
    for i in range(len(number)):
        for j in range(max(n_wet(water, i - 1), n_wet(water, i))):
            lower = pressure[number[i - 1, j]] if number[i - 1, j] >= 0 else 0.0
            upper = pressure[number[i, j]] if number[i, j] >= 0 else 0.0
            water.u[i, j] += (lower - upper) / (grid.density * grid.spacing * _reach_u(water, i, j))
        n = n_wet(water, i)
        for j in range(1, n + 1):
            lower = pressure[number[i, j - 1]] if number[i, j - 1] >= 0 else 0.0
            upper = pressure[number[i, j]] if j < n and number[i, j] >= 0 else 0.0
            reach = max(_THINNEST, water.level[i] - n + 0.5) if j == n else 1.0
            water.v[i, j] += (lower - upper) / (grid.density * grid.spacing * reach)


def _project(grid: Grid, links: Links, water: Water, cover: Cover, order: Int64, number: Int64) -> None:
    """Replace tentative velocities of the fluid and the links by those without divergence."""
    n = _count(water, cover, order, number)
    band, right = np.zeros((n, _width(number))), np.zeros((n, 1 + 3 * len(links.length)))
    _assemble(grid, links, water, cover, number, band, right)
    _eliminate(band, right)
    _push_links(links, band, right)
    for link in range(len(links.length)):
        for part in range(3):
            right[:, 0] -= links.velocity[link, part] * right[:, 1 + 3 * link + part]
    pressure = right[:, 0].copy()
    _substitute(band, pressure)
    _push_water(grid, water, number, pressure)


project = compiled(_project, seconds=5)
