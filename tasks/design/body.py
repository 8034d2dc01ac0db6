"""Bodies: kinematic trees at rest, as the engines need them. Paper, "Evolutionary Design".

A link is a rectangle whose long axis is its local y and whose origin is its centre. A joint connects the point
(0, parent_attachment · a_parent / 2) of the parent to (0, child_attachment · a_child / 2) of the child.

A locked joint fuses its two links to one rigid body. The body's frame is that of its first link: the link nearest the
root, which has the lowest index.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tasks.arrays import Bools, Float32, Float64, Int64
from tasks.compiled import compiled
from tasks.design.genes import FIRST, N_PER_LINK, Designs, DesignTable, count_links


@dataclass(frozen=True, eq=False)
class KinematicTrees:
    """Bodies of designs at rest, rounded once to float32; every array is (n_designs, n_links)."""

    parent: Int64  # index of the parent; -1 for the root
    half_width: Float32  # [m]
    half_height: Float32  # [m]
    mass: Float32  # [kg]
    inertia: Float32  # moment of inertia about the centre [kg·m²]
    parent_anchor: Float32  # position of the joint along the parent's y axis, from its centre [m]; 0 for the root
    child_anchor: Float32  # position of the joint along the link's own y axis, from its centre [m]; 0 for the root
    x: Float32  # centre at the spawn [m]; the root's is 0
    y: Float32  # centre at the spawn [m]; the lowest corner of the robot is at 0
    angle: Float32  # angle at the spawn [rad]; the root is upright, at 0


_LENGTH, _PARENT, _PARENT_ATTACHMENT, _CHILD_ATTACHMENT, _JOINT_ANGLE = (
    FIRST[name] for name in ("length_scale", "parent", "parent_attachment", "child_attachment", "rest_angle")
)

_X, _Y, _ANGLE, _SINE, _COSINE, _PARENT_ANCHOR, _CHILD_ANCHOR = range(7)
"""Quantities of :func:`hang_links`: centre [m], angle [rad], its sine and cosine; distance of the joint from the
centres of parent and link [m], 0 for the root."""


def hang_links(table: DesignTable, n_of_link: int) -> Float64:
    """Return (n_designs, 7, n_links) quantities listed above, the root upright at the origin; 0 where a link lacks."""
    room = table.shape[1] // n_of_link
    rest = np.zeros((len(table), 7, room))
    for design in range(len(table)):
        genes_of, links = table[design, : N_PER_LINK * room].reshape(N_PER_LINK, room), rest[design]
        links[_COSINE, 0] = 1.0
        for link in range(1, count_links(genes_of[_PARENT])):
            above = int(genes_of[_PARENT, link])
            along_parent = genes_of[_PARENT_ATTACHMENT, link] * genes_of[_LENGTH, above] / 2
            along_child = genes_of[_CHILD_ATTACHMENT, link] * genes_of[_LENGTH, link] / 2
            turned = links[_ANGLE, above] + genes_of[_JOINT_ANGLE, link]
            sine, cosine = np.sin(turned), np.cos(turned)
            links[_X, link] = links[_X, above] - links[_SINE, above] * along_parent + sine * along_child
            links[_Y, link] = links[_Y, above] + links[_COSINE, above] * along_parent - cosine * along_child
            links[_ANGLE, link], links[_SINE, link], links[_COSINE, link] = turned, sine, cosine
            links[_PARENT_ANCHOR, link], links[_CHILD_ANCHOR, link] = along_parent, along_child
    return rest


_hang_links = compiled(hang_links, seconds=1)  # slow in NumPy for 64 designs


def rest_pose(designs: Designs) -> tuple[Float64, Float64, Float64]:
    """Place the links by their rest angles, the root upright with its centre at the origin.

    Returns:
        x [m], y [m] and angle [rad] of every link, each (n_designs, n_links). Angles add up along the tree, unwrapped.
    """
    rest = _hang_links(designs.table, designs.table.shape[1] // designs.room)
    return rest[:, _X], rest[:, _Y], rest[:, _ANGLE]


def spawn_links(table: DesignTable, n_of_link: int, density: float) -> Float32:
    """Return (9, n_designs, n_links) fields of KinematicTrees after ``parent``, in their order; density in [kg/m²]."""
    rest = _hang_links(table, n_of_link)
    room = rest.shape[2]
    single = np.zeros((9, len(table), room), np.float32)
    for design in range(len(table)):
        lowest, n_links = np.inf, count_links(table[design, _PARENT * room : (_PARENT + 1) * room])
        for link in range(n_links):
            along, width = table[design, _LENGTH + link], 1.0 / table[design, _LENGTH + link]
            of_length = abs(rest[design, _COSINE, link]) * along / 2
            of_width = abs(rest[design, _SINE, link]) * width / 2
            lowest = min(lowest, rest[design, _Y, link] - of_length - of_width)
        for link in range(n_links):
            along, width = table[design, _LENGTH + link], 1.0 / table[design, _LENGTH + link]
            mass = density * width * along
            single[0, design, link], single[1, design, link] = width / 2, along / 2
            single[2, design, link] = mass
            single[3, design, link] = mass * (width * width + along * along) / 12
            single[4, design, link] = rest[design, _PARENT_ANCHOR, link]
            single[5, design, link] = rest[design, _CHILD_ANCHOR, link]
            single[6, design, link] = rest[design, _X, link]
            single[7, design, link] = rest[design, _Y, link] - lowest
            single[8, design, link] = rest[design, _ANGLE, link]
    return single


spawn_kernel = compiled(spawn_links, seconds=1)


def kinematic_trees(designs: Designs, *, density: float) -> KinematicTrees:
    """Return the bodies of valid designs as they are spawned, the root at x = 0; density in [kg/m²]."""
    return KinematicTrees(designs.parent, *spawn_kernel(designs.table, designs.table.shape[1] // designs.room, density))


PassiveJoints = Literal["swing", "locked"]  # behaviour of a joint whose motor is off


@dataclass(frozen=True, eq=False)
class RigidBodies:
    """Links in the frames of their rigid bodies, rounded once to float32; every array is (n_designs, n_links).

    A link that is a body by itself is its own first link, at the origin of the body's frame, with shares of 1.
    """

    first_link: Int64  # first link of the link's body
    x: Float32  # centre of the link in the body's frame [m]
    y: Float32  # [m]
    angle: Float32  # angle of the link in the body's frame [rad]
    cos: Float32  # cosine of that angle
    sin: Float32  # sine of that angle
    lever_x: Float32  # vector from the body's centre of mass to the link's centre, in the body's frame [m]
    lever_y: Float32  # [m]
    mass_share: Float32  # mass of the link over that of the body
    inertia_share: Float32  # moment of inertia of the link over that of the body, each about its own centre of mass
    mass_over_inertia: Float32  # mass of the link over the body's moment of inertia [1/m²]
    joint_x: Float32  # joint of the link in the frame of the parent's body [m]; 0 for the root
    joint_y: Float32  # [m]

    @property
    def is_first(self) -> Bools:
        """(n_designs, n_links) whether a link is its body's first: the root, or the child of a joint that moves."""
        return np.asarray(self.first_link == np.arange(self.first_link.shape[1]))


