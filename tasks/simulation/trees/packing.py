"""Packing robots into lanes: constants and initial state of each robot, in the rows of its group's block."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from tasks.arrays import Float32, Int64
from tasks.design.body import kinematic_trees
from tasks.design.genes import N_LINKS, Designs
from tasks.simulation.trees import layout
from tasks.simulation.trees.contact import NO_VERTEX
from tasks.world.physics import Physics


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
_TREE_WEIGHTS = np.array([0, *(len(TREES) // math.factorial(link) for link in range(1, N_LINKS))])
"""parents · weights is the index of a tree in TREES."""


def _inverse_mass_and_inertia(half_width: Float32, half_height: Float32, density: float) -> tuple[Float32, Float32]:
    """Return inverse mass [1/kg] and inertia [1/(kg·m²)] of boxes by their half axes [m] and density [kg/m²].

    b2PolygonShape::ComputeMass adds up four triangles, which are equal in area here; its sums and their order are kept.
    """
    xx, yy, area = half_width * half_width, half_height * half_height, half_width * half_height
    moment = np.float32(0.25) * (np.float32(1) / np.float32(3)) * (area + area)
    lying, standing = moment * (xx + (yy + yy + yy)), moment * (xx + xx + xx + yy)
    rho, one = np.float32(density), np.float32(1)
    return one / (rho * (area + area + area + area)), one / (rho * (lying + standing + lying + standing))


def pack(designs: Designs, physics: Physics, n_members: int, blocks: Float32) -> Int64:
    """Spawn n_members robots of each of n_designs designs in the lanes of (n_groups, N_ROWS, n_lanes) blocks of zeros.

    Robot member · n_designs + design is in lane i mod n_lanes of group i // n_lanes. Lanes left over at the end get
    copies of the last robot.

    Returns:
        (n_designs, n_links) the engine's numbers of the links.
    """
    n_designs, (n_groups, _, n_lanes) = len(designs), blocks.shape
    tree = designs.parent @ _TREE_WEIGHTS
    order: Int64 = _ORDER_OF_TREE[tree]
    number: Int64 = _NUMBER_OF_TREE[tree]
    trees = kinematic_trees(designs, density=physics.link_density)
    length = designs.length_scale.astype(np.float32)
    inverse = _inverse_mass_and_inertia(trees.half_width, trees.half_height, physics.link_density)
    above = np.take_along_axis(number, np.maximum(designs.parent, 0), axis=1)
    impulse = designs.motor_on * (np.float32(physics.time_step) * np.float32(physics.max_motor_torque))
    pose, sizes = (trees.x, trees.y, trees.angle), (trees.half_width, trees.half_height)
    masses = length, trees.mass, trees.inertia
    anchors = trees.parent_anchor, trees.child_anchor

    def ordered(*quantities: Float32 | Int64) -> Float32:
        """Return (n_designs, n_quantities, n_links) quantities of the links in the engine's order."""
        return np.take_along_axis(np.stack(quantities, axis=1, dtype=np.float32), order[:, None], axis=2)

    of_links = ordered(*pose, *sizes, *inverse, *masses)
    of_joints = ordered(above, *anchors, impulse)[..., 1:]
    of_parents = np.take_along_axis(of_links[:, 5:7], of_joints[:, :1].astype(np.int64), axis=2)  # of ``inverse``
    robots = np.zeros((n_designs, layout.N_PACKED), np.float32)
    for first, end, rows in (
        (layout.X, layout.VX, of_links[:, :3]),
        (layout.HALF_WIDTH, layout.PARENT, of_links[:, 3:]),
        (layout.PARENT, layout.PARENT_INVERSE_MASS, of_joints[:, :1]),
        (layout.PARENT_INVERSE_MASS, layout.PARENT_ANCHOR, of_parents),
        (layout.PARENT_ANCHOR, layout.N_PACKED, of_joints[:, 1:]),
    ):
        robots[:, first:end] = rows.reshape(n_designs, end - first)
    robots[:, layout.VERTEX : layout.NORMAL] = NO_VERTEX
    robot = np.minimum(np.arange(n_groups * n_lanes), n_members * n_designs - 1)
    of_lanes = robots[robot % max(n_designs, 1)].reshape(n_groups, n_lanes, layout.N_PACKED)
    blocks[:, : layout.N_PACKED] = of_lanes.transpose(0, 2, 1)
    return number
