"""Packing robots into lanes: constants and initial state of each robot, in the rows of its group's block."""

import numpy as np

from tasks.arrays import Float32, Int64
from tasks.compiled import compiled
from tasks.design.body import kinematic_trees
from tasks.design.genes import Designs
from tasks.simulation.trees import layout
from tasks.simulation.trees.contact import NO_VERTEX
from tasks.world.physics import Physics


def discovery_order(parent: Int64) -> Int64:
    """Return the order in which Box2D's island search (b2World::Solve) finds links; both are (n_designs, n_links).

    The root comes first. The links were created from the last to the root, the joints from the first on.
    """
    n_designs, n_links = parent.shape
    order, stack = np.zeros((n_designs, n_links), np.int64), np.zeros(n_links, np.int64)
    for design in range(n_designs):
        n_found, n_stack = 1, 1
        stack[0] = 0
        while n_stack > 0:
            n_stack -= 1
            link = stack[n_stack]
            for child in range(n_links - 1, link, -1):  # a body lists its joints with the latest first
                if parent[design, child] == link:
                    order[design, n_found] = stack[n_stack] = child
                    n_found, n_stack = n_found + 1, n_stack + 1
    return order


_discovery_order = compiled(discovery_order, seconds=1)


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
    order: Int64 = _discovery_order(designs.parent)
    number: Int64 = np.argsort(order, axis=1)
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
    robots = np.zeros((n_designs, layout.N_PACKED // layout.ROOM, layout.ROOM), np.float32)
    for first, quantities in (
        (layout.X, of_links[:, :3]),
        (layout.HALF_WIDTH, of_links[:, 3:]),
        (layout.PARENT, of_joints[:, :1]),
        (layout.PARENT_INVERSE_MASS, of_parents),
        (layout.PARENT_ANCHOR, of_joints[:, 1:]),
    ):
        _, n_quantities, n_rows = quantities.shape
        robots[:, first // layout.ROOM :][:, :n_quantities, :n_rows] = quantities
    robots[:, layout.VERTEX // layout.ROOM : layout.NORMAL // layout.ROOM] = NO_VERTEX
    robot = np.minimum(np.arange(n_groups * n_lanes), n_members * n_designs - 1)
    of_lanes = robots[robot % max(n_designs, 1)].reshape(n_groups, n_lanes, layout.N_PACKED)
    blocks[:, : layout.N_PACKED] = of_lanes.transpose(0, 2, 1)
    return number
