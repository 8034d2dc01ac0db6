"""The water that links displace."""

# mypy: warn-return-any=False

import numpy as np

from tasks.compiled import compiled, inline
from tasks.fluid.grid import Cover, Grid, Links


@inline
def displaced(links: Links, link: int) -> tuple[float, float]:
    """Compute the part of a link below y = 0, by Green's theorem around its edges.

    The line of the surface itself adds nothing: its height is 0.

    Returns:
        Area [m²] and its moment about the link's centre along x [m³].
    """
    _, y, angle = links.pose[link]
    cos, sin, length, width = np.cos(angle), np.sin(angle), links.length[link] / 2, links.width[link] / 2
    area = moment = 0.0
    for p0, q0, p1, q1 in ((1, 1, -1, 1), (-1, 1, -1, -1), (-1, -1, 1, -1), (1, -1, 1, 1)):
        x0, y0 = cos * p0 * width - sin * q0 * length, y + sin * p0 * width + cos * q0 * length
        x1, y1 = cos * p1 * width - sin * q1 * length, y + sin * p1 * width + cos * q1 * length
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


def _float(grid: Grid, links: Links, cover: Cover) -> None:
    """Push links by the pressure of still water, -ρ g y, on what of them is under water (Archimedes)."""
    for link in range(len(links.mass)):
        area, moment = displaced(links, link)
        per_area = cover.single[link] * grid.density * grid.gravity * grid.time_step
        links.velocity[link, 1] += per_area * area / links.mass[link]
        links.velocity[link, 2] += per_area * moment / links.inertia[link]


float_links = compiled(_float, seconds=3)
