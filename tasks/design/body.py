"""Bodies: from designs to kinematic trees at rest, as the engines need them. Paper, "Evolutionary Design".

A link is a rectangle whose long axis is its local y and whose origin is its centre. A child's joint ties the point
(0, parent_attachment · a_parent / 2) of the parent to (0, child_attachment · a_child / 2) of the child.

A joint that is locked makes its two links parts of one rigid body. Of a body's links the one nearest the root, which
has the lowest index, represents it: the body's frame is that link's frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from tasks.arrays import Float32, Float64
from tasks.compiled import compiled
from tasks.design import genes
from tasks.design.genes import COLUMNS, N_LINKS, PARENT_COLUMN, Designs, DesignTable


@dataclass(frozen=True, eq=False)
class KinematicTrees:
    """Bodies of designs at rest, rounded once to the engines' precision; axis 0 is the design, axis 1 the link."""

    parent: npt.NDArray[np.int64]
    """(n_designs, n_links) parent's index; -1 for the root."""
    half_width: Float32
    """(n_designs, n_links) [m]"""
    half_height: Float32
    """(n_designs, n_links) [m]"""
    mass: Float32
    """(n_designs, n_links) [kg]"""
    inertia: Float32
    """(n_designs, n_links) about the centre [kg·m²]"""
    parent_anchor: Float32
    """(n_designs, n_links) joint's place along the parent's y axis, from its centre [m]; 0 for the root."""
    child_anchor: Float32
    """(n_designs, n_links) joint's place along the link's own y axis, from its centre [m]; 0 for the root."""
    x: Float32
    """(n_designs, n_links) centre when spawned [m]; the root's is 0."""
    y: Float32
    """(n_designs, n_links) centre when spawned [m]; the lowest corner of the robot is at 0."""
    angle: Float32
    """(n_designs, n_links) when spawned [rad]; the root is upright, at 0."""


LENGTH, PARENT_ATTACHMENT, CHILD_ATTACHMENT, JOINT_ANGLE = (
    COLUMNS[name].start for name in ("length_scale", "parent_attachment", "child_attachment", "rest_angle")
)
"""Columns of the root's genes in a table of designs; those of the other links follow."""

REST_X, REST_Y, REST_ANGLE, REST_SINE, REST_COSINE, PARENT_ANCHOR, CHILD_ANCHOR = range(7)
"""What :func:`hang_links` gives of each link: centre [m], angle [rad], its sine and cosine; joint's distance from the
centres of parent and link [m], 0 for the root."""


def hang_links(table: DesignTable) -> Float64:
    """Place links by their rest angles, the root upright at the origin.

    Args:
        table: (n_designs, N_COLUMNS) of valid designs.

    Returns:
        (n_designs, 7, n_links), see above.
    """
    rest = np.zeros((len(table), 7, N_LINKS))
    for design in range(len(table)):
        genes_of, links = table[design], rest[design]
        links[REST_COSINE, 0] = 1.0
        for link in range(1, N_LINKS):
            above = int(genes_of[PARENT_COLUMN + link])
            along_parent = genes_of[PARENT_ATTACHMENT + link] * genes_of[LENGTH + above] / 2
            along_child = genes_of[CHILD_ATTACHMENT + link] * genes_of[LENGTH + link] / 2
            turned = links[REST_ANGLE, above] + genes_of[JOINT_ANGLE + link]
            sine, cosine = np.sin(turned), np.cos(turned)
            links[REST_X, link] = links[REST_X, above] - links[REST_SINE, above] * along_parent + sine * along_child
            links[REST_Y, link] = links[REST_Y, above] + links[REST_COSINE, above] * along_parent - cosine * along_child
            links[REST_ANGLE, link], links[REST_SINE, link], links[REST_COSINE, link] = turned, sine, cosine
            links[PARENT_ANCHOR, link], links[CHILD_ANCHOR, link] = along_parent, along_child
    return rest


_hang_links = compiled(hang_links, [genes], seconds=1)  # in NumPy it takes longer than 64 designs are worth


def rest_pose(designs: Designs) -> tuple[Float64, Float64, Float64]:
    """Place the links by their rest angles, the root upright with its centre at the origin.

    Args:
        designs: n_designs valid designs.

    Returns:
        x [m], y [m] and angle [rad] of every link, each (n_designs, n_links). Angles add up along the tree, unwrapped.
    """
    rest = _hang_links(designs.table)
    return rest[:, REST_X], rest[:, REST_Y], rest[:, REST_ANGLE]


