"""Coupling of networks and an engine in one kernel: networks read the links and add their velocity changes.

The engine takes microseconds per step; returning to Python between steps would take longer than the steps. So an engine
makes a kernel of :func:`push` and of its own. That kernel must be a function of a module: numba's cache never finds a
closure over kernels again.

Samples of a member are ordered by link and, within a link, by design. So robots in neighbouring lanes of the engine are
in neighbouring lanes of the networks, and where a vector of one is a vector of the other it is copied whole.
"""

# mypy: disallow-untyped-decorators=False

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tasks.arrays import Bools, Float32, Int64
from tasks.compiled import inline
from tasks.design.genes import N_LINKS
from tasks.simd.lanes import Block, as_block
from tasks.simulation.networks.inference import PackedNetworks, run_networks
from tasks.simulation.networks.tiles import N_LANES
from tasks.simulation.networks.wetted import changes_by, inputs_of
from tasks.simulation.trees import layout


class LinkCopies(NamedTuple):
    """Copies between links of robots and samples of networks, of as many links at once as the blocks have lanes."""

    rows: Int64  # (n_copies, 3) rows of a copy's first number in ``robots``, ``x`` and ``out``
    robots: Block  # blocks of the engine
    x: Block  # inputs of the networks
    out: Block  # outputs of the networks: changes of vx, vy, omega, and padding
    quantity: int  # rows of ``robots`` between two quantities of a link
    number: int  # rows of ``x`` and ``out`` between two numbers of a sample


class Coupling(NamedTuple):
    """Robots, and the networks of their members."""

    whole: LinkCopies  # copies of N_LANES links that are neighbours in both
    single: LinkCopies  # copies of all other links
    observed: Int64  # (n_read,) first rows of the quantities that networks read
    wetted: bool  # whether the networks are of the wetted form, see tasks/residual/wetted.py
    layers: Int64  # this field and those below are arguments of the networks' kernel, in inference.py
    sizes: Int64
    x: Float32
    out: Float32
    between: Float32


