"""Motors in the batch engine: a kernel for each controller, which the engines call by its address, as those of fluids.

The kernel has a block of its own with all that it knows of a group of robots and remembers of them. An engine has no
more to do with a controller than to keep what its joints sense, and to read the speeds of their motors.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.core.errors import NumbaError

from tasks.arrays import Int64
from tasks.compiled import entry, inline, specialised, uncompiled
from tasks.design.controllers import Controller, Joint, controller_named
from tasks.design.gait import joints_of
from tasks.design.gene import DesignError
from tasks.design.genes import Designs
from tasks.simd.lanes import Block, Lanes, from_row, select
from tasks.simulation.box2d import top_of_ground
from tasks.simulation.controller import fastest, motor_speed, sensing, sine_of_turns
from tasks.simulation.fluids import Push
from tasks.world.physics import Physics

# Rows of the kernel's own block: of a robot, and then of each link's joint with its parent; the root's are not used.
DT, GROUND, GAIN, LIMIT, FREQUENCY, OF_ROBOT = range(6)
REST, AMPLITUDE, PHASE, MEMORY, ABOVE, TOLD, TELLS, GAINS = range(8)


class Sensors(NamedTuple):
    """Where an engine has what a link senses: the row of each quantity of the first link, and where the speed goes."""

    parent: int  # the engine's number of the parent
    angle: int
    omega: int
    length_scale: int
    y: int
    cos: int
    sin: int
    motor_speed: int
    stride: int  # rows from a link to the next
    later: int  # 1 if a link's children have numbers in the designs' order, -1 if in the reverse order


# Of a kernel, which has its own.
LAW: Callable[..., Any] = tuple
AT, N_LINKS, N_GAINS, REMEMBERS = Sensors(*[0] * 10), 0, 0, False


@inline
def _of_parent(block: Block, row: int, stride: int, parent: Lanes, n_links: int) -> Lanes:
    """Return a quantity of each lane's parent, by its row of the first link."""
    gathered = block[row]
    for other in range(1, n_links - 1):  # the last link has no children
        gathered = select(parent == other, block[row + other * stride], gathered)
    return gathered


@inline
def _ask_neighbours(block: Block, own: Block, at: Sensors, n_links: int, n_rows: int) -> None:
    """Set what joints know of those of their parents and children: what these returned in the step before."""
    for link in range(1, n_links):
        row, told = OF_ROBOT + link * n_rows, own[FREQUENCY] * 0.0
        own[row + ABOVE] = _of_parent(own, OF_ROBOT + MEMORY, n_rows, block[at.parent + link * at.stride], n_links)
        for other in range(1, n_links):
            child = other if at.later > 0 else n_links - other
            tells = own[OF_ROBOT + child * n_rows + TELLS]
            told = told + select(block[at.parent + child * at.stride] == link, tells, 0.0)
        own[row + TOLD] = told


def _command_motors(block: Block, own: Block, step: int) -> None:
    """Set the speeds of the motors of a group of robots."""
    dt, n_rows = own[DT], GAINS + N_GAINS
    periods = own[FREQUENCY] * (dt * np.float32(step))
    if REMEMBERS:
        _ask_neighbours(block, own, AT, N_LINKS, n_rows)
    for link in range(1, N_LINKS):
        k, of_joint = link * AT.stride, from_row(own, OF_ROBOT + link * n_rows)
        parent, rest, gains = block[AT.parent + k], of_joint[REST], from_row(of_joint, GAINS)
        kept = of_joint[MEMORY], of_joint[ABOVE], of_joint[TOLD]
        blind = Joint(periods, of_joint[AMPLITUDE], of_joint[PHASE], gains, dt, *kept)
        joint_angle = block[AT.angle + k] - _of_parent(block, AT.angle, AT.stride, parent, N_LINKS)
        omega = block[AT.omega + k]
        speed = omega - _of_parent(block, AT.omega, AT.stride, parent, N_LINKS)
        length, y, cos, sin = block[AT.length_scale + k], block[AT.y + k], block[AT.cos + k], block[AT.sin + k]
        commanded = LAW(
            sensing(blind, joint_angle - rest, speed, length, y, cos, sin, omega, own[GROUND]), sine_of_turns
        )
        if REMEMBERS:
            angle, of_joint[MEMORY], of_joint[TELLS] = commanded
        else:
            angle = commanded
        block[AT.motor_speed + k] = motor_speed(rest + angle, joint_angle, own[GAIN], own[LIMIT])


@functools.cache
def _kernel(controller: Controller, sensors: Sensors, n_links: int) -> Callable[..., Any]:
    constants = {"AT": sensors, "N_LINKS": n_links, "N_GAINS": len(controller.genes), "REMEMBERS": controller.remembers}
    return specialised(_command_motors, controller.law, seconds=3, **constants)


def motors_of(
    designs: Designs, depth: float, physics: Physics, number: Int64, design: Int64, sensors: Sensors, block: Block
) -> Push:
    """Return the kernel of the designs' controller for an engine, compiled for blocks such as the given one.

    Args:
        designs: n_designs designs.
        depth: of the ground [m].
        physics: constants of the simulator.
        number: (n_designs, n_links) the engine's numbers of the links.
        design: (n_groups, n_lanes) the design in each lane.
        sensors: where the engine has what joints sense.
        block: of the engine.
    """
    controller, of_design = controller_named(designs.controller), np.arange(len(designs))[:, None]
    n_of_link = GAINS + len(controller.genes)
    n_links = designs.room
    n_rows = OF_ROBOT + n_links * n_of_link
    numbers = np.zeros((len(designs), n_rows), np.float32)
    numbers[:, :FREQUENCY] = physics.time_step, top_of_ground(depth), physics.motor_gain, fastest(physics)
    numbers[:, FREQUENCY] = designs.frequency
    _, amplitude, phase, gains = joints_of(designs, designs.frequency)[:4]
    of_links = numbers[:, OF_ROBOT:].reshape(len(designs), n_links, n_of_link)
    of_links[of_design, number, :MEMORY] = np.stack((designs.rest_angle, amplitude, phase), axis=2)
    of_links[of_design, number, GAINS:] = gains.transpose(1, 2, 0)
    own = Block(max(len(design), 1) * n_rows, block.n_lanes)
    own.rows[: len(design) * n_rows].reshape(-1, n_rows, block.n_lanes)[:] = numbers[design].transpose(0, 2, 1)
    try:
        return Push(entry(_kernel(controller, sensors, n_links), block, own, 1), own, n_rows)
    except NumbaError as error:
        raise DesignError(f"controller {controller.name}: {uncompiled(error, controller.law)}") from error
