"""Parts to print and to buy, in place in the assembled robot.

Parts are extruded along z. The left pontoon is on the left of a robot that moves along +x with +y up; its outside is at
z = 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, degrees, radians, sin

import numpy as np
from build123d import Box, Cylinder, Face, Location, Plane, Shape, Solid, Wire, extrude, mirror
from shapely import Point as ShapelyPoint
from shapely import Polygon

from tasks.arrays import Float64, Int64
from tasks.fabrication.features import Feature, volume_mm3
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.profile import Profile, SolidError
from tasks.fabrication.rods import Layers
from tasks.fabrication.servo_joints import ServoJoint
from tasks.fabrication.splits import Split, bed_mm, turn_to_fit

SIDES = ("left", "right")
_VOLUME_TOLERANCE = 5e-4  # relative; the analytic volume uses chords for arcs
_MESH_MM, _MESH_RAD = 0.05, 0.2  # largest distance of a mesh from a curved face, and turn between its facets


@dataclass(frozen=True, eq=False)
class Part:
    """A piece to print."""

    name: str
    body: int
    side: str
    solid: Solid  # solid, in place in the robot
    outline: Polygon
    volume_mm3: float
    mass_g: float  # estimated mass at the chosen infill
    face_down: bool  # whether it is printed on its face, with its pockets open upward, rather than on its back
    face_is_up: bool  # whether its face points along +z in the robot
    turn_deg: float  # turn that makes it fit the bed


@dataclass(frozen=True, eq=False)
class BoughtPart:
    """A servo, horn, rod or pin, in place in the robot."""

    name: str
    kind: str  # servo, horn, rod or pin
    solid: Shape


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed surface of triangles whose normals point outward."""

    vertices: Float64  # (n_vertices, 3) positions [mm]
    triangles: Int64  # (n_triangles, 3) indices of vertices


def placement(body: int, side: str, layers: Layers, settings: KitSettings) -> tuple[bool, float]:
    """Return how a part made with its back at 0 and its face up is placed.

    Args:
        body: Index of the part.
        side: Pontoon, left or right.
        layers: Layers of the parts.
        settings: Settings of the kit.

    Returns:
        Whether it is mirrored, and its shift along z [mm].
    """
    outer, thickness = layers.outer[body], settings.thickness_mm
    inward = 0.0 if outer else thickness + settings.layer_gap_mm
    if side == "left":
        return (not outer, inward)
    return (outer, settings.pitch_mm - inward)


def _placed(shape: Shape, body: int, side: str, layers: Layers, settings: KitSettings) -> Shape:
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
    """Make one copy of a part, in pieces if it is split.

    Args:
        name: Name of the copy.
        body: Index of the part.
        side: Pontoon, left or right.
        profile: Outline of the part.
        features: Features of this copy.
        split: Pieces of the part.
        layers: Layers of the parts.
        settings: Settings of the kit.

    Returns:
        One part per piece.

    Raises:
        SolidError: The CAD kernel made a solid that does not match the outlines.
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
        piece = _placed(solid, body, side, layers, settings).solids()[0]
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
                turn_deg=turn_to_fit(outline, bed) or 0.0,
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

    Args:
        name: Name of the part, for messages.
        whole: The extruded outline.
        features: Features to cut.
        area: Exact area of the outline [mm²].
        outline: Outline as a polygon.
        thickness: Thickness of the part [mm].
        n_pieces: Number of solids expected.

    Returns:
        The (n_pieces) solids.

    Raises:
        SolidError: A solid is invalid, or the number of solids or their volume is wrong.
    """
    tools = [_tool(feature) for feature in features]
    solids: list[Solid] = (whole.cut(*tools) if tools else whole).solids()
    expected = volume_mm3(area, outline, features, thickness)
    volume = sum(solid.volume for solid in solids)
    if len(solids) != n_pieces or not all(solid.is_valid for solid in solids):
        raise SolidError(
            f"{name}: expected {n_pieces} valid solids, got {len(solids)} ({sum(s.is_valid for s in solids)} valid)"
        )
    if abs(volume - expected) > _VOLUME_TOLERANCE * expected:
        raise SolidError(f"{name}: volume is {volume:.1f} mm³, expected {expected:.1f}")
    return solids


