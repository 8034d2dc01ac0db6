"""Robots into lanes: what does not change of them, and their state at the spawn, written to the rows of blocks.

In NumPy this is some hundred calls, a twentieth of the rollouts of 64 designs; compiled it is less than a hundredth.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from tasks.arrays import Float32, Int64
from tasks.compiled import inline
from tasks.design.body import JOINT_ANGLE, LENGTH, spawn_kernel
from tasks.design.genes import COLUMNS, N_LINKS, PARENT_COLUMN, DesignTable
from tasks.simulation.controller import TURN
from tasks.simulation.trees import layout
from tasks.simulation.trees.contact import NO_VERTEX

HALF, QUARTER, ZERO, ONE = np.float32(0.5), np.float32(0.25), np.float32(0.0), np.float32(1.0)
THIRD = np.float32(1.0) / np.float32(3.0)

FREQUENCY, PHASE, MOTION_RANGE, MOTOR_ON = (
    COLUMNS[name].start for name in ("frequency", "phase", "motion_range", "motor_on")
)
"""Columns of controllers in a table of designs: the frequency's; those of the root, which the other links' follow."""


@inline
def inverse_mass_and_inertia(half_width: Any, half_height: Any, density: Any) -> Any:
    """b2PolygonShape::ComputeMass and b2Body::ResetMassData of a box, operation by operation in float32."""
    x, y = half_width, half_height
    corner_x, corner_y = (-x, x, x, -x), (-y, -y, y, y)
    area = inertia = ZERO * x
    for i in range(4):
        ex1, ey1, ex2, ey2 = corner_x[i], corner_y[i], corner_x[(i + 1) % 4], corner_y[(i + 1) % 4]
        D = ex1 * ey2 - ey1 * ex2
        area = area + HALF * D
        intx2 = ex1 * ex1 + ex2 * ex1 + ex2 * ex2
        inty2 = ey1 * ey1 + ey2 * ey1 + ey2 * ey2
        inertia = inertia + (QUARTER * THIRD * D) * (intx2 + inty2)
    return ONE / (density * area), ONE / (density * inertia)


def discovery_order(parents: Sequence[int]) -> list[int]:
    """Order in which Box2D's island search meets a robot's links (b2World::Solve): the root, then joint by joint.

    Args:
        parents: of each link; the links were created from the last to the root, the joints from the first on.
    """
    order, stack = [0], [0]
    while stack:
        link = stack.pop()
        for child in reversed(range(link + 1, N_LINKS)):  # a body lists its joints with the latest first
            if parents[child] == link:
                order.append(child)
                stack.append(child)
    return order


TREES = list(itertools.product((-1,), *(range(link) for link in range(1, N_LINKS))))
"""Every tree that a robot can be: 120 of them, in lexical order of the parents."""
ORDER_OF_TREE = np.array([discovery_order(parents) for parents in TREES])
PLACE_OF_TREE = np.argsort(ORDER_OF_TREE, axis=1)
TREE_WEIGHTS = np.array([0, *(len(TREES) // math.factorial(link) for link in range(1, N_LINKS))])
"""parents · weights is a tree's place in that list."""


def pack_robots(
    table: DesignTable,
    n_members: int,
    n_lanes: int,
    density: float,
    max_motor_impulse: np.float32,
    blocks: Float32,
    place: Int64,
) -> None:
    """Spawn n_members robots of each of n_designs designs, and fill the lanes of blocks with them.

    Args:
        table: (n_designs, N_COLUMNS)
        n_members: how many of each; robot number member · n_designs + design is in lane number mod n_lanes of group
            number div n_lanes.
        n_lanes: of a group.
        density: of every link [kg/m²].
        max_motor_impulse: of every motor that is on [N·m·s].
        blocks: (n_groups, N_ROWS, n_lanes) of 0, to be filled; lanes left over at the end get copies of the last robot,
            so that every lane holds one.
        place: (n_designs, n_links) room for the place of each link among those of its robot.
    """
    single, n_robots = np.float32, n_members * len(table)
    links, one_density = spawn_kernel(table, density), single(density)
    half_width, half_height, mass, inertia = links[0], links[1], links[2], links[3]
    parent_anchor, child_anchor, x, y, angle = links[4], links[5], links[6], links[7], links[8]
    for design in range(len(table)):
        genes, tree = table[design], 0
        for link in range(N_LINKS):
            tree += int(genes[PARENT_COLUMN + link]) * TREE_WEIGHTS[link]
        for link in range(N_LINKS):
            place[design, link] = PLACE_OF_TREE[tree, link]
        robot = np.zeros(layout.FREQUENCY + 1, single)  # what comes after is scratch
        robot[layout.FREQUENCY] = single(genes[FREQUENCY])
        for i in range(N_LINKS):
            link = ORDER_OF_TREE[tree, i]
            length = single(genes[LENGTH + link])
            inverse_mass, inverse_inertia = inverse_mass_and_inertia(
                half_width[design, link], half_height[design, link], one_density
            )
            robot[layout.X + i], robot[layout.Y + i] = x[design, link], y[design, link]
            robot[layout.ANGLE + i] = angle[design, link]
            robot[layout.HALF_WIDTH + i] = half_width[design, link]
            robot[layout.HALF_HEIGHT + i] = half_height[design, link]
            robot[layout.INVERSE_MASS + i], robot[layout.INVERSE_INERTIA + i] = inverse_mass, inverse_inertia
            robot[layout.LONG_AXIS + i], robot[layout.SHORT_AXIS + i] = length, ONE / length
            robot[layout.MASS + i], robot[layout.INERTIA + i] = mass[design, link], inertia[design, link]
            robot[layout.VERTEX_1 + i] = robot[layout.VERTEX_2 + i] = NO_VERTEX
            if i > 0:
                j, above = i - 1, place[design, int(genes[PARENT_COLUMN + link])]
                robot[layout.PARENT + j] = above
                robot[layout.PARENT_INVERSE_MASS + j] = robot[layout.INVERSE_MASS + above]  # which comes before
                robot[layout.PARENT_INVERSE_INERTIA + j] = robot[layout.INVERSE_INERTIA + above]
                robot[layout.PARENT_ANCHOR + j] = parent_anchor[design, link]
                robot[layout.CHILD_ANCHOR + j] = child_anchor[design, link]
                robot[layout.MAX_MOTOR_IMPULSE + j] = max_motor_impulse if genes[MOTOR_ON + link] != 0 else ZERO
                robot[layout.PHASE + j] = single(genes[PHASE + link] / TURN)
                robot[layout.MOTION_RANGE + j] = single(genes[MOTION_RANGE + link])
                robot[layout.REST_ANGLE + j] = single(genes[JOINT_ANGLE + link])
        for number in range(design, n_robots, len(table)):
            for row in range(len(robot)):
                blocks[number // n_lanes, row, number % n_lanes] = robot[row]
    last = n_robots - 1
    for number in range(n_robots, blocks.shape[0] * n_lanes):
        for row in range(blocks.shape[1]):
            blocks[number // n_lanes, row, number % n_lanes] = blocks[last // n_lanes, row, last % n_lanes]
