"""Parts: solids to print, and the things that are bought, where they are in the assembled robot.

z is the extrusion, to the left pontoon's outside at 0; a robot that goes along +x with +y up has its left there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, degrees, radians, sin

import numpy as np
import numpy.typing as npt
from build123d import Box, Cylinder, Face, Location, Plane, Shape, Solid, Wire, extrude, mirror
from shapely import Point as ShapelyPoint
from shapely import Polygon

from tasks.fabrication.features import Feature, volume_mm3
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.profile import Profile, SolidError
from tasks.fabrication.rods import Layers
from tasks.fabrication.servo_joints import ServoJoint
from tasks.fabrication.splits import Split, bed_mm, turn_to_fit

SIDES = ("left", "right")
VOLUME_TOLERANCE = 5e-4
"""Relative; the analytic volume has chords for arcs."""
MESH_MM, MESH_RAD = 0.05, 0.2
"""How far a mesh may miss a curved face, and how far neighbouring facets may turn."""


@dataclass(frozen=True, eq=False)
class Part:
    """One piece to print."""

    name: str
    body: int
    side: str
    solid: Solid
    """In its place in the robot."""
    outline: Polygon
    volume_mm3: float
    mass_g: float
    """Of PLA, at the infill that was asked."""
    face_down: bool
    """Whether it is printed on its face, with its pockets open upward; otherwise it lies on its back."""
    face_is_up: bool
    """Whether its face looks along +z in the robot."""
    turn_deg: float
    """Turn on the bed by which it fits."""


@dataclass(frozen=True, eq=False)
class BoughtPart:
    """A servo with its horn, a rod or a pin, in its place in the robot."""

    name: str
    kind: str
    """servo, horn, rod or pin."""
    solid: Shape


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed surface of triangles, wound so that normals look outward."""

    vertices: npt.NDArray[np.float64]
    """(n_vertices, 3) [mm]"""
    triangles: npt.NDArray[np.int64]
    """(n_triangles, 3)"""


def placement(body: int, side: str, layers: Layers, settings: KitSettings) -> tuple[bool, float]:
    """Say how a part made with its back at 0 and its face up comes to its place: whether mirrored, and how far up."""
    outer, thickness = layers.outer[body], settings.thickness_mm
    inward = 0.0 if outer else thickness + settings.layer_gap_mm
    if side == "left":
        return (not outer, inward)
    return (outer, settings.pitch_mm - inward)


def placed(shape: Shape, body: int, side: str, layers: Layers, settings: KitSettings) -> Shape:
    """Bring a shape from a part's own frame to its place in the robot."""
    mirrored, up = placement(body, side, layers, settings)
    if mirrored:
        shape = mirror(shape, about=Plane.XY.offset(settings.thickness_mm / 2))
    return shape.moved(Location((0.0, 0.0, up)))


def parts_of(
    name: str,
    body: int,
    side: str,
    profile: Profile,
    features: Sequence[Feature],
    split: Split,
    layers: Layers,
    settings: KitSettings,
) -> list[Part]:
    """Make one copy of a part, in pieces if it was split.

    Raises:
        SolidError: the kernel made something else than what the outlines say: an invalid solid, another number of
            pieces or another volume.
    """
    cuts = [Feature("cut", "cut", cut, 0.0, settings.thickness_mm) for cut in split.cuts]
    everything = [*features, *cuts]
    whole = extrude(profile.face, settings.thickness_mm)
    solids = cut_out(
        name, whole, everything, profile.face.area, profile.polygon, settings.thickness_mm, n_pieces=len(split.pieces)
    )
    parts = []
    bed = bed_mm(settings)
    face_down = any(feature.label == "pocket" for feature in features)
    face_is_up = not placement(body, side, layers, settings)[0]
    for number, outline in enumerate(split.pieces):
        solid = min(solids, key=lambda s: _mismatch(s, outline))
        piece = placed(solid, body, side, layers, settings).solids()[0]
        parts.append(
            Part(
                name=name if len(split.pieces) == 1 else f"{name}-{chr(ord('a') + number)}",
                body=body,
                side=side,
                solid=piece,
                outline=outline,
                volume_mm3=piece.volume,
                mass_g=printed_mass_g(piece, settings),
                face_down=face_down,
                face_is_up=face_is_up,
                turn_deg=turn_to_fit(outline, *bed) or 0.0,
            )
        )
    return parts


def cut_out(
    name: str,
    whole: Solid,
    features: Sequence[Feature],
    area: float,
    outline: Polygon,
    thickness: float,
    *,
    n_pieces: int,
) -> list[Solid]:
    """Cut features out of an extruded outline.

    Raises:
        SolidError: an invalid solid came, another number of pieces, or another volume than the outlines'.
    """
    tools = [_tool(feature) for feature in features]
    solids: list[Solid] = (whole.cut(*tools) if tools else whole).solids()
    expected = volume_mm3(area, outline, features, thickness)
    came = sum(solid.volume for solid in solids)
    if len(solids) != n_pieces or not all(solid.is_valid for solid in solids):
        raise SolidError(f"{name}: {len(solids)} solids, expected {n_pieces}, all of them valid")
    if abs(came - expected) > VOLUME_TOLERANCE * expected:
        raise SolidError(f"{name}: its volume is {came:.1f} mm³, expected {expected:.1f}")
    return solids