def rigid_bodies(designs: Designs, *, passive_joints: PassiveJoints) -> RigidBodies:
    """Fuse the links of valid designs that locked joints connect."""
    (n_designs, n_links), design = designs.parent.shape, np.arange(len(designs))
    rest = _hang_links(designs.table, designs.table.shape[1] // designs.room)
    parent_anchor, child_anchor = rest[:, _PARENT_ANCHOR], rest[:, _CHILD_ANCHOR]
    first_link = np.tile(np.arange(n_links), (n_designs, 1))
    x, y, angle, joint_x, joint_y = (np.zeros((n_designs, n_links)) for _ in range(5))
    for link in range(1, n_links):
        parent, along = designs.parent[:, link], parent_anchor[:, link]
        above = angle[design, parent]
        joint_x[:, link] = x[design, parent] - np.sin(above) * along
        joint_y[:, link] = y[design, parent] + np.cos(above) * along
        if passive_joints == "locked":
            locked, along = ~designs.motor_on[:, link], child_anchor[:, link]
            turned = above + designs.rest_angle[:, link]
            first_link[:, link] = np.where(locked, first_link[design, parent], link)
            angle[:, link] = np.where(locked, turned, 0.0)
            x[:, link] = np.where(locked, joint_x[:, link] + np.sin(turned) * along, 0.0)
            y[:, link] = np.where(locked, joint_y[:, link] - np.cos(turned) * along, 0.0)

    def over_body(quantity: Float64) -> Float64:
        """Sum over the links of each body; return the body's sum for each link."""
        total = np.zeros((n_designs, n_links))
        for link in range(n_links):
            total[design, first_link[:, link]] += quantity[:, link]
        return np.take_along_axis(total, first_link, axis=1)

    length = designs.length_scale
    width = 1.0 / length
    mass = width * length  # of unit density, which cancels out
    inertia = mass * (width**2 + length**2) / 12
    body_mass = over_body(mass)
    lever_x, lever_y = x - over_body(mass * x) / body_mass, y - over_body(mass * y) / body_mass
    body_inertia = over_body(inertia + mass * (lever_x**2 + lever_y**2))  # the parallel-axis theorem
    rounded_angle = angle.astype(np.float32).astype(np.float64)
    pose = x, y, angle, np.cos(rounded_angle), np.sin(rounded_angle), lever_x, lever_y
    shares = mass / body_mass, inertia / body_inertia, mass / body_inertia
    return RigidBodies(first_link, *(quantity.astype(np.float32) for quantity in (*pose, *shares, joint_x, joint_y)))
