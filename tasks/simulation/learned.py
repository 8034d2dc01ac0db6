"""Steps in a medium that networks have learned: what they read, and what they add, between two steps of an engine.

Between two steps of the engine lie only microseconds; going back to Python for each would take longer than the steps.
So an engine makes a kernel of these two, the networks' and its own. It must be a module's function and no closure: to
numba's cache a closure over kernels is another one in every process.
"""

# mypy: disallow-untyped-decorators=False

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from tasks.compiled import inline
from tasks.design.genes import N_LINKS

Indices = npt.NDArray[np.int64]


def root_rows(robot_of_lane: Indices, n_designs: int, n_rows: int) -> Indices:
    """Find the row of each lane's root among the rows of all members, one member after the other.

    Args:
        robot_of_lane: (n_lanes,) member · n_designs + design; repeats where lanes are left over.
        n_designs: robots of each member.
        n_rows: of each member.

    Returns:
        (n_lanes,)
    """
    member, design = np.divmod(robot_of_lane, n_designs)
    found: Indices = member * n_rows + design * N_LINKS
    return found


@inline
def observe(blocks: Any, root_rows: Any, observed: Any, x: Any) -> None:
    """Gather what the networks read.

    Args:
        blocks: (n_groups, n_rows, n_lanes) all robots' numbers.
        root_rows: (n_groups · n_lanes,) the root's row in x, those of all members counted through; links follow.
        observed: (n_inputs,) first rows of the quantities that networks read.
        x: (n_members, n_rows, n_inputs) room for inputs.
    """
    n_groups, _, n_lanes = blocks.shape
    inputs = x.reshape(-1, x.shape[2])
    for group in range(n_groups):
        for lane in range(n_lanes):
            first = root_rows[group * n_lanes + lane]
            for link in range(N_LINKS):
                for k in range(observed.shape[0]):
                    inputs[first + link, k] = blocks[group, observed[k] + link, lane]


@inline
def add(blocks: Any, root_rows: Any, out: Any, to_vx: int, to_vy: int, to_omega: int) -> None:
    """Scatter what the networks say: changes of vx, vy, omega, to be added to the quantities of given first rows.

    Args:
        blocks: as above; so is root_rows, in out.
        root_rows: as above.
        out: (n_members, n_rows, padded outputs) changes.
        to_vx: first row of the quantity to which the change of vx is added.
        to_vy: the same of vy.
        to_omega: the same of omega.
    """
    n_groups, _, n_lanes = blocks.shape
    changes = out.reshape(-1, out.shape[2])
    for group in range(n_groups):
        for lane in range(n_lanes):
            first = root_rows[group * n_lanes + lane]
            for link in range(N_LINKS):
                blocks[group, to_vx + link, lane] += changes[first + link, 0]
                blocks[group, to_vy + link, lane] += changes[first + link, 1]
                blocks[group, to_omega + link, lane] += changes[first + link, 2]
