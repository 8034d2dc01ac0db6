"""Rods: which layer is the outer one, and where steel rods tie every part to its copy in the other pontoon.

The pontoons mirror one another, so the outer layers are the pitch apart and the inner ones face each other. An inner
part's rods run through the room between the pontoons, where there is nothing else; they go in before an outer part lies
over their bores. An outer part's rods pass the inner layer too, and must miss whatever sweeps there: of the two ways to
name a layer the outer one, the better is taken.
"""

from __future__ import annotations

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

LEAST_SPREAD_MM = 15.0
"""Two rods nearer to one another than this count as one: they hardly stop a part from twisting."""
LEAST_ROOM_MM2 = 1.0
"""A room smaller than this is a sliver that offsets of outlines leave over, and gets no rod."""
CORNER_MM = 0.2
"""What stands out by less is no corner of a room: its arcs are chords by the hundred, and every corner is tried."""


@dataclass(frozen=True)
class Layers:
    """Which parts are outer ones, and every part's rods."""

    outer: tuple[bool, ...]
    """Per part."""
    rods: tuple[tuple[Point, ...], ...]
    """Per part, their places in the plane; none where there is no room."""

    def low_mm(self, body: int, settings: KitSettings) -> float:
        """Give where a part of the left pontoon, and its rods, begin along the extrusion: 0 for an outer part."""
        return 0.0 if self.outer[body] else settings.thickness_mm + settings.layer_gap_mm

    def rod_length_mm(self, body: int, settings: KitSettings) -> float:
        """Give the length of a part's rods: from the outside of one copy to the outside of the other."""
        return settings.pitch_mm + settings.thickness_mm - 2 * self.low_mm(body, settings)


def layers_of(
    mechanism: Mechanism, servo_joints: Sequence[ServoJoint], outlines: Sequence[Polygon], settings: KitSettings
) -> Layers:
    """Choose the layers and place the rods.

    Args:
        mechanism: n parts.
        servo_joints: one for every joint.
        outlines: of the parts, bosses and fillets included.
        settings: of the rods.
    """
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
    """Give what a part's drives take of it: pockets, cables' ways out, recesses and pins."""
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
    """Give where the middle of a part's rod may lie."""
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
    """Place up to n rods as far from one another as there is room."""
    if room.is_empty or room.area < LEAST_ROOM_MM2:
        return ()
    corners = np.array(
        [point for part in getattr(room, "geoms", [room]) for point in part.simplify(CORNER_MM).exterior.coords[:-1]]
    )
    hull = np.array(room.convex_hull.exterior.coords)[:-1]
    first, second = max(combinations(range(len(hull)), 2), key=lambda pair: np.hypot(*(hull[pair[0]] - hull[pair[1]])))
    if n == 1 or np.hypot(*(hull[first] - hull[second])) < LEAST_SPREAD_MM:
        middle = room.representative_point()
        return ((middle.x, middle.y),)
    chosen = [hull[first], hull[second]]
    while len(chosen) < n:
        nearest = np.min([np.hypot(*(corners - point).T) for point in chosen], axis=0)
        if nearest.max() < LEAST_SPREAD_MM:
            break
        chosen.append(corners[int(nearest.argmax())])
    return tuple((float(x), float(y)) for x, y in chosen)


def _spread(rods: Sequence[Point]) -> float:
    return max((float(np.hypot(a[0] - b[0], a[1] - b[1])) for a, b in combinations(rods, 2)), default=0.0)


def rod_circles(rods: Sequence[Point], radius: float) -> BaseGeometry:
    """Give the rods' discs of a radius."""
    return unary_union([ShapelyPoint(rod).buffer(radius) for rod in rods])
