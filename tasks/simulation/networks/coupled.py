"""Coupling of networks and an engine in one kernel: networks read the links and add their velocity changes.

The engine takes microseconds per step; returning to Python between steps would take longer than the steps. So an engine
makes a kernel of :func:`push` and of its own. That kernel must be a function of a module: numba's cache never finds a
closure over kernels again. What networks read, and how they act, are small kernels of their form, which it calls by
their addresses, as those of fluids.

Samples of a member are ordered by link and, within a link, by design. So robots in neighbouring lanes of the engine are
in neighbouring lanes of the networks, and where a vector of one is a vector of the other it is copied whole.
"""

# mypy: disallow-untyped-decorators=False

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.core.errors import NumbaError

from tasks.arrays import Bools, Float32, Int64
from tasks.compiled import entry, inline, specialised, uncompiled
from tasks.simd.lanes import Block, as_block, call, from_row
from tasks.simulation.fluids import Links, Rows
from tasks.simulation.networks.inference import PackedNetworks, run_networks
from tasks.simulation.networks.tiles import N_LANES
from tasks.world.medium import MediumError

# Of a kernel, which has its own.
LAW: Callable[..., Any] = tuple
ROWS, UNKICKED, KICKS, FALL = (0,) * 10, (0,) * 3, False, np.float32(0)


class LinkCopies(NamedTuple):
    """Copies between links of robots and samples of networks, of as many links at once as the blocks have lanes."""

    rows: Int64  # (n_copies, 3) rows of a copy's first number in ``robots``, ``x`` and ``out``
    robots: Block  # blocks of the engine
    x: Block  # inputs of the networks
    out: Block  # outputs of the networks, and padding
    stride: int  # rows of ``x`` and ``out`` between two numbers of a sample
    n_in: int  # inputs of a sample
    n_out: int  # outputs of a sample
    numbers: Block  # scratch for the inputs and outputs of a copy
    read: Any  # address of the kernel that reads a copy's inputs
    act: Any  # address of the kernel by which its outputs act


class Coupling(NamedTuple):
    """Robots, and the networks of their members."""

    whole: LinkCopies  # copies of N_LANES links that are neighbours in both
    single: LinkCopies  # copies of all other links
    layers: Int64  # this field and those below are arguments of the networks' kernel, in inference.py
    sizes: Int64
    x: Float32
    out: Float32
    between: Float32


def _read_link(link: Block, numbers: Block, n_in: int) -> None:  # noqa: ARG001 (called as _act_on_link is)
    """Write the inputs of a link, or of as many as there are lanes."""
    length_scale, mass, inertia = link[ROWS[0]], link[ROWS[1]], link[ROWS[2]]
    y, cos, sin, vx, vy, omega = (
        link[ROWS[3]],
        link[ROWS[4]],
        link[ROWS[5]],
        link[ROWS[6]],
        link[ROWS[7]],
        link[ROWS[8]],
    )
    kick: Any
    if KICKS:  # noqa: SIM108 (of a constant)
        kick = vx - link[UNKICKED[0]], vy - link[UNKICKED[1]], omega - link[UNKICKED[2]]
    else:  # so a form that reads them unasked does not compile
        kick = None, None, None
    links = Links(length_scale, mass, inertia, y, cos, sin, vx, vy, omega, link[ROWS[9]], *kick)
    for k, value in enumerate(LAW(links)):
        numbers[k] = value


def _act_on_link(link: Block, numbers: Block, n_in: int) -> None:
    """Add the changes by the outputs, which follow the inputs."""
    vx, vy, omega = LAW(from_row(numbers, n_in), numbers)
    if KICKS:
        link[UNKICKED[0]], link[UNKICKED[1]] = link[ROWS[3]] + vx, link[ROWS[4]] + vy + FALL
        link[UNKICKED[2]] = link[ROWS[5]] + omega
    link[ROWS[0]], link[ROWS[1]], link[ROWS[2]] = link[ROWS[0]] + vx, link[ROWS[1]] + vy, link[ROWS[2]] + omega


@functools.cache
def _kernel(
    template: Callable[..., Any],
    law: Callable[..., Any],
    rows: tuple[int, ...],
    unkicked: tuple[int, ...],
    fall: np.float32,
) -> Callable[..., Any]:
    kicks = {"KICKS": True, "UNKICKED": unkicked, "FALL": fall} if unkicked else {}
    return specialised(template, law, seconds=1, ROWS=rows, **kicks)


