"""What links cover of the faces of the grid, and how much of a link is under water."""

# mypy: warn-return-any=False

import numpy as np

from tasks.arrays import Float64
from tasks.compiled import compiled, inline
from tasks.fluid.grid import Cover, Grid, Links

_SOFT = 0.125  # half of the least length over which a face becomes covered [spacings]; see covered
_CLOSED = 0.25  # a cell whose four faces are open by less in sum is solid


@inline
def _overlap(centre: float, half: float, length: float) -> float:
    """Return the share of an interval, by its centre and half length, that lies within length / 2 of 0."""
    return max(0.0, min(centre + half, length / 2) - max(centre - half, -length / 2)) / (2 * half)


@inline
def covered(along: float, across: float, cos: float, sin: float, length: float, width: float, h: float) -> float:
    """Return the share of a face that a link covers, by the share of the face's projections on the link's axes.

    It is exact for faces along an axis of the link and for those that one edge cuts. Ng, Min and Gibou (2009, "An
    efficient fluid-solid coupling algorithm for single-phase flows") show why shares of faces and not of cells: a plate
    little thicker than a cell must not leak. An edge along a face covers it within a quarter of a spacing, not at once.

    Args:
        along: place of the middle of the face along the link's long axis, from the link's centre [m].
        across: the same across it.
        cos: cosine of the angle between the face and the link's long axis.
        sin: sine of that angle.
        length: of the link [m].
        width: of the link [m].
        h: length of the face [m].
    """
    half_along, half_across = h * max(abs(cos) / 2, _SOFT), h * max(abs(sin) / 2, _SOFT)
    return _overlap(along, half_along, length) * _overlap(across, half_across, width)


@inline
def _cover_of_link(grid: Grid, links: Links, link: int, cover: Cover) -> None:
    """Write what a link covers by itself."""
    h, (n_columns, n_rows) = grid.spacing, cover.open_u.shape
    x, y, angle = links.pose[link]
    length, width, cos, sin = links.length[link], links.width[link], np.cos(angle), np.sin(angle)
    y -= grid.floor
    reach_x, reach_y = (abs(sin) * length + abs(cos) * width) / 2 + h, (abs(cos) * length + abs(sin) * width) / 2 + h
    for i in range(int(np.floor((x - reach_x) / h)), int(np.ceil((x + reach_x) / h)) + 1):
        column = i % n_columns
        for row in range(max(0, int(np.floor((y - reach_y) / h))), min(n_rows, int(np.ceil((y + reach_y) / h))) + 1):
            dx, dy = i * h - x, (row + 0.5) * h - y  # of the left face; then of the lower one
            if row < n_rows:
                share = covered(cos * dy - sin * dx, cos * dx + sin * dy, cos, sin, length, width, h)
                cover.of_u[link, column, row] = max(share, cover.of_u[link, column, row])
            dx, dy = dx + h / 2, dy - h / 2
            share = covered(cos * dy - sin * dx, cos * dx + sin * dy, sin, cos, length, width, h)
            cover.of_v[link, column, row] = max(share, cover.of_v[link, column, row])


@inline
def _close(of: Float64, opening: Float64, column: int, row: int) -> None:
    """Close a face; the links that cover most of it cover all of it."""
    of[:, column, row] /= 1.0 - opening[column, row]
    opening[column, row] = 0.0


def _cover(grid: Grid, links: Links, cover: Cover) -> None:
    """Write what links cover, all and each.

    Where links overlap, the fluid meets their union: a face is as closed as by the link that covers most of it, and
    counts as the links' in proportion to what each covers.
    """
    cover.of_u[:], cover.of_v[:] = 0.0, 0.0
    for link in range(len(links.length)):
        _cover_of_link(grid, links, link, cover)
    (n_columns, n_rows), n_links = cover.open_u.shape, len(links.length)
    cover.open_u[:], cover.open_v[:] = 1.0, 1.0
    for link in range(n_links):
        for i in range(n_columns):
            for j in range(n_rows + 1):
                if j < n_rows:
                    cover.open_u[i, j] = min(cover.open_u[i, j], 1.0 - cover.of_u[link, i, j])
                cover.open_v[i, j] = min(cover.open_v[i, j], 1.0 - cover.of_v[link, i, j])
    alone, own = np.zeros(n_links), np.zeros(n_links)
    for of, opening in ((cover.of_u, cover.open_u), (cover.of_v, cover.open_v)):
        for i in range(n_columns):
            for j in range(opening.shape[1]):
                if opening[i, j] < 1.0:
                    total = of[:, i, j].sum()
                    for link in range(n_links):
                        alone[link] += of[link, i, j]
                        of[link, i, j] *= (1.0 - opening[i, j]) / total
                        own[link] += of[link, i, j]
    for link in range(n_links):
        cover.single[link] = own[link] / alone[link] if alone[link] > 0.0 else 1.0
    open_u, open_v = cover.open_u.copy(), cover.open_v.copy()
    for i in range(n_columns):
        right = (i + 1) % n_columns
        for j in range(n_rows):
            if open_u[i, j] + open_u[right, j] + open_v[i, j] + open_v[i, j + 1] < _CLOSED:
                for column, row in ((i, j), (right, j)):
                    _close(cover.of_u, cover.open_u, column, row)
                for column, row in ((i, j), (i, j + 1)):
                    _close(cover.of_v, cover.open_v, column, row)
    cover.open_v[:, 0], cover.of_v[:, :, 0] = 0.0, 0.0


cover_faces = compiled(_cover, seconds=3)