def spawn_links(table: DesignTable, density: float) -> Float32:
    """Spawn links: the fields of KinematicTrees but the parents, in their order.

    Args:
        table: (n_designs, N_COLUMNS) of valid designs.
        density: of every link [kg/m²].

    Returns:
        (9, n_designs, n_links)
    """
    rest, single = _hang_links(table), np.empty((9, len(table), N_LINKS), np.float32)
    for design in range(len(table)):
        lowest = np.inf
        for link in range(N_LINKS):
            along, width = table[design, LENGTH + link], 1.0 / table[design, LENGTH + link]
            of_length = abs(rest[design, REST_COSINE, link]) * along / 2
            of_width = abs(rest[design, REST_SINE, link]) * width / 2
            lowest = min(lowest, rest[design, REST_Y, link] - of_length - of_width)
        for link in range(N_LINKS):
            along, width = table[design, LENGTH + link], 1.0 / table[design, LENGTH + link]
            mass = density * width * along
            single[0, design, link], single[1, design, link] = width / 2, along / 2
            single[2, design, link] = mass
            single[3, design, link] = mass * (width * width + along * along) / 12
            single[4, design, link] = rest[design, PARENT_ANCHOR, link]
            single[5, design, link] = rest[design, CHILD_ANCHOR, link]
            single[6, design, link] = rest[design, REST_X, link]
            single[7, design, link] = rest[design, REST_Y, link] - lowest
            single[8, design, link] = rest[design, REST_ANGLE, link]
    return single


spawn_kernel = compiled(spawn_links, [genes], seconds=1)


def kinematic_trees(designs: Designs, *, density: float) -> KinematicTrees:
    """Build the bodies of designs and spawn them: root at x = 0, lowest corner of the whole robot at y = 0.

    Args:
        designs: n_designs valid designs.
        density: of every link [kg/m²].
    """
    return KinematicTrees(designs.parent, *spawn_kernel(designs.table, density))


PassiveJoints = Literal["swing", "locked"]
"""What a joint does whose motor is off."""


@dataclass(frozen=True, eq=False)
class RigidBodies:
    """How links make up rigid bodies, rounded once to the engines' precision; axis 0 is the design, axis 1 the link.

    A link that is a body by itself is its own first link, at the origin of the body's frame, with shares of 1.
    """

    first_link: npt.NDArray[np.int64]
    """(n_designs, n_links) the link that represents the body: of its links, the one nearest the root."""
    x: Float32
    """(n_designs, n_links) the link's centre in the body's frame [m]."""
    y: Float32
    """(n_designs, n_links) [m]"""
    angle: Float32
    """(n_designs, n_links) the link's angle in the body's frame [rad]."""
    cos: Float32
    """(n_designs, n_links) of that angle."""
    sin: Float32
    """(n_designs, n_links) of that angle."""
    lever_x: Float32
    """(n_designs, n_links) the link's centre less the body's centre of mass, in the body's frame [m]."""
    lever_y: Float32
    """(n_designs, n_links) [m]"""
    mass_share: Float32
    """(n_designs, n_links) the link's mass over the body's."""
    inertia_share: Float32
    """(n_designs, n_links) the link's moment of inertia over the body's, each about its own centre of mass."""
    mass_over_inertia: Float32
    """(n_designs, n_links) the link's mass over the body's moment of inertia [1/m²]."""
    joint_x: Float32
    """(n_designs, n_links) the link's joint in the frame of its parent's body [m]; 0 for the root."""
    joint_y: Float32
    """(n_designs, n_links) [m]"""

    @property
    def is_first(self) -> npt.NDArray[np.bool_]:
        """(n_designs, n_links) whether a link represents a body: it is the root, or hangs from a joint that moves."""
        return np.asarray(self.first_link == np.arange(N_LINKS))


def rigid_bodies(designs: Designs, *, passive_joints: PassiveJoints) -> RigidBodies:
    """Fuse the links that locked joints tie: those whose motor is off, where passive joints are locked.

    Args:
        designs: n_designs valid designs.
        passive_joints: what a joint does whose motor is off.
    """
    n_designs, design = len(designs), np.arange(len(designs))
    rest = _hang_links(designs.table)
    parent_anchor, child_anchor = rest[:, PARENT_ANCHOR], rest[:, CHILD_ANCHOR]
    first_link = np.tile(np.arange(N_LINKS), (n_designs, 1))
    x, y, angle, joint_x, joint_y = (np.zeros((n_designs, N_LINKS)) for _ in range(5))
    for link in range(1, N_LINKS):
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

    def over_body(quantity: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Add up the links of each body, and give each link its body's sum."""
        total = np.zeros((n_designs, N_LINKS))
        for link in range(N_LINKS):
            total[design, first_link[:, link]] += quantity[:, link]
        return np.take_along_axis(total, first_link, axis=1)

    length = designs.length_scale
    width = 1.0 / length
    mass = width * length  # of unit density, which cancels out
    inertia = mass * (width**2 + length**2) / 12
    body_mass = over_body(mass)
    lever_x, lever_y = x - over_body(mass * x) / body_mass, y - over_body(mass * y) / body_mass
    body_inertia = over_body(inertia + mass * (lever_x**2 + lever_y**2))  # the parallel-axis theorem
    single = np.float32
    rounded_angle = angle.astype(single)
    return RigidBodies(
        first_link=first_link,
        x=x.astype(single),
        y=y.astype(single),
        angle=rounded_angle,
        cos=np.cos(rounded_angle.astype(np.float64)).astype(single),
        sin=np.sin(rounded_angle.astype(np.float64)).astype(single),
        lever_x=lever_x.astype(single),
        lever_y=lever_y.astype(single),
        mass_share=(mass / body_mass).astype(single),
        inertia_share=(inertia / body_inertia).astype(single),
        mass_over_inertia=(mass / body_inertia).astype(single),
        joint_x=joint_x.astype(single),
        joint_y=joint_y.astype(single),
    )