def couple(
    networks: PackedNetworks, blocks: Float32, n_robots: int, n_links: int, rows: Rows, fall: np.float32
) -> Coupling:
    """Return the coupling of robots with the networks of their members, for :func:`push`.

    Args:
        networks: networks of all members.
        blocks: (n_groups, n_rows, n_lanes) aligned, contiguous memory of the robots. Robot i is in lane i mod n_lanes
            of group i // n_lanes; lanes left over hold copies of the last robot, and stay copies.
        n_robots: number of robots, n_designs for each member; robot number member · n_designs + design.
        n_links: links of each robot.
        rows: where the blocks have the quantities of links.
        fall: what gravity adds to vy in a step [m/s].
    """
    read, act = networks.read, networks.act
    assert read is not None and act is not None  # both are of their form
    n_designs = n_robots // networks.n_members
    x, out = networks.allocate(n_designs * n_links)
    n_groups, n_rows, n_lanes = blocks.shape
    link, robot = (index.reshape(-1) for index in np.indices((n_links, n_groups * n_lanes)))
    group, lane = np.divmod(robot, n_lanes)
    member, design = np.divmod(np.minimum(robot, n_robots - 1), n_designs)
    vector, first = np.divmod(link * n_designs + design, N_LANES)
    vector += member * x.shape[1]
    of_x, of_out = (vector * array.shape[2] * N_LANES + first for array in (x, out))
    index = np.stack([(group * n_rows + link * rows.stride) * n_lanes + lane, of_x, of_out], axis=1)

    # A vector of the networks is one of the engine's if both begin with the same link and the member fills it.
    begins = (first == 0) & (lane % N_LANES == 0) & (design + N_LANES <= n_designs) & (n_lanes % N_LANES == 0)
    is_whole = np.zeros(len(index), bool)
    is_whole[np.nonzero(begins)[0][:, None] + np.arange(N_LANES)] = True

    def copies(chosen: Bools, width: int) -> LinkCopies:
        robots, inputs, outputs = (
            as_block(array.reshape(-1)[: array.size // width * width].reshape(-1, width)) for array in (blocks, x, out)
        )
        n_in, n_out = networks.n_in, networks.n_out
        numbers = Block(n_in + n_out, width)

        def address(template: Callable[..., Any], law: Callable[..., Any], quantities: tuple[int, ...]) -> Any:
            if not chosen.any():
                return 0
            scaled, unkicked = (
                tuple(row * (n_lanes // width) for row in of)
                for of in (quantities, rows.unkicked if networks.reads_kicks else ())
            )
            try:
                return entry(_kernel(template, law, scaled, unkicked, fall), robots, numbers, n_in)
            except NumbaError as error:
                raise MediumError(uncompiled(error, law)) from error

        return LinkCopies(
            rows=index[chosen] // width,
            robots=robots,
            x=inputs,
            out=outputs,
            stride=N_LANES // width,
            n_in=n_in,
            n_out=n_out,
            numbers=numbers,
            read=address(_read_link, read, rows.read),
            act=address(_act_on_link, act, (*rows.add, *rows.read[6:9])),
        )

    return Coupling(
        whole=copies(begins, N_LANES),
        single=copies(~is_whole, 1),
        layers=networks.layers,
        sizes=networks.sizes,
        x=x,
        out=out,
        between=networks.between,
    )


@inline
def _read(copies: LinkCopies) -> None:
    """Write what the networks read of the links."""
    numbers = copies.numbers
    for copy in range(copies.rows.shape[0]):
        call(copies.read, from_row(copies.robots, copies.rows[copy, 0]), numbers, copies.n_in)
        for k in range(copies.n_in):
            copies.x[copies.rows[copy, 1] + k * copies.stride] = numbers[k]


@inline
def _act(copies: LinkCopies) -> None:
    """Let the networks' outputs act on the links."""
    numbers = copies.numbers
    for copy in range(copies.rows.shape[0]):
        for k in range(copies.n_in):
            numbers[k] = copies.x[copies.rows[copy, 1] + k * copies.stride]
        for k in range(copies.n_out):
            numbers[copies.n_in + k] = copies.out[copies.rows[copy, 2] + k * copies.stride]
        call(copies.act, from_row(copies.robots, copies.rows[copy, 0]), numbers, copies.n_in)


@inline
def push(coupling: Coupling) -> None:
    """Evaluate the networks of all robots and let them act."""
    x, out = coupling.x, coupling.out
    _read(coupling.whole)
    _read(coupling.single)
    run_networks(
        coupling.layers, coupling.sizes, x.shape[1], x.ctypes.data, out.ctypes.data, coupling.between.ctypes.data
    )
    _act(coupling.whole)
    _act(coupling.single)
