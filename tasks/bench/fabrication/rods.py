"""Layers and rods: which layer is the outer one, and where steel rods tie every part to its copy in the other pontoon.

The pontoons mirror each other: the outer layers are the pitch apart and the inner layers face each other. An inner
part's two rods cross the empty space between the pontoons; they are inserted before an outer part covers their bores.
An outer part's rods also cross the inner layer and must clear the parts that sweep there. Of the two choices of the
outer layer, the one with more and wider-spaced rods is taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from shapely import Point as ShapelyPoint
from shapely import Polygon, unary_union
from shapely.geometry.base import BaseGeometry

from tasks.bench.fabrication.built_bodies import Mechanism, Point, swept
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.printing import ROD_CLEARANCE_MM, SWEEP_CLEARANCE_MM, WALL_MM
from tasks.bench.fabrication.servo_joints import ServoJoint

_MIN_SPREAD_MM = 15.0  # closer rods hardly prevent twisting and count as one
_MIN_ROOM_MM2 = 1.0  # a smaller area is a sliver left by offsetting outlines


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
            _placed(_room(body.index, outer, mechanism, servo_joints, outlines, settings)) for body in mechanism.bodies
        )
        choices.append(Layers(outer, rods))
    return max(choices, key=lambda layers: (sum(map(len, layers.rods)), sum(map(_spread, layers.rods))))


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
    margin = radius + ROD_CLEARANCE_MM / 2 + WALL_MM
    room = outlines[body].buffer(-margin).difference(keep_out(servo_joints, body).buffer(margin))
    if outer[body]:
        for other in mechanism.bodies:
            if not outer[other.index] and not room.is_empty:
                way = swept(outlines[other.index], mechanism.poses_in_range(body, other.index))
                room = room.difference(way.buffer(radius + SWEEP_CLEARANCE_MM))
    return room


def _placed(room: BaseGeometry) -> tuple[Point, ...]:
    """Place two rods as far apart as possible, or one where they would be too close."""
    if room.is_empty or room.area < _MIN_ROOM_MM2:
        return ()
    rods = max(combinations(room.convex_hull.exterior.coords[:-1], 2), key=_spread)
    if _spread(rods) < _MIN_SPREAD_MM:
        middle = room.representative_point()
        return ((middle.x, middle.y),)
    return rods


def _spread(rods: Sequence[Point]) -> float:
    return float(np.hypot(rods[0][0] - rods[1][0], rods[0][1] - rods[1][1])) if len(rods) == 2 else 0.0


def rod_circles(rods: Sequence[Point], radius: float) -> BaseGeometry:
    """Return discs of a radius around rods."""
    return unary_union([ShapelyPoint(rod).buffer(radius) for rod in rods])
