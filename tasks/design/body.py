"""Bodies: from designs to kinematic trees at rest, as the engines need them. Paper, "Evolutionary Design".

A link is a rectangle whose long axis is its local y and whose origin is its centre. A child's joint ties the point
(0, parent_attachment · a_parent / 2) of the parent to (0, child_attachment · a_child / 2) of the child.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tasks.design.genes import N_LINKS, Designs

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


def rest_pose(designs: Designs) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Place the links by their rest angles, the root upright with its centre at the origin.

    Returns:
        x [m], y [m] and angle [rad] of every link, each (n_designs, n_links). Angles add up along the tree, unwrapped.
    """
    n_designs = len(designs)
    x, y, angle = (np.zeros((n_designs, N_LINKS)) for _ in range(3))
    design = np.arange(n_designs)
    parent_anchor, child_anchor = _anchors(designs)
    for link in range(1, N_LINKS):
        parent = designs.parent[:, link]
        above = angle[design, parent]
        angle[:, link] = above + designs.rest_angle[:, link]
        along_parent, along_child = parent_anchor[:, link], child_anchor[:, link]
        x[:, link] = x[design, parent] - np.sin(above) * along_parent + np.sin(angle[:, link]) * along_child
        y[:, link] = y[design, parent] + np.cos(above) * along_parent - np.cos(angle[:, link]) * along_child
    return x, y, angle


def _anchors(designs: Designs) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Distance of each joint from the centres of the two links that it ties [m]; 0 for the root."""
    jointed = np.arange(N_LINKS) > 0
    parent_length = np.take_along_axis(designs.length_scale, np.maximum(designs.parent, 0), axis=1)
    return (
        np.where(jointed, designs.parent_attachment * parent_length / 2, 0.0),
        np.where(jointed, designs.child_attachment * designs.length_scale / 2, 0.0),
    )


def kinematic_trees(designs: Designs, *, density: float) -> KinematicTrees:
    """Build the bodies of designs and spawn them: root at x = 0, lowest corner of the whole robot at y = 0.

    Args:
        designs: n_designs valid designs.
        density: of every link [kg/m²].
    """
    length = designs.length_scale
    width = 1.0 / length
    x, y, angle = rest_pose(designs)
    lowest = y - np.abs(np.cos(angle)) * length / 2 - np.abs(np.sin(angle)) * width / 2
    y = y - lowest.min(axis=1, keepdims=True)
    mass = density * width * length
    parent_anchor, child_anchor = _anchors(designs)
    single = np.float32
    return KinematicTrees(
        parent=designs.parent,
        half_width=(width / 2).astype(single),
        half_height=(length / 2).astype(single),
        mass=mass.astype(single),
        inertia=(mass * (width**2 + length**2) / 12).astype(single),
        parent_anchor=parent_anchor.astype(single),
        child_anchor=child_anchor.astype(single),
        x=x.astype(single),
        y=y.astype(single),
        angle=angle.astype(single),
    )
