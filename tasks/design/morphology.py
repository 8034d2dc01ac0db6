"""Morphology: what a body must keep to so that it can be built. Paper, "Manufacturing".

The main experiments ask nothing of a body. The robot that was built had two actuated joints, and none of its links
overlapped another at rest unless a joint tied the two. The number of motors is built into the operators of variation;
overlap is met by drawing again (see :func:`until_apart`), so that what an operator gives is its own distribution among
the designs that are allowed. Sparing draws by moving links apart would favour the places that links are moved to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from tasks.arrays import Float64, Int64
from tasks.design.body import rest_pose
from tasks.design.genes import N_LINKS, DesignError, Designs, DesignTable
from tasks.parameters import Parameters

TOUCHING = 1e-9
"""Overlap up to which links merely touch [m]: the rounding of places within metres, and no more."""

MAX_DRAWS = 1 << 17
"""Draws of one design before it is given up. A random design takes 1,100 on average; so many fail once in 10^50."""
MOST_AT_ONCE = 4096
"""Draws that are made together; more spill out of the cache."""


class Morphology(Parameters):
    """What every design of a trial keeps to; nothing by default."""

    n_actuated: int | None = Field(default=None, ge=0, le=N_LINKS - 1)
    """Joints whose motor is on, exactly; which they are then belongs to the body and not to the controller. null lets
    every motor be on or off, as a part of the controller. [P]: 2 in the robot that was built."""
    unjoined_links: Literal["may_overlap", "apart"] = "may_overlap"
    """Whether links that no joint ties to each other may overlap at rest. [P]: apart in the robot that was built."""


ANY_BODY = Morphology()
"""Asks nothing."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """Designs that a morphology allows, and what it took to find them."""

    table: DesignTable
    """(n_designs, N_COLUMNS)"""
    n_draws: Int64
    """(n_designs,) how many were drawn for each, itself among them: n_draws - 1 were rejected."""

    @property
    def designs(self) -> Designs:
        """n_designs designs."""
        return Designs.from_table(self.table)


def links_apart(designs: Designs) -> npt.NDArray[np.bool_]:
    """Tell which designs have no two links that overlap at rest, except for links that a joint ties to each other.

    Links that touch do not overlap. By separating axes: rectangles are apart if they are along an edge of one of them.

    Args:
        designs: n_designs valid designs.

    Returns:
        (n_designs,)
    """
    x, y, angle = rest_pose(designs)
    half_height, half_width = designs.length_scale / 2, 0.5 / designs.length_scale
    links = np.stack([x, y, np.cos(angle), np.sin(angle), half_width, half_height], axis=1)
    parent = designs.parent
    left = np.arange(len(designs))
    for link in range(2, N_LINKS):  # the root and link 1 are tied
        for other in range(link):
            separate = separation(links[:, :, other], links[:, :, link]) >= -TOUCHING
            passes = separate | (parent[:, link] == other)
            left, links, parent = left[passes], links[passes], parent[passes]
    apart = np.zeros(len(designs), dtype=bool)
    apart[left] = True
    return apart


def separation(one: Float64, other: Float64) -> Float64:
    """Largest gap between two rectangles along an edge of either; negative where they overlap.

    Args:
        one: (n, 6) centre's x, y [m]; cosine, sine of the angle; half width, half height [m].
        other: (n, 6) the same.

    Returns:
        (n,) [m]
    """
    x1, y1, c1, s1, w1, h1 = one.T
    x2, y2, c2, s2, w2, h2 = other.T
    dx, dy = x2 - x1, y2 - y1
    cos, sin = np.abs(c1 * c2 + s1 * s2), np.abs(s2 * c1 - c2 * s1)  # of the angle between them
    along_one = np.maximum(
        np.abs(c1 * dx + s1 * dy) - (w1 + w2 * cos + h2 * sin), np.abs(c1 * dy - s1 * dx) - (h1 + w2 * sin + h2 * cos)
    )
    along_other = np.maximum(
        np.abs(c2 * dx + s2 * dy) - (w2 + w1 * cos + h1 * sin), np.abs(c2 * dy - s2 * dx) - (h2 + w1 * sin + h1 * cos)
    )
    gap: Float64 = np.maximum(along_one, along_other)
    return gap


def until_apart(
    first: DesignTable,
    draw: Callable[[Int64], DesignTable],
    *,
    max_draws: int = MAX_DRAWS,
    otherwise: DesignTable | None = None,
) -> Drawn:
    """Draw those designs again whose unjoined links overlap.

    Each that is left gets twice as many draws as in the round before, and takes the first that is apart.

    Args:
        first: (n_designs, N_COLUMNS) the first draw of each.
        draw: gives one design for each index that it is called with; an index may come several times.
        max_draws: of each design.
        otherwise: (n_designs, N_COLUMNS) what to take after so many.

    Raises:
        DesignError: none of max_draws draws of a design is apart, and there is nothing to take instead.
    """
    n_designs = len(first)
    n_draws = np.ones(n_designs, dtype=np.int64)
    found, place = [first], np.arange(n_designs)
    waiting = np.flatnonzero(~links_apart(Designs.from_table(first)))
    n_found, n_drawn, each = n_designs, 1, 1
    while waiting.size and n_drawn < max_draws:
        each = max(1, min(2 * each, MOST_AT_ONCE // waiting.size, max_draws - n_drawn))
        drawn = draw(np.repeat(waiting, each))
        apart = links_apart(Designs.from_table(drawn)).reshape(waiting.size, each)
        lucky, chosen = apart.any(axis=1), apart.argmax(axis=1)
        n_draws[waiting] += np.where(lucky, chosen + 1, each)
        found.append(drawn[(np.arange(waiting.size) * each + chosen)[lucky]])
        place[waiting[lucky]] = n_found + np.arange(lucky.sum())
        n_found, n_drawn, waiting = n_found + int(lucky.sum()), n_drawn + each, waiting[~lucky]
    if waiting.size:
        if otherwise is None:
            raise DesignError(
                f"design {waiting[0]}: links that no joint ties overlap at rest in each of {n_drawn} draws, "
                "expected one in which they are apart"
            )
        n_draws[waiting] += 1
        found.append(otherwise[waiting])
        place[waiting] = n_found + np.arange(waiting.size)
    return Drawn(np.concatenate(found)[place], n_draws)
