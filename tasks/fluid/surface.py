"""The water that links displace: buoyancy, and the surface around links that pierce it."""

# mypy: warn-return-any=False

import numpy as np

from tasks.compiled import compiled, inline
from tasks.fluid.grid import Cover, Grid, Links, Water, n_wet


@inline
def displaced(links: Links, link: int, surface: float) -> tuple[float, float]:
    """Compute the part of a link below a level surface, by Green's theorem around its edges.

    The line of the surface itself adds nothing: heights are counted from it.

    Returns:
        Area [m²] and its moment about the link's centre along x [m³].
    """
    _, y, angle = links.pose[link]
    cos, sin, length, width = np.cos(angle), np.sin(angle), links.length[link] / 2, links.width[link] / 2
    area = moment = 0.0
    for p0, q0, p1, q1 in ((1, 1, -1, 1), (-1, 1, -1, -1), (-1, -1, 1, -1), (1, -1, 1, 1)):
        x0, y0 = cos * p0 * width - sin * q0 * length, y - surface + sin * p0 * width + cos * q0 * length
        x1, y1 = cos * p1 * width - sin * q1 * length, y - surface + sin * p1 * width + cos * q1 * length
        if y0 >= 0.0 and y1 >= 0.0:
            continue
        if y0 >= 0.0 or y1 >= 0.0:
            cut = x0 + (x1 - x0) * y0 / (y0 - y1)
            if y1 >= 0.0:
                x1, y1 = cut, 0.0
            else:
                x0, y0 = cut, 0.0
        twice = x0 * y1 - x1 * y0
        area, moment = area + twice / 2, moment + (x0 + x1) * twice / 6
    return area, moment


@inline
def _level_at(grid: Grid, water: Water, x: float) -> float:
    """Return the height of the surface at a place [m]."""
    place = x / grid.spacing - 0.5
    left = int(np.floor(place))
    n, share = len(water.level), place - left
    level = (1.0 - share) * water.level[left % n] + share * water.level[(left + 1) % n]
    return level * grid.spacing + grid.floor


@inline
def _bridge(water: Water, cover: Cover) -> None:
    """Draw the surface straight through links that pierce it."""
    n = len(water.level)
    free = np.zeros(n, np.bool_)
    for i in range(n):
        free[i] = cover.open_v[i, n_wet(water, i)] > 0.5
    level = water.level.copy()
    for i in range(n):
        left, right = 0, 0
        while not free[(i - left) % n] and left < n:
            left += 1
        while not free[(i + right) % n] and right < n:
            right += 1
        if 0 < left < n:
            water.level[i] = (right * level[(i - left) % n] + left * level[(i + right) % n]) / (left + right)


def _float(grid: Grid, links: Links, water: Water, cover: Cover, volume: float) -> float:
    """Push links by the pressure of still water, -ρ g y, and keep the volume of the water.

    Args:
        grid: constants.
        links: links, whose velocities change.
        water: water, whose surface changes.
        cover: what the links cover.
        volume: of the water [m²]; negative to measure it.

    Returns:
        The volume.
    """
    _bridge(water, cover)
    n_columns = len(water.level)
    held = 0.0
    for link in range(len(links.mass)):
        surface = _level_at(grid, water, links.pose[link, 0])
        area, moment = displaced(links, link, surface)
        held += cover.single[link] * area
        per_area = cover.single[link] * grid.density * grid.gravity * grid.time_step
        links.velocity[link, 1] += per_area * area / links.mass[link]
        links.velocity[link, 2] += per_area * moment / links.inertia[link]
    cell = grid.spacing**2
    if volume < 0.0:
        return cell * water.level.sum() - held
    water.level[:] += (volume + held) / (cell * n_columns) - water.level.mean()
    return volume


float_links = compiled(_float, seconds=3)
