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

from tasks.compiled import compiled
from tasks.design import genes
from tasks.design.genes import N_LINKS, Designs

Floats = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]


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


def hang_links(
    parent: npt.NDArray[np.int64], rest_angle: Floats, parent_anchor: Floats, child_anchor: Floats,
    x: Floats, y: Floats, angle: Floats,
) -> None:  # fmt: skip
    """Fill (n_designs, n_links) places and angles of links by their rest angles, the root upright at the origin."""
    for design in range(len(parent)):
        x[design, 0], y[design, 0], angle[design, 0] = 0.0, 0.0, 0.0
        for link in range(1, N_LINKS):
            above = parent[design, link]
            turned = angle[design, above] + rest_angle[design, link]
            along_parent, along_child = parent_anchor[design, link], child_anchor[design, link]
            sine, cosine = np.sin(angle[design, above]), np.cos(angle[design, above])
            x[design, link] = x[design, above] - sine * along_parent + np.sin(turned) * along_child
            y[design, link] = y[design, above] + cosine * along_parent - np.cos(turned) * along_child
            angle[design, link] = turned


_hang_links = compiled(hang_links, [genes], seconds=1)  # in NumPy it takes longer than 64 designs are worth


def rest_pose(designs: Designs) -> tuple[Floats, Floats, Floats]:
    """Place the links by their rest angles, the root upright with its centre at the origin.

    Returns:
        x [m], y [m] and angle [rad] of every link, each (n_designs, n_links). Angles add up along the tree, unwrapped.
    """
    x, y, angle = np.empty((3, len(designs), N_LINKS))
    _hang_links(designs.parent, designs.rest_angle, *_anchors(designs), x, y, angle)
    return x, y, angle


def _anchors(designs: Designs) -> tuple[Floats, Floats]:
    """Distance of each joint from the centres of the two links that it ties [m]; 0 for the root."""
    jointed = np.arange(N_LINKS) > 0
    parent_length = np.take_along_axis(designs.length_scale, np.maximum(designs.parent, 0), axis=1)
    return (
        np.where(jointed, designs.parent_attachment * parent_length / 2, 0.0),
        np.where(jointed, designs.child_attachment * designs.length_scale / 2, 0.0),
    )


def spawn_links(
    length: Floats, parent: npt.NDArray[np.int64], rest_angle: Floats, parent_anchor: Floats, child_anchor: Floats,
    density: float, x: Floats, y: Floats, angle: Floats, single: Float32,
) -> None:  # fmt: skip
    """Fill (9, n_designs, n_links) what the fields of KinematicTrees but its parents are, in their order.

    x, y and angle are room for (n_designs, n_links) numbers.
    """
    _hang_links(parent, rest_angle, parent_anchor, child_anchor, x, y, angle)
    for design in range(len(parent)):
        lowest = np.inf
        for link in range(N_LINKS):
            of_length = abs(np.cos(angle[design, link])) * length[design, link] / 2
            of_width = abs(np.sin(angle[design, link])) * (1.0 / length[design, link]) / 2
            lowest = min(lowest, y[design, link] - of_length - of_width)
        for link in range(N_LINKS):
            along, width = length[design, link], 1.0 / length[design, link]
            mass = density * width * along
            single[0, design, link], single[1, design, link] = width / 2, along / 2
            single[2, design, link] = mass
            single[3, design, link] = mass * (width * width + along * along) / 12
            single[4, design, link] = parent_anchor[design, link]
            single[5, design, link] = child_anchor[design, link]
            single[6, design, link] = x[design, link]
            single[7, design, link] = y[design, link] - lowest
            single[8, design, link] = angle[design, link]


_spawn_links = compiled(spawn_links, [genes], seconds=1)


def kinematic_trees(designs: Designs, *, density: float) -> KinematicTrees:
    """Build the bodies of designs and spawn them: root at x = 0, lowest corner of the whole robot at y = 0.

    Args:
        designs: n_designs valid designs.
        density: of every link [kg/m²].
    """
    shape = len(designs), N_LINKS
    single = np.empty((9, *shape), np.float32)
    _spawn_links(
        designs.length_scale, designs.parent, designs.rest_angle, *_anchors(designs), density, *np.empty((3, *shape)),
        single,
    )  # fmt: skip
    return KinematicTrees(designs.parent, *single)


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
    parent_anchor, child_anchor = _anchors(designs)
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