def couple(
    networks: PackedNetworks,
    blocks: Float32,
    n_robots: int,
    quantities: Mapping[str, int] = layout.QUANTITIES,
    link_stride: int = 1,
) -> Coupling:
    """Return the coupling of robots with the networks of their members, for :func:`push`.

    Args:
        networks: networks of all members.
        blocks: (n_groups, n_rows, n_lanes) aligned, contiguous memory of the robots. Robot i is in lane i mod n_lanes
            of group i // n_lanes; lanes left over hold copies of the last robot, and stay copies.
        n_robots: number of robots, n_designs for each member; robot number member · n_designs + design.
        quantities: first row of each quantity of :class:`tasks.world.LinkStates`.
        link_stride: rows between the same quantity of two links.
    """
    n_designs = n_robots // networks.n_members
    x, out = networks.allocate(n_designs * N_LINKS)
    n_groups, n_rows, n_lanes = blocks.shape
    link, robot = (index.reshape(-1) for index in np.indices((N_LINKS, n_groups * n_lanes)))
    group, lane = np.divmod(robot, n_lanes)
    member, design = np.divmod(np.minimum(robot, n_robots - 1), n_designs)
    vector, first = np.divmod(link * n_designs + design, N_LANES)
    vector += member * x.shape[1]
    of_x, of_out = (vector * array.shape[2] * N_LANES + first for array in (x, out))
    index = np.stack([(group * n_rows + link * link_stride) * n_lanes + lane, of_x, of_out], axis=1)

    # A vector of the networks is one of the engine's if both begin with the same link and the member fills it.
    begins = (first == 0) & (lane % N_LANES == 0) & (design + N_LANES <= n_designs) & (n_lanes % N_LANES == 0)
    is_whole = np.zeros(len(index), bool)
    is_whole[np.nonzero(begins)[0][:, None] + np.arange(N_LANES)] = True

    def copies(chosen: Bools, width: int) -> LinkCopies:
        robots, inputs, changes = (
            as_block(numbers.reshape(-1)[: numbers.size // width * width].reshape(-1, width))
            for numbers in (blocks, x, out)
        )
        return LinkCopies(index[chosen] // width, robots, inputs, changes, n_lanes // width, N_LANES // width)

    return Coupling(
        whole=copies(begins, N_LANES),
        single=copies(~is_whole, 1),
        observed=np.array([quantities[field] for field in networks.inputs], np.int64),
        wetted=networks.wetted,
        layers=networks.layers,
        sizes=networks.sizes,
        x=x,
        out=out,
        between=networks.between,
    )


@inline
def _read_wetted(copies: LinkCopies, observed: Int64) -> None:
    """Compute the inputs of wetted networks."""
    robots, x, stride, n = copies.robots, copies.x, copies.quantity, copies.number
    for copy in range(copies.rows.shape[0]):
        robot, k = copies.rows[copy, 0], copies.rows[copy, 1]
        a, y = robots[robot + observed[0] * stride], robots[robot + observed[1] * stride]
        cos, sin = robots[robot + observed[2] * stride], robots[robot + observed[3] * stride]
        vx, vy = robots[robot + observed[4] * stride], robots[robot + observed[5] * stride]
        omega = robots[robot + observed[6] * stride]
        inputs = inputs_of(a, y, cos, sin, vx, vy, omega)
        x[k], x[k + n], x[k + 2 * n], x[k + 3 * n] = inputs[:4]
        x[k + 4 * n], x[k + 5 * n], x[k + 6 * n], x[k + 7 * n], x[k + 8 * n] = inputs[4:9]
        x[k + 9 * n], x[k + 10 * n], x[k + 11 * n], x[k + 12 * n] = inputs[9:]


@inline
def _read(copies: LinkCopies, observed: Int64, wetted: bool) -> None:
    """Copy the links' states to the networks' inputs."""
    if wetted:
        _read_wetted(copies, observed)
        return
    for copy in range(copies.rows.shape[0]):
        robot, x = copies.rows[copy, 0], copies.rows[copy, 1]
        for k in range(observed.shape[0]):
            copies.x[x + k * copies.number] = copies.robots[robot + observed[k] * copies.quantity]


@inline
def _add_wetted(copies: LinkCopies, to_vx: int, to_vy: int, to_omega: int) -> None:
    """Add what the outputs of wetted networks change."""
    robots, stride, n = copies.robots, copies.quantity, copies.number
    for copy in range(copies.rows.shape[0]):
        robot, x, change = copies.rows[copy, 0], copies.rows[copy, 1], copies.rows[copy, 2]
        part = copies.x[x], copies.x[x + n], copies.x[x + 2 * n], copies.x[x + 3 * n]
        out = copies.out[change], copies.out[change + n], copies.out[change + 2 * n], copies.out[change + 3 * n]
        changes = changes_by(out, part)
        vx, vy, omega = robot + to_vx * stride, robot + to_vy * stride, robot + to_omega * stride
        robots[vx], robots[vy] = robots[vx] + changes[0], robots[vy] + changes[1]
        robots[omega] = robots[omega] + changes[2]


@inline
def _add(copies: LinkCopies, to_vx: int, to_vy: int, to_omega: int, wetted: bool) -> None:
    """Add the networks' outputs to the links' quantities."""
    if wetted:
        _add_wetted(copies, to_vx, to_vy, to_omega)
        return
    for copy in range(copies.rows.shape[0]):
        robot, change = copies.rows[copy, 0], copies.rows[copy, 2]
        for to in (to_vx, to_vy, to_omega):
            row = robot + to * copies.quantity
            copies.robots[row] = copies.robots[row] + copies.out[change]
            change += copies.number


@inline
def push(coupling: Coupling, to_vx: int, to_vy: int, to_omega: int) -> None:
    """Evaluate the networks of all robots and add their changes to three quantities.

    ``to_vx``, ``to_vy`` and ``to_omega`` are the first rows of what the changes are added to.
    """
    x, out = coupling.x, coupling.out
    _read(coupling.whole, coupling.observed, coupling.wetted)
    _read(coupling.single, coupling.observed, coupling.wetted)
    run_networks(
        coupling.layers, coupling.sizes, x.shape[1], x.ctypes.data, out.ctypes.data, coupling.between.ctypes.data
    )
    _add(coupling.whole, to_vx, to_vy, to_omega, coupling.wetted)
    _add(coupling.single, to_vx, to_vy, to_omega, coupling.wetted)
