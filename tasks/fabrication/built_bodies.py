"""Rigid bodies: which links are one part, and how parts move against one another. Paper, "Manufacturing".

A joint whose motor is on turns; every other joint is locked at rest, so its two links are one part. Millimetres, in the
plane of the simulation (x forward, y up) with the root link upright at the origin, at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
from shapely import Polygon, affinity, box, unary_union
from shapely.geometry.base import BaseGeometry

from tasks.design import N_LINKS, Designs, rest_pose
from tasks.fabrication.kit_settings import KitSettings

Point = tuple[float, float]
Pose = npt.NDArray[np.float64]
"""A rigid motion of the plane as (cos, -sin, sin, cos, x, y), the order in which shapely takes it."""

SWEEP_STEP = np.radians(2.5)
"""Between the poses in which a turning part is looked at; at 300 mm from the joint its corners miss 0.07 mm."""
MOST_OF_TWO = 31
"""Angles at most of each of two joints: 6 degrees apart over the widest range, which misses 0.4 mm at 300 mm."""
N_GAIT = 96
"""Instants of one period at which a gait is looked at."""
RISING = np.linspace(1.0, 0.1, 10)
"""Shares of the full amplitude, the full one first, at which it is looked at: it rises from rest, and falls again."""


@dataclass(frozen=True, eq=False)
class Body:
    """Links that are one part."""

    index: int
    links: tuple[int, ...]
    depth: int
    """Joints that turn between it and the root's part."""
    outline: BaseGeometry
    """Union of its links."""

    @property
    def name(self) -> str:
        """As people count."""
        return f"part {self.index + 1}"


@dataclass(frozen=True)
class Joint:
    """A joint that turns."""

    link: int
    """Its child link; joints are numbered so."""
    parent_link: int
    parent: int
    """Index of the body that holds its parent link."""
    child: int
    """Index of the body that holds its child link."""
    at: Point
    rest_angle: float
    """Of the child link from its parent's at rest, within ±π [rad]."""
    motion_range: float
    """Amplitude [rad]."""
    phase: float
    """[rad]"""


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A design as parts and joints."""

    links: tuple[Polygon, ...]
    """Outline of every link."""
    link_centre: tuple[Point, ...]
    link_angle: tuple[float, ...]
    """Of every link's long axis from y [rad]."""
    link_size: tuple[Point, ...]
    """Width and height of every link."""
    parent_link: tuple[int, ...]
    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...]

    def path(self, start: int, end: int) -> list[tuple[Joint, int]]:
        """List the joints from one body to another; with each, 1 if it is passed from parent to child and -1 if not."""
        above = {joint.child: joint for joint in self.joints}

        def to_root(body: int) -> list[Joint]:
            chain = []
            while body in above:
                chain.append(above[body])
                body = above[body].parent
            return chain

        up, down = to_root(start), to_root(end)
        while up and down and up[-1] is down[-1]:
            up.pop()
            down.pop()
        return [(joint, -1) for joint in up] + [(joint, 1) for joint in reversed(down)]

    def poses_in_gait(self, seen_from: int, body: int) -> list[Pose]:
        """Give a body's poses, seen from another, at instants of one period of the gait and of its rise."""
        turn = 2 * np.pi * np.arange(N_GAIT) / N_GAIT
        path = self.path(seen_from, body)
        full = np.array([sign * joint.motion_range * np.sin(turn + joint.phase) for joint, sign in path])
        shares = RISING if len(path) > 1 else RISING[:1]  # one joint alone comes by the same angles
        return [_chained(path, share * angles) for share in shares for angles in full.T]

    def poses_in_range(self, seen_from: int, body: int) -> list[Pose]:
        """Give a body's poses, seen from another, with every joint between them anywhere in its range.

        Beyond two joints that would be too many; then the poses of the gait stand for them.
        """
        path = self.path(seen_from, body)
        if len(path) > 2:
            return self.poses_in_gait(seen_from, body)
        per_joint = []
        for joint, _ in path:
            n = 2 * int(np.ceil(joint.motion_range / SWEEP_STEP)) + 1
            most = n if len(path) == 1 else MOST_OF_TWO
            per_joint.append(np.linspace(-joint.motion_range, joint.motion_range, min(n, most)))
        return [_chained(path, np.array(angles)) for angles in product(*per_joint)]


def _chained(path: list[tuple[Joint, int]], angles: npt.NDArray[np.float64]) -> Pose:
    """Compose the turns about each joint's place at rest, from the far end of the path to its start."""
    rotation, shift = np.eye(2), np.zeros(2)
    for (joint, _), angle in zip(reversed(path), angles[::-1], strict=True):
        c, s = np.cos(angle), np.sin(angle)
        turn, at = np.array([[c, -s], [s, c]]), np.array(joint.at)
        rotation, shift = turn @ rotation, turn @ (shift - at) + at
    return np.array([*rotation.ravel(), *shift])


def moved(shape: BaseGeometry, pose: Pose) -> BaseGeometry:
    """Move a shape."""
    return affinity.affine_transform(shape, pose.tolist())


def swept(shape: BaseGeometry, poses: list[Pose]) -> BaseGeometry:
    """Give all that a shape covers in any of its poses."""
    return unary_union([moved(shape, pose) for pose in poses])


def mechanism_of(design: Designs, settings: KitSettings) -> Mechanism:
    """Find the parts and the turning joints of one design, at the bench's scale.

    Args:
        design: one valid design.
        settings: their scale is used.
    """
    scale = settings.scale_mm_per_m
    x, y, angle = (array[0] for array in rest_pose(design))
    length, parent, turns = design.length_scale[0], design.parent[0], design.motor_on[0]
    links = []
    for link in range(N_LINKS):
        half_w, half_h = scale / length[link] / 2, scale * length[link] / 2
        upright = affinity.rotate(box(-half_w, -half_h, half_w, half_h), angle[link], origin=(0, 0), use_radians=True)
        links.append(affinity.translate(upright, scale * x[link], scale * y[link]))
    body_of = [0] * N_LINKS
    members: list[list[int]] = [[0]]
    depth = [0]
    joints = []
    for link in range(1, N_LINKS):
        above = int(parent[link])
        if not turns[link]:
            body_of[link] = body_of[above]
            members[body_of[link]].append(link)
            continue
        body_of[link] = len(members)
        members.append([link])
        depth.append(depth[body_of[above]] + 1)
        along = design.child_attachment[0, link] * length[link] / 2
        at = (scale * (x[link] - np.sin(angle[link]) * along), scale * (y[link] + np.cos(angle[link]) * along))
        joints.append(
            Joint(
                link=link,
                parent_link=above,
                parent=body_of[above],
                child=body_of[link],
                at=(float(at[0]), float(at[1])),
                rest_angle=float(design.rest_angle[0, link]),
                motion_range=float(design.motion_range[0, link]),
                phase=float(design.phase[0, link]),
            )
        )
    bodies = tuple(
        Body(index, tuple(of), depth[index], unary_union([links[link] for link in of]))
        for index, of in enumerate(members)
    )
    return Mechanism(
        links=tuple(links),
        link_centre=tuple(zip((scale * x).tolist(), (scale * y).tolist(), strict=True)),
        link_angle=tuple(angle.tolist()),
        link_size=tuple(zip((scale / length).tolist(), (scale * length).tolist(), strict=True)),
        parent_link=tuple(int(p) for p in parent),
        bodies=bodies,
        joints=tuple(joints),
    )
