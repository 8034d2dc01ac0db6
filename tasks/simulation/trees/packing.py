"""Packing robots into lanes: constants and initial state of each robot, in the rows of its group's block.

In NumPy this would be a hundred calls and a twentieth of the rollouts of 64 designs; compiled it is less than a
hundredth.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from tasks.arrays import Float32, Int64
from tasks.compiled import inline
from tasks.design.body import spawn_kernel
from tasks.design.gait import N_NUMBERS
from tasks.design.genes import COLUMNS, N_LINKS, PARENT_COLUMN, DesignTable
from tasks.simulation.simd.lanes import Uniform
from tasks.simulation.trees import layout
from tasks.simulation.trees.contact import NO_VERTEX

_HALF, _QUARTER, _ZERO, _ONE = np.float32(0.5), np.float32(0.25), np.float32(0.0), np.float32(1.0)
_THIRD = np.float32(1.0) / np.float32(3.0)

_LENGTH, _REST_ANGLE, _FREQUENCY, _MOTOR_ON = (
    COLUMNS[name].start for name in ("length_scale", "rest_angle", "frequency", "motor_on")
)
"""Columns in a table of designs: of the root, followed by the other links; ``frequency`` has one."""


@inline
def inverse_mass_and_inertia(half_width: Uniform, half_height: Uniform, density: Uniform) -> tuple[Uniform, Uniform]:
    """Return inverse mass [1/kg] and inertia [1/(kg·m²)] of a box by its half axes [m] and density [kg/m²].

    Follows b2PolygonShape::ComputeMass and b2Body::ResetMassData in float32, operation by operation.
    """
    x, y = half_width, half_height
    corner_x, corner_y = (-x, x, x, -x), (-y, -y, y, y)
    area = inertia = _ZERO * x
    for i in range(4):
        ex1, ey1, ex2, ey2 = corner_x[i], corner_y[i], corner_x[(i + 1) % 4], corner_y[(i + 1) % 4]
        D = ex1 * ey2 - ey1 * ex2
        area = area + _HALF * D
        intx2 = ex1 * ex1 + ex2 * ex1 + ex2 * ex2
        inty2 = ey1 * ey1 + ey2 * ey1 + ey2 * ey2
        inertia = inertia + (_QUARTER * _THIRD * D) * (intx2 + inty2)
    return _ONE / (density * area), _ONE / (density * inertia)


def discovery_order(parents: Sequence[int]) -> list[int]:
    """Return the order in which Box2D's island search (b2World::Solve) finds a robot's links, the root first.

    The links were created from the last to the root, the joints from the first on.
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
"""All 120 trees that a robot can have, in lexical order of the parents."""
_ORDER_OF_TREE = np.array([discovery_order(parents) for parents in TREES])
_NUMBER_OF_TREE = np.argsort(_ORDER_OF_TREE, axis=1)
TREE_WEIGHTS = np.array([0, *(len(TREES) // math.factorial(link) for link in range(1, N_LINKS))])
"""parents · weights is the index of a tree in TREES."""


def pack_robots(
    table: DesignTable,
    n_members: int,
    n_lanes: int,
    density: float,
    max_motor_impulse: np.float32,
    gaits: Float32,
    blocks: Float32,
    number: Int64,
) -> None:
    """Spawn n_members robots of each of n_designs designs in the lanes of blocks.

    Robot member · n_designs + design is in lane i mod n_lanes of group i // n_lanes. Lanes left over at the end get
    copies of the last robot.

    ``gaits`` are (N_NUMBERS, n_designs, n_links) numbers, ``max_motor_impulse`` [N·m·s] the most in a step of a motor
    that is on. Filled are the zeros of ``blocks``, (n_groups, N_ROWS, n_lanes), and ``number``, (n_designs,
    n_links), the engine's numbers of the links.
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
            number[design, link] = _NUMBER_OF_TREE[tree, link]
        robot = np.zeros(layout.N_PACKED, single)
        robot[layout.FREQUENCY] = single(genes[_FREQUENCY])
        for i in range(N_LINKS):
            link = _ORDER_OF_TREE[tree, i]
            length = single(genes[_LENGTH + link])
            inverse_mass, inverse_inertia = inverse_mass_and_inertia(
                half_width[design, link], half_height[design, link], one_density
            )
            robot[layout.X + i], robot[layout.Y + i] = x[design, link], y[design, link]
            robot[layout.ANGLE + i] = angle[design, link]
            robot[layout.HALF_WIDTH + i] = half_width[design, link]
            robot[layout.HALF_HEIGHT + i] = half_height[design, link]
            robot[layout.INVERSE_MASS + i], robot[layout.INVERSE_INERTIA + i] = inverse_mass, inverse_inertia
            robot[layout.LONG_AXIS + i], robot[layout.SHORT_AXIS + i] = length, _ONE / length
            robot[layout.MASS + i], robot[layout.INERTIA + i] = mass[design, link], inertia[design, link]
            robot[layout.VERTEX_1 + i] = robot[layout.VERTEX_2 + i] = NO_VERTEX
            if i > 0:
                j, above = i - 1, number[design, int(genes[PARENT_COLUMN + link])]
                robot[layout.PARENT + j] = above
                robot[layout.PARENT_INVERSE_MASS + j] = robot[layout.INVERSE_MASS + above]  # packed before
                robot[layout.PARENT_INVERSE_INERTIA + j] = robot[layout.INVERSE_INERTIA + above]
                robot[layout.PARENT_ANCHOR + j] = parent_anchor[design, link]
                robot[layout.CHILD_ANCHOR + j] = child_anchor[design, link]
                robot[layout.MAX_MOTOR_IMPULSE + j] = max_motor_impulse if genes[_MOTOR_ON + link] != 0 else _ZERO
                robot[layout.REST_ANGLE + j] = single(genes[_REST_ANGLE + link])
                for k in range(N_NUMBERS):
                    robot[layout.GAIT + j * N_NUMBERS + k] = gaits[k, design, link]
        for copy in range(design, n_robots, len(table)):
            for row in range(len(robot)):
                blocks[copy // n_lanes, row, copy % n_lanes] = robot[row]
    last = n_robots - 1
    for copy in range(n_robots, blocks.shape[0] * n_lanes):
        for row in range(blocks.shape[1]):
            blocks[copy // n_lanes, row, copy % n_lanes] = blocks[last // n_lanes, row, last % n_lanes]
