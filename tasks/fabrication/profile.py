"""Profiles: the outline of a part as exact lines and arcs, with fillets in its inner corners.

A polygon of the same outline serves the decisions and checks in the plane.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees

import numpy as np
from build123d import Circle, Face, GeomType, Location, Rectangle, RectangleRounded, Sketch, Vertex, Wire
from shapely import Point as ShapelyPoint
from shapely import Polygon, unary_union

from tasks.fabrication.built_bodies import Mechanism, Point
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.servo_joints import ServoJoint

_ARC_STEP = np.radians(4.0)  # of the polygon's chords; they miss an arc of 20 mm radius by 0.01 mm
_PROBE_MM = 0.1  # radius around a corner in which the share of the inside is measured
_INNER_SHARE = 0.55  # above it a corner is an inner one; a smooth transition into an arc has 0.5
_AREA_TOLERANCE = 2e-3  # relative, between exact areas and those of polygons with chords for arcs


class SolidError(ValueError):
    """The CAD kernel made the wrong geometry. The message names the part and the difference."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The outline of a part."""

    face: Face
    polygon: Polygon  # the same outline with chords for arcs


def profile_of(mechanism: Mechanism, servo_joints: Sequence[ServoJoint], body: int, settings: KitSettings) -> Profile:
    """Unite a part's links and bosses and fillet the corners where they meet.

    Args:
        mechanism: The design's parts and joints.
        servo_joints: Servo joints of the whole robot.
        body: Index of the part.
        settings: Settings of the kit.

    Returns:
        The outline as a face and as a polygon.

    Raises:
        SolidError: The union has several pieces, or its area differs from that of polygons.
    """
    name = mechanism.bodies[body].name
    links = [
        _at(mechanism.link_centre[link], mechanism.link_angle[link]) * Rectangle(*mechanism.link_size[link])
        for link in mechanism.bodies[body].links
    ]
    cradles = [one for one in servo_joints if one.carrier == body]
    horns = [one for one in servo_joints if one.driven == body]
    bosses = [
        cradle_boss(one) if one.carrier == body else horn_boss(one)
        for one in servo_joints
        if body in (one.carrier, one.driven)
    ]
    face = _united([*links, *bosses], name)
    polygons = [mechanism.bodies[body].outline, *(one.cradle for one in cradles), *(one.seat for one in horns)]
    expected: float = unary_union(polygons).area
    if abs(face.area - expected) > _AREA_TOLERANCE * expected:
        raise SolidError(f"{name}: the outline's area is {face.area:.1f} mm², expected {expected:.1f}")
    face = _rounded(face, settings.fillet_mm)
    return Profile(face, polygon_of(face))


def cradle_boss(servo_joint: ServoJoint) -> Sketch:
    """Draw the outline of a servo's cradle, in place."""
    servo, wall = servo_joint.servo, servo_joint.wall_mm
    middle = servo_joint.point(servo.length_mm / 2 - servo.shaft_offset_mm, 0.0)
    length = servo.ear_length_mm + 2 * (servo_joint.clearance_mm + wall)
    return _at(middle, servo_joint.angle) * RectangleRounded(length, servo_joint.cradle_width_mm, wall)


def horn_boss(servo_joint: ServoJoint) -> Sketch:
    """Draw the outline around a horn's recess, in place."""
    return _at(servo_joint.joint.at, 0.0) * Circle(servo_joint.recess_radius_mm + servo_joint.wall_mm)


def _at(place: Point, angle: float) -> Location:
    return Location((*place, 0.0), (0.0, 0.0, degrees(angle)))


def _united(sketches: list[Sketch], name: str) -> Face:
    united = sketches[0]
    for sketch in sketches[1:]:
        united = united + sketch
    faces = united.faces()
    if len(faces) != 1:
        raise SolidError(f"{name}: the links form {len(faces)} pieces, expected 1")
    return faces[0] if faces[0].normal_at().Z > 0 else -faces[0]


def _rounded(face: Face, radius: float) -> Face:
    """Fillet the inner corners with the radius, with a half or a quarter of it if that does not fit, or not at all."""
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
        for corner in corners:  # the estimated room was wrong for one of them
            face = next((f for r in sizes[number:] if (f := _filleted(face, [corner], r)) is not None), face)
    return face


def _inner_corners(face: Face) -> dict[Point, float]:
    """Find the inner corners, each with the approximate radius that its edges have room for."""
    polygon = polygon_of(face)
    probe = np.pi * _PROBE_MM**2
    corners = [
        (v.X, v.Y)
        for v in face.vertices()
        if ShapelyPoint(v.X, v.Y).buffer(_PROBE_MM).intersection(polygon).area > _INNER_SHARE * probe
    ]
    room = dict.fromkeys(corners, np.inf)
    for edge in face.edges():
        ends = [(p.X, p.Y) for p in (edge.position_at(0), edge.position_at(1))]
        near = [min(corners, key=lambda c: np.hypot(c[0] - x, c[1] - y), default=None) for x, y in ends]
        touched = {c for c, (x, y) in zip(near, ends, strict=True) if c and np.hypot(c[0] - x, c[1] - y) < _PROBE_MM}
        for corner in touched:
            room[corner] = min(room[corner], edge.length / len(touched))
    return room


def _filleted(face: Face, corners: list[Point], radius: float) -> Face | None:
    """Fillet corners; return None if the kernel fails or returns a wrong face."""
    vertices: list[Vertex] = [min(face.vertices(), key=lambda v: np.hypot(v.X - x, v.Y - y)) for x, y in corners]
    try:
        rounded = face.fillet_2d(radius, vertices)
    except Exception:  # the kernel's errors for a radius that does not fit have no common base class
        return None
    gained = rounded.area - face.area
    if not rounded.is_valid or not 0.0 <= gained <= len(corners) * 4 * radius**2:
        return None
    return rounded


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
