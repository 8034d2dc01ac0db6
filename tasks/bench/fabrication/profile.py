"""Profiles: the outline of a part as exact lines and arcs, with fillets in its inner corners.

A polygon of the same outline serves the decisions and checks in the plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, dist

import numpy as np
from build123d import Circle, Face, GeomType, Location, Rectangle, RectangleRounded, Sketch, Vertex, Wire
from shapely import Point as ShapelyPoint
from shapely import Polygon

from tasks.bench.fabrication.built_bodies import Mechanism, Point
from tasks.bench.fabrication.kit_error import KitError
from tasks.bench.fabrication.printing import WALL_MM
from tasks.bench.fabrication.servo_joints import ServoJoint

_FILLETS_MM = (5.0, 2.5, 1.25)  # radii in the inner corners of an outline; the largest that fits is taken
_ARC_STEP = np.radians(4.0)  # of the polygon's chords; they miss an arc of 20 mm radius by 0.01 mm
_PROBE_MM = 0.1  # radius around a corner in which the share of the inside is measured
_INNER_SHARE = 0.55  # above it a corner is an inner one; a smooth transition into an arc has 0.5


@dataclass(frozen=True, eq=False)
class Profile:
    """The outline of a part."""

    face: Face
    polygon: Polygon  # the same outline with chords for arcs


def profile_of(mechanism: Mechanism, servo_joints: Sequence[ServoJoint], body: int) -> Profile:
    """Unite the links and bosses of the part with an index and fillet the corners where they meet.

    Raises KitError if the union has several pieces.
    """
    sketches: list[Sketch] = [
        location(mechanism.link_centre[link], mechanism.link_angle[link]) * Rectangle(*mechanism.link_size[link])
        for link in mechanism.bodies[body].links
    ]
    sketches += [cradle_boss(servo_joint) for servo_joint in servo_joints if servo_joint.carrier == body]
    sketches += [horn_boss(servo_joint) for servo_joint in servo_joints if servo_joint.driven == body]
    united = sketches[0]
    for sketch in sketches[1:]:
        united = united + sketch
    faces = united.faces()
    if len(faces) != 1:
        raise KitError(f"{mechanism.bodies[body].name}: the links form {len(faces)} pieces, expected 1")
    face = faces[0] if faces[0].normal_at().Z > 0 else -faces[0]
    for corner, room in _inner_corners(face).items():
        *larger, least = _FILLETS_MM
        sizes = (*(size for size in larger if size <= room), least)
        face = next((f for size in sizes if (f := _filleted(face, corner, size)) is not None), face)
    return Profile(face, polygon_of(face))


def cradle_boss(servo_joint: ServoJoint) -> Sketch:
    """Draw the outline of a servo's cradle, in place."""
    servo = servo_joint.servo
    middle = servo_joint.point(servo.length_mm / 2 - servo.shaft_offset_mm, 0.0)
    length = servo.ear_length_mm + 2 * (servo_joint.settings.servo_clearance_mm + WALL_MM)
    return location(middle, servo_joint.angle) * RectangleRounded(length, servo_joint.cradle_width_mm, WALL_MM)


def horn_boss(servo_joint: ServoJoint) -> Sketch:
    """Draw the outline around a horn's recess, in place."""
    return location(servo_joint.joint.at, 0.0) * Circle(servo_joint.seat_radius_mm)


def location(place: Point, angle: float) -> Location:
    """Return where something lies in the plane, turned by an angle [rad]."""
    return Location((*place, 0.0), (0.0, 0.0, degrees(angle)))


def _inner_corners(face: Face) -> dict[Point, float]:
    """Find the inner corners, each with the radius that its edges have room for; corners share an edge between them."""
    polygon, probe = polygon_of(face), np.pi * _PROBE_MM**2
    room = {
        (v.X, v.Y): np.inf
        for v in face.vertices()
        if ShapelyPoint(v.X, v.Y).buffer(_PROBE_MM).intersection(polygon).area > _INNER_SHARE * probe
    }
    for edge in face.edges():
        ends = [(p.X, p.Y) for p in (edge.position_at(0), edge.position_at(1))]
        touched = [corner for corner in room if min(dist(corner, end) for end in ends) < _PROBE_MM]
        for corner in touched:
            room[corner] = min(room[corner], edge.length / len(touched))
    return room


def _filleted(face: Face, corner: Point, radius: float) -> Face | None:
    """Fillet a corner; return None if the kernel fails or returns a wrong face, as where the radius does not fit."""
    vertex: Vertex = min(face.vertices(), key=lambda v: np.hypot(v.X - corner[0], v.Y - corner[1]))
    try:
        rounded = face.fillet_2d(radius, [vertex])
    except Exception:  # the kernel's errors for a radius that does not fit have no common base class
        return None
    return rounded if rounded.is_valid and 0.0 <= rounded.area - face.area <= 4 * radius**2 else None


def polygon_of(face: Face) -> Polygon:
    """Convert a plane face to a polygon, with chords for arcs."""
    return Polygon(_ring(face.outer_wire()), [_ring(wire) for wire in face.inner_wires()])


def _ring(wire: Wire) -> list[Point]:
    points: list[Point] = []
    edges = list(wire.order_edges())
    for index, edge in enumerate(edges):
        n = 1 if edge.geom_type == GeomType.LINE else max(2, int(np.ceil(edge.length / edge.radius / _ARC_STEP)))
        along = [edge.position_at(step / n) for step in range(n + 1)]
        following = edges[(index + 1) % len(edges)]
        ends = [following.position_at(0), following.position_at(1)]
        if min((along[0] - end).length for end in ends) < min((along[-1] - end).length for end in ends):
            along.reverse()
        points.extend((p.X, p.Y) for p in along[:-1])
    return points
