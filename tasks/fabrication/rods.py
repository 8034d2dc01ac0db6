"""Layers and rods: which layer is the outer one, and where steel rods tie every part to its copy in the other pontoon.

The pontoons mirror each other: the outer layers are the pitch apart and the inner layers face each other. An inner
part's rods cross the empty space between the pontoons; they are inserted before an outer part covers their bores. An
outer part's rods also cross the inner layer and must clear the parts that sweep there. Of the two choices of the outer
layer, the one with more and wider-spaced rods is taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from shapely import Point as ShapelyPoint
from shapely import Polygon, unary_union
from shapely.geometry.base import BaseGeometry

from tasks.fabrication.built_bodies import Mechanism, Point, swept
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.servo_joints import ServoJoint

_MIN_SPREAD_MM = 15.0  # closer rods hardly prevent twisting and count as one
_MIN_ROOM_MM2 = 1.0  # a smaller area is a sliver left by offsetting outlines
_CORNER_MM = 0.2  # tolerance that reduces the hundreds of chords of an arc to a few corners


@dataclass(frozen=True)
class Layers:
    """Layer and rods of every part."""

    outer: tuple[bool, ...]  # whether each part is in the outer layer
    rods: tuple[tuple[Point, ...], ...]  # positions of each part's rods in the plane; none if there is no room

    def low_mm(self, body: int, settings: KitSettings) -> float:
        """Return where a part of the left pontoon and its rods begin along z."""
        return 0.0 if self.outer[body] else settings.thickness_mm + settings.layer_gap_mm

    def rod_length_mm(self, body: int, settings: KitSettings) -> float:
        """Return the length of a part's rods, from the outside of one copy to the outside of the other."""
        return settings.pitch_mm + settings.thickness_mm - 2 * self.low_mm(body, settings)


def layers_of(
    mechanism: Mechanism, servo_joints: Sequence[ServoJoint], outlines: Sequence[Polygon], settings: KitSettings
) -> Layers:
    """Choose the layer and place the rods of every part, given the parts' outlines with bosses and fillets."""
    choices = []
    for parity in (0, 1) if mechanism.joints else (0,):
        outer = tuple(body.depth % 2 == parity for body in mechanism.bodies)
        rods = tuple(
            _placed(_room(body.index, outer, mechanism, servo_joints, outlines, settings), settings.rods_per_part)
            for body in mechanism.bodies
        )
        choices.append(Layers(outer, rods))
    return max(choices, key=lambda layers: (sum(min(len(r), 2) for r in layers.rods), sum(map(_spread, layers.rods))))


def keep_out(servo_joints: Sequence[ServoJoint], body: int) -> BaseGeometry:
    """Return the area of a part that its servos and horns occupy."""
    carried = [hollow for d in servo_joints if d.carrier == body for hollow in (d.pocket, *d.cable_ways)]
    return unary_union([*carried, *(d.recess for d in servo_joints if d.driven == body)])


def _room(
    body: int,
    outer: Sequence[bool],
    mechanism: Mechanism,
    servo_joints: Sequence[ServoJoint],
    outlines: Sequence[Polygon],
    settings: KitSettings,
) -> BaseGeometry:
    """Return the area in which the middle of a part's rod may lie."""
    radius = settings.rod_mm / 2
    margin = radius + settings.rod_clearance_mm / 2 + settings.wall_mm
    room = outlines[body].buffer(-margin).difference(keep_out(servo_joints, body).buffer(margin))
    if outer[body]:
        for other in mechanism.bodies:
            if not outer[other.index] and not room.is_empty:
                way = swept(outlines[other.index], mechanism.poses_in_range(body, other.index))
                room = room.difference(way.buffer(radius + settings.sweep_clearance_mm))
    return room


def _placed(room: BaseGeometry, n: int) -> tuple[Point, ...]:
    """Place up to n rods as far apart as possible."""
    if room.is_empty or room.area < _MIN_ROOM_MM2:
        return ()
    corners = np.array(
        [point for part in getattr(room, "geoms", [room]) for point in part.simplify(_CORNER_MM).exterior.coords[:-1]]
    )
    hull = np.array(room.convex_hull.exterior.coords)[:-1]
    first, second = max(combinations(range(len(hull)), 2), key=lambda pair: np.hypot(*(hull[pair[0]] - hull[pair[1]])))
    if n == 1 or np.hypot(*(hull[first] - hull[second])) < _MIN_SPREAD_MM:
        middle = room.representative_point()
        return ((middle.x, middle.y),)
    chosen = [hull[first], hull[second]]
    while len(chosen) < n:
        nearest = np.min([np.hypot(*(corners - point).T) for point in chosen], axis=0)
        if nearest.max() < _MIN_SPREAD_MM:
            break
        chosen.append(corners[int(nearest.argmax())])
    return tuple((float(x), float(y)) for x, y in chosen)


def _spread(rods: Sequence[Point]) -> float:
    return max((float(np.hypot(a[0] - b[0], a[1] - b[1])) for a, b in combinations(rods, 2)), default=0.0)


def rod_circles(rods: Sequence[Point], radius: float) -> BaseGeometry:
    """Return discs of a radius around rods."""
    return unary_union([ShapelyPoint(rod).buffer(radius) for rod in rods])