def _tool(feature: Feature) -> Solid:
    """Make the solid to subtract, on a plane at its own height, because sketching on a face would move its origin."""
    height = feature.high_mm - feature.low_mm
    if feature.circle is not None:
        (x, y), radius = feature.circle
        return Solid.make_cylinder(radius, height, Plane((x, y, feature.low_mm)))
    corners = [(x, y, feature.low_mm) for x, y in feature.outline.exterior.coords[:-1]]
    return extrude(Face(Wire.make_polygon(corners)), height, dir=(0, 0, 1)).solids()[0]


def _mismatch(solid: Solid, outline: Polygon) -> float:
    """Sum the distances of a solid's vertices from an outline."""
    return float(sum(outline.distance(ShapelyPoint(v.X, v.Y)) for v in solid.vertices()))


def printed_mass_g(solid: Solid, settings: KitSettings) -> float:
    """Estimate the mass of a print from a solid shell along its surface and the infill."""
    volume: float = solid.volume
    shell = min(volume, settings.shell_mm * float(solid.area))
    return settings.pla_density_g_cm3 * (shell + settings.infill * (volume - shell)) / 1000.0


def on_bed(part: Part, mesh: Mesh) -> Mesh:
    """Place a part's mesh as it is printed: on z = 0, turned to fit, with its corner at the origin."""
    over = part.face_down == part.face_is_up
    turn = radians(-part.turn_deg if over else part.turn_deg)
    x_up = np.diag([1.0, -1.0, -1.0]) if over else np.eye(3)
    about_z = np.array([[cos(turn), -sin(turn), 0.0], [sin(turn), cos(turn), 0.0], [0.0, 0.0, 1.0]])
    vertices = mesh.vertices @ (about_z @ x_up).T
    return Mesh(vertices - vertices.min(axis=0), mesh.triangles)


def bought_of(servo_joints: Sequence[ServoJoint], layers: Layers, settings: KitSettings) -> list[BoughtPart]:
    """Make simple solids of the servos, horns, pins and rods.

    Args:
        servo_joints: One per turning joint.
        layers: Layers and rods of the parts.
        settings: Settings of the kit.

    Returns:
        The items, in place in the robot.
    """
    things = []
    thickness = settings.thickness_mm
    for servo_joint in servo_joints:
        for side in SIDES:
            label = f"joint {servo_joint.joint.link}, {side}"
            if side in servo_joint.sides(settings.servos_per_joint):
                for kind, shape in (("servo", _servo(servo_joint, thickness)), ("horn", _horn(servo_joint, thickness))):
                    there = _placed(shape, servo_joint.carrier, side, layers, settings)
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
    """Return the length of a pin: both layers and the gap."""
    return 2 * settings.thickness_mm + settings.layer_gap_mm


def _rod(at: tuple[float, float], diameter: float, low: float, length: float) -> Solid:
    return Solid.make_cylinder(diameter / 2, length, Plane((*at, low)))


def _servo(servo_joint: ServoJoint, face: float) -> Shape:
    """Make case, ears and spline in the frame of the part that carries them, the case's top flush with the face."""
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
    """Triangulate a solid and merge the vertices that neighbouring faces share."""
    points, triangles = shape.tessellate(_MESH_MM, _MESH_RAD)
    corners = np.array([(p.X, p.Y, p.Z) for p in points])
    _, first, same = np.unique(np.round(corners, 5), axis=0, return_index=True, return_inverse=True)
    merged = same.reshape(-1)[np.array(triangles, dtype=np.int64)]
    a, b, c = merged.T
    return Mesh(corners[first], merged[(a != b) & (b != c) & (c != a)])