def _tool(feature: Feature) -> Solid:
    """Give what is cut away. On a plane at its own height: sketching on a face would move its origin."""
    height = feature.high_mm - feature.low_mm
    if feature.circle is not None:
        (x, y), radius = feature.circle
        return Solid.make_cylinder(radius, height, Plane((x, y, feature.low_mm)))
    corners = [(x, y, feature.low_mm) for x, y in feature.outline.exterior.coords[:-1]]
    return extrude(Face(Wire.make_polygon(corners)), height, dir=(0, 0, 1)).solids()[0]


def _mismatch(solid: Solid, outline: Polygon) -> float:
    """Say how far a solid's vertices lie outside an outline."""
    return float(sum(outline.distance(ShapelyPoint(v.X, v.Y)) for v in solid.vertices()))


def printed_mass_g(solid: Solid, settings: KitSettings) -> float:
    """Estimate the mass of a print: a solid shell along its surface, and infill."""
    volume: float = solid.volume
    shell = min(volume, settings.shell_mm * float(solid.area))
    return settings.pla_density_g_cm3 * (shell + settings.infill * (volume - shell)) / 1000.0


def on_bed(part: Part, mesh: Mesh) -> Mesh:
    """Lay a part's mesh as it is printed: on z = 0, turned to fit, with its corner at the origin."""
    over = part.face_down == part.face_is_up
    turn = radians(-part.turn_deg if over else part.turn_deg)
    x_up = np.diag([1.0, -1.0, -1.0]) if over else np.eye(3)
    about_z = np.array([[cos(turn), -sin(turn), 0.0], [sin(turn), cos(turn), 0.0], [0.0, 0.0, 1.0]])
    vertices = mesh.vertices @ (about_z @ x_up).T
    return Mesh(vertices - vertices.min(axis=0), mesh.triangles)


def bought_of(servo_joints: Sequence[ServoJoint], layers: Layers, settings: KitSettings) -> list[BoughtPart]:
    """Give the servos, horns, pins and rods, as plain shapes."""
    things = []
    thickness = settings.thickness_mm
    for servo_joint in servo_joints:
        for side in SIDES:
            label = f"joint {servo_joint.joint.link}, {side}"
            if side in servo_joint.sides(settings.servos_per_joint):
                for kind, shape in (("servo", _servo(servo_joint, thickness)), ("horn", _horn(servo_joint, thickness))):
                    there = placed(shape, servo_joint.carrier, side, layers, settings)
                    things.append(BoughtPart(f"{kind} of {label}", kind, there))
            else:
                low = 0.0 if side == "left" else settings.pitch_mm - thickness - settings.layer_gap_mm
                pin = _rod(servo_joint.joint.at, settings.rod_mm, low, pin_length_mm(settings))
                things.append(BoughtPart(f"pin of {label}", "pin", pin))
    for body, rods in enumerate(layers.rods):
        for number, at in enumerate(rods, 1):
            low, length = layers.low_mm(body, settings), layers.rod_length_mm(body, settings)
            rod = _rod(at, settings.rod_mm, low, length)
            things.append(BoughtPart(f"rod {number} of part {body + 1}", "rod", rod))
    return things


def pin_length_mm(settings: KitSettings) -> float:
    """Give the length of a pin: both layers and the gap."""
    return 2 * settings.thickness_mm + settings.layer_gap_mm


def _rod(at: tuple[float, float], diameter: float, low: float, length: float) -> Solid:
    return Solid.make_cylinder(diameter / 2, length, Plane((*at, low)))


def _servo(servo_joint: ServoJoint, face: float) -> Shape:
    """Give case, ears and spline in the frame of the part that carries it, the case's top flush with the face."""
    servo = servo_joint.servo
    middle = servo.length_mm / 2 - servo.shaft_offset_mm
    bottom = face - servo.height_mm
    case = Location((middle, 0, bottom + servo.height_mm / 2)) * Box(servo.length_mm, servo.width_mm, servo.height_mm)
    ear_height = bottom + servo.ear_bottom_mm + servo.ear_thickness_mm / 2
    ears = Location((middle, 0, ear_height)) * Box(servo.ear_length_mm, servo.width_mm, servo.ear_thickness_mm)
    stub = servo_joint.horn.top_mm - servo_joint.horn.thickness_mm
    hub = Location((0, 0, face + stub / 2)) * Cylinder(servo_joint.horn.hub_mm / 2, stub)
    return _in_plane(case + ears + hub, servo_joint)


def _horn(servo_joint: ServoJoint, face: float) -> Shape:
    horn = servo_joint.horn
    height = face + horn.top_mm - horn.thickness_mm / 2
    if horn.kind == "disc":
        shape: Shape = Cylinder(horn.long_mm, horn.thickness_mm)
    else:
        shape = Box(2 * horn.long_mm, horn.arm_width_mm, horn.thickness_mm)
        shape += Box(horn.arm_width_mm, 2 * horn.short_mm, horn.thickness_mm)
    return _in_plane(Location((0, 0, height)) * shape, servo_joint)


def _in_plane(shape: Shape, servo_joint: ServoJoint) -> Shape:
    return Location((*servo_joint.joint.at, 0.0), (0.0, 0.0, degrees(servo_joint.angle))) * shape


def mesh_of(shape: Shape) -> Mesh:
    """Turn a solid into triangles, with the vertices that neighbouring faces share made one."""
    points, triangles = shape.tessellate(MESH_MM, MESH_RAD)
    corners = np.array([(p.X, p.Y, p.Z) for p in points])
    _, first, same = np.unique(np.round(corners, 5), axis=0, return_index=True, return_inverse=True)
    merged = same.reshape(-1)[np.array(triangles, dtype=np.int64)]
    a, b, c = merged.T
    return Mesh(corners[first], merged[(a != b) & (b != c) & (c != a)])
