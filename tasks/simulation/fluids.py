"""Fluids in the batch engine: a kernel for each law, which the engines call by its address.

So an engine is compiled once, whatever the fluid, and a fluid's kernel within a few seconds.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from numba.core.errors import NumbaError

from tasks.arrays import Int64
from tasks.compiled import entry, inline, specialised, uncompiled
from tasks.simd.lanes import Block, from_row
from tasks.world.medium import Fluid, LinkStates, Medium, MediumError, MediumWithMemory, change_in
from tasks.world.physics import Physics

# Of a kernel, which has its own.
LAW: Callable[..., Any] = Fluid.law
READ, ADD, UNKICKED, STRIDE, KICKS = (0,) * 10, (0,) * 3, (0,) * 3, 0, 0


class Links(NamedTuple):
    """The fields of :class:`tasks.world.LinkStates` but the parent, on lanes."""

    length_scale: Any
    mass: Any
    inertia: Any
    y: Any
    cos: Any
    sin: Any
    vx: Any
    vy: Any
    omega: Any
    x: Any
    kick_vx: Any
    kick_vy: Any
    kick_omega: Any


class Push(NamedTuple):
    """A fluid, or controllers, as the kernel of an engine takes it."""

    address: Any  # of its own kernel; 0 for none
    factors: Block  # what the law needs, a row each, group after group of robots if it differs between them
    stride: int = 0  # rows from a group's factors to the next one's


class Acting(NamedTuple):
    """What acts at the start of a step."""

    motors: Push  # the robots' controller (tasks/simulation/motors.py)
    fluid: Push


@inline
def _from_group(push: Push, group: int) -> Push:
    return Push(push.address, from_row(push.factors, group * push.stride), push.stride)


@inline
def of_group(acting: Acting, group: int) -> Acting:
    """Return what acts on a group of robots and those after it."""
    return Acting(_from_group(acting.motors, group), _from_group(acting.fluid, group))


class Rows(NamedTuple):
    """Where an engine has the quantities of a robot's links."""

    read: tuple[int, ...]  # rows of the first link's fields of LinkStates, up to x
    add: tuple[int, ...]  # rows of what changes of its vx, vy and omega are added to
    unkicked: tuple[int, ...]  # rows of its velocities now, had only the fluid and gravity acted since it was asked
    stride: int  # rows from a link to the next


def _push_links(block: Block, factors: Block, n_links: int) -> None:
    """Add the changes by a law to the links of a group of robots; the first factor is the fall if it reads kicks."""
    for link in range(n_links):
        k = link * STRIDE
        length_scale, mass, inertia = block[READ[0] + k], block[READ[1] + k], block[READ[2] + k]
        y, cos, sin = block[READ[3] + k], block[READ[4] + k], block[READ[5] + k]
        now = block[READ[6] + k], block[READ[7] + k], block[READ[8] + k]
        x = block[READ[9] + k]
        kick: Any
        if KICKS:
            kick = (now[0] - block[UNKICKED[0] + k], now[1] - block[UNKICKED[1] + k], now[2] - block[UNKICKED[2] + k])
        else:  # so a law that reads them does not compile
            kick = None, None, None
        vx, vy, omega = LAW(from_row(factors, KICKS), Links(length_scale, mass, inertia, y, cos, sin, *now, x, *kick))
        if KICKS:
            block[UNKICKED[0] + k] = now[0] + vx
            block[UNKICKED[1] + k] = now[1] + vy + factors[0]
            block[UNKICKED[2] + k] = now[2] + omega
        block[ADD[0] + k] = block[ADD[0] + k] + vx
        block[ADD[1] + k] = block[ADD[1] + k] + vy
        block[ADD[2] + k] = block[ADD[2] + k] + omega


@functools.cache
def _kernel(law: Callable[..., Any], rows: Rows, kicks: int) -> Callable[..., Any]:
    at = {"READ": rows.read, "ADD": rows.add, "UNKICKED": rows.unkicked, "STRIDE": rows.stride}
    return specialised(_push_links, law, seconds=3, **at, KICKS=kicks)


def is_compiled(medium: Medium | MediumWithMemory | None) -> TypeGuard[Fluid]:
    """Return whether a medium has a law that the engines compile; a subclass may have a change of its own instead."""
    own = hasattr(medium, "start") or getattr(type(medium), "velocity_change", None) is not Fluid.velocity_change
    return isinstance(medium, Fluid) and not own


def push_of(
    medium: Medium | MediumWithMemory | None, physics: Physics, rows: Rows, block: Block, member: Int64
) -> Push:
    """Return a medium's kernel for an engine, compiled for blocks such as the given one; none if it has no law.

    ``member`` are the (n_groups, n_lanes) ensemble members of the robots.
    """
    if not is_compiled(medium):
        return Push(0, Block(1, block.n_lanes))
    fall = np.float32(physics.time_step) * np.float32(-physics.gravity)
    factors = (*([fall] if medium.reads_kicks else []), *medium.factors(physics))
    differ = any(np.ndim(factor) for factor in factors)
    groups = member if differ else member[:1]
    of_lanes = Block(len(groups) * len(factors) + 1, block.n_lanes)
    for number, factor in enumerate(factors):
        of_lanes.rows[number : -1 : len(factors)] = np.asarray(factor)[groups] if np.ndim(factor) else factor
    try:
        address = entry(_kernel(medium.law, rows, int(medium.reads_kicks)), block, of_lanes, 1)
        return Push(address, of_lanes, len(factors) if differ else 0)
    except NumbaError as error:
        change_in(medium, LinkStates(*np.ones((9, 1), np.float32)), physics)  # says what is wrong, if arrays fail, too
        said = f"{uncompiled(error, medium.law)}; what needs NumPy goes into velocity_change"
        raise MediumError(said) from error
