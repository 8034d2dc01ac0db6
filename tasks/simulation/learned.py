"""Steps in a medium that networks have learned: what they read, what they add, and Box2D's step, in one kernel.

Between two steps of the engine lie only microseconds; going back to Python for each would take longer than the steps.
"""

# mypy: disallow-untyped-decorators=False

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

from tasks.design.genes import N_LINKS


def advancing(advance: Any, run_networks: Any, added: tuple[int, int, int]) -> Callable[..., None]:
    """Make the kernel out of those for one step and for the networks.

    Args:
        advance: takes steps.
        run_networks: as in tasks/simulation/networks.py.
        added: first rows of the quantities to which go the changes of vx, vy, omega.
    """
    to_vx, to_vy, to_omega = added

    def advance_in_learned_medium(
        block: Any, blocks: Any, world: Any, first_step: int, n_steps: int, robot_of_lane: Any, n_designs: int,
        observed: Any, layers: Any, sizes: Any, x: Any, out: Any, between: Any, no_trace: Any,
    ) -> None:  # fmt: skip
        """Take steps with groups of robots, each in its member's medium.

        Args:
            block: all groups' blocks, for the engine.
            blocks: (n_groups, N_ROWS, n_lanes) the same memory, by numbers.
            world: of the engine.
            first_step: number of the first step since the spawn.
            n_steps: how many to take.
            robot_of_lane: (n_groups · n_lanes,) member · n_designs + design; repeats where lanes are left over.
            n_designs: robots of each member.
            observed: (n_inputs,) first rows of the quantities that networks read.
            layers: as in tasks/simulation/networks.py; so are sizes and between.
            sizes: padded inputs of each layer and outputs of the last.
            x: (n_members, n_rows, n_inputs) room for inputs.
            out: (n_members, n_rows, padded outputs) room for outputs: changes of vx, vy, omega.
            between: room for what goes from layer to layer.
            no_trace: the engine's trace, which is not kept.
        """
        n_groups, _, n_lanes = blocks.shape
        n_inputs = observed.shape[0]
        for step in range(n_steps):
            for lane in range(n_groups * n_lanes):
                numbers, member, first = _place(blocks, lane, robot_of_lane, n_designs)
                for link in range(N_LINKS):
                    for k in range(n_inputs):
                        x[member, first + link, k] = numbers[observed[k] + link, lane % n_lanes]
            run_networks(layers, sizes, x.shape[1], x.ctypes.data, out.ctypes.data, between.ctypes.data)
            for lane in range(n_groups * n_lanes):
                numbers, member, first = _place(blocks, lane, robot_of_lane, n_designs)
                for link in range(N_LINKS):
                    numbers[to_vx + link, lane % n_lanes] += out[member, first + link, 0]
                    numbers[to_vy + link, lane % n_lanes] += out[member, first + link, 1]
                    numbers[to_omega + link, lane % n_lanes] += out[member, first + link, 2]
            advance(block, n_groups, world, first_step + step, 1, no_trace, False)

    return advance_in_learned_medium


@numba.njit(inline="always")
def _place(blocks: Any, lane: int, robot_of_lane: Any, n_designs: int) -> Any:
    """Find a lane's numbers, its robot's member, and its root's row among the member's rows."""
    robot = robot_of_lane[lane]
    return blocks[lane // blocks.shape[2]], robot // n_designs, (robot % n_designs) * N_LINKS
