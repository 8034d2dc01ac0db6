"""Contacts: links that push one another in the simulation and pass one another on the bench.

In the simulation all links lie in one plane, and those that no joint ties collide. On the bench parts lie in two layers
(tasks/fabrication/servo_joints.py): parts of one layer meet there as well, and what comes of that is checked in the plane
(tasks/fabrication/checks.py). Parts of different layers pass one another whole. Where their links touched in the
simulated run, the robot on the bench moves on and the simulated one was stopped: the run is no prediction then.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
import shapely

from tasks.arrays import Floats
from tasks.design import Designs
from tasks.fabrication.built_bodies import Mechanism
from tasks.fabrication.rods import Layers
from tasks.simulation.box2d import TOTAL_RADIUS


@dataclass(frozen=True)
class Contact:
    """Two links that touched in a run, of parts that pass one another on the bench."""

    links: tuple[int, int]
    parts: tuple[int, int]
    """Indices of the parts that they belong to."""
    joints: tuple[int, ...]
    """Between those parts, by the numbers of their child links."""
    share: float
    """Of the run's steps in which they touched."""
    first: float
    """When they did for the first time [s of simulation]."""


def passing_contacts(
    design: Designs, mechanism: Mechanism, layers: Layers, pose: Floats, *, time_step: float
) -> list[Contact]:
    """Find the contacts of a run that a kit does not have.

    Args:
        design: one design.
        mechanism: its parts.
        layers: which parts are outer ones.
        pose: (n_steps, n_links, 3) x and y of every link's centre [m] and its angle [rad], after each step.
        time_step: [s of simulation].

    Returns:
        Those that last longest first.
    """
    outlines = _outlines(design.length_scale[0], pose.astype(np.float64))
    found = []
    for a, b in combinations(mechanism.bodies, 2):
        if layers.outer[a.index] == layers.outer[b.index]:
            continue
        joints = tuple(joint.link for joint, _ in mechanism.path(a.index, b.index))
        for first, second in ((min(i, k), max(i, k)) for i in a.links for k in b.links):
            if mechanism.parent_link[second] == first:
                continue  # joined links never collide
            touching = shapely.distance(outlines[:, first], outlines[:, second]) <= TOTAL_RADIUS
            if touching.any():
                found.append(
                    Contact(
                        (first, second),
                        (a.index, b.index),
                        joints,
                        float(touching.mean()),
                        float(touching.argmax() + 1) * time_step,
                    )
                )
    return sorted(found, key=lambda contact: -contact.share)


def _outlines(length_scale: Floats, pose: Floats) -> npt.NDArray[np.object_]:
    """Draw every link at every step. Gives (n_steps, n_links) polygons."""
    half = np.stack([0.5 / length_scale, 0.5 * length_scale], axis=-1)  # width is 1 over the height
    corners = half[:, None] * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # (n_links, 4, 2)
    c, s = np.cos(pose[..., 2, None]), np.sin(pose[..., 2, None])
    x = pose[..., 0, None] + c * corners[..., 0] - s * corners[..., 1]
    y = pose[..., 1, None] + s * corners[..., 0] + c * corners[..., 1]
    polygons: npt.NDArray[np.object_] = shapely.polygons(np.stack([x, y], axis=-1))
    return polygons
