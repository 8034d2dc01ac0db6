"""The design as rigid parts and turning joints. Paper, "Manufacturing".

Joints whose motor is on turn. All others are locked at rest, so that their two links form one part. Lengths are in mm,
in the plane of the simulation (x forward, y up), with the robot at rest and the root link upright at the origin.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from shapely import Polygon, affinity, box, unary_union
from shapely.geometry.base import BaseGeometry

from tasks.arrays import Float64
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.design import Designs, rest_pose
from tasks.design.gait import reach, swing

Point = tuple[float, float]
Pose = Float64  # (6,) rigid motion of the plane in shapely's order: cos, -sin, sin, cos, x [mm], y [mm]

_SWEEP_STEP = np.radians(2.5)  # between sampled poses of a turning part; misses 0.07 mm at 300 mm from the joint
_MAX_ANGLES_OF_TWO = 31  # per joint of a pair: 6° apart over the widest range, which misses 0.4 mm at 300 mm
_N_GAIT = 96  # samples of one period
_AMPLITUDES = np.linspace(1.0, 0.1, 10)  # shares of the full amplitude: the gait rises from rest and falls again


@dataclass(frozen=True, eq=False)
class RigidPart:
    """Links that form one part."""

    index: int
    links: tuple[int, ...]
    depth: int  # number of turning joints between it and the part of the root
    outline: BaseGeometry  # union of its links

    @property
    def name(self) -> str:
        """Name of the part, counted from 1."""
        return f"part {self.index + 1}"


@dataclass(frozen=True, eq=False)
class TurningJoint:
    """A turning joint."""

    link: int  # child link, which numbers the joint
    parent_link: int
    parent: int  # index of the body with its parent link
    child: int  # index of the body with its child link
    at: Point
    rest_angle: float  # angle of the child link relative to its parent at rest, within ±π [rad]
    reach: float  # largest angle from rest in the gait [rad]
    swing: Float64  # angles from rest at _N_GAIT instants of a period of the gait [rad]


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A design as parts and joints."""

    links: tuple[Polygon, ...]  # (n_links) outlines of the links
    link_centre: tuple[Point, ...]
    link_angle: tuple[float, ...]  # (n_links) angles of the links' long axes from y [rad]
    link_size: tuple[Point, ...]  # (n_links) widths and heights of the links [mm]
    parent_link: tuple[int, ...]
    bodies: tuple[RigidPart, ...]
    joints: tuple[TurningJoint, ...]

    def path(self, start: int, end: int) -> list[tuple[TurningJoint, int]]:
        """List the joints from one body to another, with 1 where the path leads to the child and -1 elsewhere."""
        above, up, down = {joint.child: joint for joint in self.joints}, [], []
        while start != end:  # a child has a greater index than its parent
            if start > end:
                up.append((above[start], -1))
                start = above[start].parent
            else:
                down.append((above[end], 1))
                end = above[end].parent
        return up + down[::-1]

    def poses_in_gait(self, seen_from: int, body: int) -> list[Pose]:
        """Sample a body's poses relative to another over one period of the gait, at full and at rising amplitude."""
        path = self.path(seen_from, body)
        full = np.array([sign * joint.swing for joint, sign in path])
        shares = _AMPLITUDES if len(path) > 1 else _AMPLITUDES[:1]  # one joint alone passes through the same angles
        return [_chained(path, share * angles) for share in shares for angles in full.T]

    def poses_in_range(self, seen_from: int, body: int) -> list[Pose]:
        """Sample a body's poses relative to another with the joints between them anywhere in their ranges.

        With more than two joints there are too many, and the poses of the gait replace them.
        """
        path = self.path(seen_from, body)
        if len(path) > 2:
            return self.poses_in_gait(seen_from, body)
        per_joint = []
        for joint, _ in path:
            n = 2 * int(np.ceil(joint.reach / _SWEEP_STEP)) + 1
            most = n if len(path) == 1 else _MAX_ANGLES_OF_TWO
            per_joint.append(np.linspace(-joint.reach, joint.reach, min(n, most)))
        return [_chained(path, np.array(angles)) for angles in product(*per_joint)]


def _chained(path: list[tuple[TurningJoint, int]], angles: Float64) -> Pose:
    """Compose the turns about each joint's position at rest, from the far end of the path to its start."""
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
    """Return the union of a shape in all poses."""
    return unary_union([moved(shape, pose) for pose in poses])


def mechanism_of(design: Designs, settings: KitSettings) -> Mechanism:
    """Find the parts and the turning joints of one valid design, at the scale of the kit."""
    design = design.compact()
    scale = settings.scale_mm_per_m
    x, y, angle = (array[0] for array in rest_pose(design))
    length, parent, turns = design.length_scale[0], design.parent[0], design.motor_on[0]
    farthest, swings = reach(design)[0], swing(design, np.arange(_N_GAIT)[:, None, None] / _N_GAIT)[:, 0]
    links = []
    for link in range(len(parent)):
        half_w, half_h = scale / length[link] / 2, scale * length[link] / 2
        upright = affinity.rotate(box(-half_w, -half_h, half_w, half_h), angle[link], origin=(0, 0), use_radians=True)
        links.append(affinity.translate(upright, scale * x[link], scale * y[link]))
    body_of, members, depth = [0] * len(parent), [[0]], [0]
    joints = []
    for link in range(1, len(parent)):
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
        gait = float(design.rest_angle[0, link]), float(farthest[link]), swings[:, link]
        joints.append(TurningJoint(link, above, body_of[above], body_of[link], (float(at[0]), float(at[1])), *gait))
    bodies = tuple(
        RigidPart(index, tuple(body_links), depth[index], unary_union([links[link] for link in body_links]))
        for index, body_links in enumerate(members)
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
