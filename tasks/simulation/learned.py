"""Steps in a medium that networks have learned: what they read, and what they add, between two steps of an engine.

Between two steps of the engine lie only microseconds; going back to Python for each would take longer than the steps.
So an engine makes a kernel of these two, the networks' and its own. It must be a module's function and no closure: to
numba's cache a closure over kernels is another one in every process.
"""

# mypy: disallow-untyped-decorators=False

from __future__ import annotations

from typing import Any

import numba

from tasks.compiled import inline
from tasks.design.genes import N_LINKS


@inline
def observe(blocks: Any, robot_of_lane: Any, n_designs: int, observed: Any, x: Any) -> None:
    """Gather what the networks read.

    Args:
        blocks: (n_groups, n_rows, n_lanes) all robots' numbers.
        robot_of_lane: (n_groups · n_lanes,) member · n_designs + design; repeats where lanes are left over.
        n_designs: robots of each member.
        observed: (n_inputs,) first rows of the quantities that networks read.
        x: (n_members, n_rows, n_inputs) room for inputs.
    """
    n_lanes = blocks.shape[2]
    for lane in range(blocks.shape[0] * n_lanes):
        numbers, member, first = _place(blocks, lane, robot_of_lane, n_designs)
        for link in range(N_LINKS):
            for k in range(observed.shape[0]):
                x[member, first + link, k] = numbers[observed[k] + link, lane % n_lanes]


@inline
def add(blocks: Any, robot_of_lane: Any, n_designs: int, out: Any, to_vx: int, to_vy: int, to_omega: int) -> None:
    """Scatter what the networks say: changes of vx, vy, omega, to be added to the quantities of given first rows.

    Args:
        blocks: as above; so are robot_of_lane and n_designs.
        robot_of_lane: as above.
        n_designs: as above.
        out: (n_members, n_rows, padded outputs) changes.
        to_vx: first row of the quantity to which the change of vx is added.
        to_vy: the same of vy.
        to_omega: the same of omega.
    """
    n_lanes = blocks.shape[2]
    for lane in range(blocks.shape[0] * n_lanes):
        numbers, member, first = _place(blocks, lane, robot_of_lane, n_designs)
        for link in range(N_LINKS):
            numbers[to_vx + link, lane % n_lanes] += out[member, first + link, 0]
            numbers[to_vy + link, lane % n_lanes] += out[member, first + link, 1]
            numbers[to_omega + link, lane % n_lanes] += out[member, first + link, 2]


@numba.njit(inline="always")
def _place(blocks: Any, lane: int, robot_of_lane: Any, n_designs: int) -> Any:
    """Find a lane's numbers, its robot's member, and its root's row among the member's rows."""
    robot = robot_of_lane[lane]
    return blocks[lane // blocks.shape[2]], robot // n_designs, (robot % n_designs) * N_LINKS
