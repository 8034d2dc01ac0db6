"""Steps in a medium that networks have learned: what they read, and what they add, between two steps of an engine.

Between two steps of the engine lie only microseconds; going back to Python for each would take longer than the steps.
So an engine makes a kernel of :func:`push` and its own. It must be a module's function and no closure: to numba's cache
a closure over kernels is another one in every process.

A member's rows are counted link by link, and design by design within a link. So robots that lie side by side in the
engine's lanes lie side by side in the networks', and where a vector of the one is a vector of the other it moves whole.
"""

# mypy: disallow-untyped-decorators=False

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tasks.arrays import Float32, Int64
from tasks.compiled import inline
from tasks.design.genes import N_LINKS
from tasks.simulation.networks.inference import N_LANES, PackedNetworks, run_networks
from tasks.simulation.simd.lanes import Block, as_block
from tasks.simulation.trees import layout


class Ties(NamedTuple):
    """Links of robots in an engine's blocks tied to rows of networks, as many at once as the blocks here have lanes."""

    places: Int64
    """(n, 3) where a tie's numbers lie in the three blocks: of the first quantity, input and change."""
    robots: Block
    """The engine's blocks."""
    x: Block
    """The networks' inputs."""
    out: Block
    """What they say of them: changes of vx, vy, omega, and padding."""
    quantity: int
    """Rows of ``robots`` from a quantity of a tie to the next."""
    number: int
    """Rows of ``x`` and ``out`` from a number of a tie to the next."""


class Coupling(NamedTuple):
    """All robots tied to their members' networks."""

    whole: Ties
    """Where N_LANES links lie side by side in both."""
    single: Ties
    """All others."""
    observed: Int64
    """(n_inputs,) the engine's first rows of the quantities that networks read."""
    layers: Int64
    sizes: Int64
    x: Float32
    out: Float32
    between: Float32
    """As networks.py has them."""


def couple(
    networks: PackedNetworks,
    blocks: Float32,
    n_robots: int,
    quantities: Mapping[str, int] = layout.QUANTITIES,
    link_stride: int = 1,
) -> Coupling:
    """Tie robots to their members' networks.

    Args:
        networks: of all members.
        blocks: (n_groups, n_rows, n_lanes) all robots' numbers, contiguous in aligned memory. Robot i is in lane i mod
            n_lanes of group i // n_lanes; lanes that are left over hold copies of the last, and stay copies.
        n_robots: of all members, as many of each; robot number member · n_designs + design.
        quantities: first row of each quantity of :class:`tasks.world.LinkStates`.
        link_stride: rows from a link's quantity to the next link's.
    """
    n_designs = n_robots // networks.n_members
    x, out = networks.room(n_designs * N_LINKS)
    n_groups, n_rows, n_lanes = blocks.shape
    link, place = (index.reshape(-1) for index in np.indices((N_LINKS, n_groups * n_lanes)))
    group, lane = np.divmod(place, n_lanes)
    member, design = np.divmod(np.minimum(place, n_robots - 1), n_designs)
    vector, first = np.divmod(link * n_designs + design, N_LANES)
    vector += member * x.shape[1]
    of_x, of_out = (vector * room.shape[2] * N_LANES + first for room in (x, out))
    places = np.stack([(group * n_rows + link * link_stride) * n_lanes + lane, of_x, of_out], axis=1)

    # A vector of the networks is one of the engine's where both begin with the same link, and a member has as many.
    begins = (first == 0) & (lane % N_LANES == 0) & (design + N_LANES <= n_designs) & (n_lanes % N_LANES == 0)
    is_whole = np.zeros(len(places), bool)
    is_whole[np.nonzero(begins)[0][:, None] + np.arange(N_LANES)] = True

    def ties(chosen: npt.NDArray[np.bool_], width: int) -> Ties:
        robots, inputs, changes = (
            as_block(numbers.reshape(-1)[: numbers.size // width * width].reshape(-1, width))
            for numbers in (blocks, x, out)
        )
        return Ties(places[chosen] // width, robots, inputs, changes, n_lanes // width, N_LANES // width)

    return Coupling(
        whole=ties(begins, N_LANES),
        single=ties(~is_whole, 1),
        observed=np.array([quantities[name] for name in networks.inputs], np.int64),
        layers=networks.layers,
        sizes=networks.sizes,
        x=x,
        out=out,
        between=networks.between,
    )


@inline
def _read(ties: Any, observed: Any) -> None:
    """Copy what the networks read."""
    for tie in range(ties.places.shape[0]):
        robot, x = ties.places[tie, 0], ties.places[tie, 1]
        for k in range(observed.shape[0]):
            ties.x[x + k * ties.number] = ties.robots[robot + observed[k] * ties.quantity]


@inline
def _add(ties: Any, to_vx: int, to_vy: int, to_omega: int) -> None:
    """Add what they say."""
    for tie in range(ties.places.shape[0]):
        robot, change = ties.places[tie, 0], ties.places[tie, 2]
        for to in (to_vx, to_vy, to_omega):
            row = robot + to * ties.quantity
            ties.robots[row] = ties.robots[row] + ties.out[change]
            change += ties.number


@inline
def push(coupling: Any, to_vx: int, to_vy: int, to_omega: int) -> None:
    """Let networks read all robots, and add their changes to the quantities of given first rows.

    Args:
        coupling: of these robots.
        to_vx: first row of the quantity to which the change of vx is added.
        to_vy: the same of vy.
        to_omega: the same of omega.
    """
    x, out = coupling.x, coupling.out
    _read(coupling.whole, coupling.observed)
    _read(coupling.single, coupling.observed)
    run_networks(
        coupling.layers, coupling.sizes, x.shape[1], x.ctypes.data, out.ctypes.data, coupling.between.ctypes.data
    )
    _add(coupling.whole, to_vx, to_vy, to_omega)
    _add(coupling.single, to_vx, to_vy, to_omega)
