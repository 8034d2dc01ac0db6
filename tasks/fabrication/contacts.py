"""Contacts of the simulation that the robot on the bench does not have.

In the simulation all links lie in one plane and collide unless a joint connects them. On the bench the parts lie in two
layers (tasks/fabrication/servo_joints.py). Parts of one layer collide there too (tasks/fabrication/checks.py). Parts of
different layers pass each other: if their links touched in the simulated run, the run does not predict the bench.
"""

from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import numpy as np
import shapely

from tasks.arrays import Floats
from tasks.design import Designs
from tasks.fabrication.built_bodies import Mechanism
from tasks.fabrication.rods import Layers

_TOUCHING_DISTANCE = 0.02  # [m]: the skins of two Box2D polygons, in double precision as the outlines are


@dataclass(frozen=True)
class PassingContact:
    """Two links that touched in a run and belong to parts that pass each other on the bench."""

    links: tuple[int, int]
    parts: tuple[int, int]  # indices of their parts
    joints: tuple[int, ...]  # joints between those parts, by the numbers of their child links
    share: float  # share of the run's steps in which they touched
    first: float  # time of the first contact [s of simulation]


def passing_contacts(
    design: Designs, mechanism: Mechanism, layers: Layers, pose: Floats, *, time_step: float
) -> list[PassingContact]:
    """Find the contacts of a run of one design that a kit does not have, longest first.

    ``pose`` is (n_steps, n_links, 3): x, y [m] and angle [rad] of every link after each step.
    """
    outlines = _outlines(design.length_scale[0], pose.astype(np.float64))
    found = []
    for a, b in combinations(mechanism.bodies, 2):
        joints = tuple(joint.link for joint, _ in mechanism.path(a.index, b.index))
        for first, second in map(sorted, product(a.links, b.links)):
            if layers.outer[a.index] == layers.outer[b.index] or mechanism.parent_link[second] == first:
                continue  # in one layer; joined links never collide
            touching = shapely.distance(outlines[:, first], outlines[:, second]) <= _TOUCHING_DISTANCE
            if touching.any():
                share, start = float(touching.mean()), float(touching.argmax() + 1) * time_step
                found.append(PassingContact((first, second), (a.index, b.index), joints, share, start))
    return sorted(found, key=lambda contact: -contact.share)


def _outlines(length_scale: Floats, pose: Floats) -> Any:
    """Return (n_steps, n_links) polygons."""
    half = np.stack([0.5 / length_scale, 0.5 * length_scale], axis=-1)  # width is 1 over the height
    corners = half[:, None] * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # (n_links, 4, 2)
    c, s = np.cos(pose[..., 2, None]), np.sin(pose[..., 2, None])
    x = pose[..., 0, None] + c * corners[..., 0] - s * corners[..., 1]
    y = pose[..., 1, None] + s * corners[..., 0] + c * corners[..., 1]
    return shapely.polygons(np.stack([x, y], axis=-1))
