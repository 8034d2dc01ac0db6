"""Profiles: the outline of a part as exact lines and arcs, rounded in its inner corners.

The outline is also kept as a polygon, for whatever is decided and checked in the plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees

import numpy as np
from build123d import Circle, Face, GeomType, Location, Rectangle, RectangleRounded, Sketch, Vertex, Wire
from shapely import Point as ShapelyPoint
from shapely import Polygon

from tasks.fabrication.built_bodies import Mechanism, Point
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.servo_joints import ServoJoint, outline_with_bosses

ARC_STEP = np.radians(4.0)
"""Of the polygon's chords along an arc; at a radius of 20 mm they miss it by 0.01 mm."""
CORNER_PROBE_MM = 0.1
"""How near to a corner it is asked how much of its surroundings is inside."""
INNER = 0.55
"""Share of a corner's surroundings above which it is an inner one: a half, as where an edge runs on into an arc, and
some room for chords and rounding."""
AREA_TOLERANCE = 2e-3
"""Relative; between the kernel's area and that of polygons, whose arcs are chords."""


class SolidError(ValueError):
    """Geometry that the kernel got wrong: names the part, what was expected and what came."""


@dataclass(frozen=True, eq=False)
class Profile:
    """A part's outline."""

    face: Face
    polygon: Polygon
    """The same, with chords for arcs."""


def profile_of(mechanism: Mechanism, servo_joints: Sequence[ServoJoint], body: int, settings: KitSettings) -> Profile:
    """Unite a part's links and bosses and round the corners where they meet.

    Raises:
        SolidError: the union is not in one piece, or has another area than polygons say.
    """
    name = mechanism.bodies[body].name
    expected = outline_with_bosses(mechanism, servo_joints, body)
    face = _united([*_links(mechanism, body), *_bosses(servo_joints, body)], name)
    if abs(face.area - expected.area) > AREA_TOLERANCE * expected.area:
        raise SolidError(f"{name}: its outline has {face.area:.1f} mm², expected {expected.area:.1f}")
    face = _rounded(face, settings.fillet_mm)
    return Profile(face, polygon_of(face))


def _links(mechanism: Mechanism, body: int) -> list[Sketch]:
    return [
        _at(mechanism.link_centre[link], mechanism.link_angle[link]) * Rectangle(*mechanism.link_size[link])
        for link in mechanism.bodies[body].links
    ]


def _bosses(servo_joints: Sequence[ServoJoint], body: int) -> list[Sketch]:
    bosses = []
    for servo_joint in servo_joints:
        if servo_joint.carrier == body:
            bosses.append(cradle_boss(servo_joint))
        elif servo_joint.driven == body:
            bosses.append(horn_boss(servo_joint))
    return bosses


def cradle_boss(servo_joint: ServoJoint) -> Sketch:
    """Draw what a servo's cradle needs, in its place."""
    servo, wall = servo_joint.servo, servo_joint.wall_mm
    middle = servo_joint.point(servo.length_mm / 2 - servo.shaft_offset_mm, 0.0)
    length = servo.ear_length_mm + 2 * (servo_joint.clearance_mm + wall)
    return _at(middle, servo_joint.angle) * RectangleRounded(length, servo_joint.cradle_width_mm, wall)


def horn_boss(servo_joint: ServoJoint) -> Sketch:
    """Draw what a horn's recess needs, in its place."""
    return _at(servo_joint.joint.at, 0.0) * Circle(servo_joint.recess_radius_mm + servo_joint.wall_mm)


def _at(place: Point, angle: float) -> Location:
    return Location((*place, 0.0), (0.0, 0.0, degrees(angle)))


def _united(sketches: list[Sketch], name: str) -> Face:
    united = sketches[0]
    for sketch in sketches[1:]:
        united = united + sketch
    faces = united.faces()
    if len(faces) != 1:
        raise SolidError(f"{name}: its links make {len(faces)} pieces, expected 1")
    return faces[0] if faces[0].normal_at().Z > 0 else -faces[0]


def _rounded(face: Face, radius: float) -> Face:
    """Round the inner corners, with half or a quarter of the radius where the whole does not fit, or not at all."""
    if radius == 0.0:
        return face
    room = _inner_corners(face)
    sizes = (radius, radius / 2, radius / 4)
    for number, size in enumerate(sizes):
        larger = sizes[number - 1] if number else np.inf
        smallest = 0.0 if size == sizes[-1] else size
        corners = [corner for corner, edge in room.items() if smallest <= edge < larger]
        together = _filleted(face, corners, size) if corners else face
        if together is not None:
            face = together
            continue
        for corner in corners:  # the estimate of the room was wrong for one of them
            face = next((f for r in sizes[number:] if (f := _filleted(face, [corner], r)) is not None), face)
    return face


def _inner_corners(face: Face) -> dict[Point, float]:
    """Find the inner corners, and for each the radius that its edges have about room for."""
    polygon = polygon_of(face)
    probe = np.pi * CORNER_PROBE_MM**2
    corners = [
        (v.X, v.Y)
        for v in face.vertices()
        if ShapelyPoint(v.X, v.Y).buffer(CORNER_PROBE_MM).intersection(polygon).area > INNER * probe
    ]
    room = dict.fromkeys(corners, np.inf)
    for edge in face.edges():
        ends = [(p.X, p.Y) for p in (edge.position_at(0), edge.position_at(1))]
        near = [min(corners, key=lambda c: np.hypot(c[0] - x, c[1] - y), default=None) for x, y in ends]
        touched = {
            c for c, (x, y) in zip(near, ends, strict=True) if c and np.hypot(c[0] - x, c[1] - y) < CORNER_PROBE_MM
        }
        for corner in touched:
            room[corner] = min(room[corner], edge.length / len(touched))
    return room


def _filleted(face: Face, corners: list[Point], radius: float) -> Face | None:
    """Round corners, or give None if the kernel can't or makes something else of it."""
    vertices: list[Vertex] = [min(face.vertices(), key=lambda v: np.hypot(v.X - x, v.Y - y)) for x, y in corners]
    try:
        rounded = face.fillet_2d(radius, vertices)
    except Exception:  # the kernel's many ways of saying that a radius does not fit have no common base
        return None
    gained = rounded.area - face.area
    if not rounded.is_valid or not 0.0 <= gained <= len(corners) * 4 * radius**2:
        return None
    return rounded


def polygon_of(face: Face) -> Polygon:
    """Give a plane face as a polygon, with chords for arcs."""
    return Polygon(_ring(face.outer_wire()), [_ring(wire) for wire in face.inner_wires()])


def _ring(wire: Wire) -> list[Point]:
    points: list[Point] = []
    edges = list(wire.order_edges())
    for index, edge in enumerate(edges):
        n = 1 if edge.geom_type == GeomType.LINE else max(2, int(np.ceil(edge.length / edge.radius / ARC_STEP)))
        along = [edge.position_at(step / n) for step in range(n + 1)]
        following = edges[(index + 1) % len(edges)]
        ends = [following.position_at(0), following.position_at(1)]
        if min((along[0] - end).length for end in ends) < min((along[-1] - end).length for end in ends):
            along.reverse()
        points.extend((p.X, p.Y) for p in along[:-1])
    return points
