"""Parts to print and to buy, in place in the assembled robot. Parts are extruded along z."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import cos, radians, sin
from typing import Self

import numpy as np
from build123d import Axis, Box, Cylinder, Face, Location, Plane, Shape, Sketch, Solid, Wire, extrude, mirror
from shapely import Point as ShapelyPoint
from shapely import Polygon, unary_union

from tasks.arrays import Float64, Int64
from tasks.bench.fabrication.assembly import SIDES, Assembly
from tasks.bench.fabrication.built_bodies import RigidPart
from tasks.bench.fabrication.features import Feature, cradle_features, horn_features, horn_screw, horn_seat_mm, plate_mm
from tasks.bench.fabrication.kit_error import KitError
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.printing import ROD_CLEARANCE_MM, printed_g
from tasks.bench.fabrication.profile import Profile, cradle_boss, horn_boss, location, polygon_of
from tasks.bench.fabrication.servo_joints import ServoJoint
from tasks.bench.fabrication.splits import MIN_PIECE_MM2, bed_mm, turn_to_fit
from tasks.bench.fabrication.throwing_bars import ThrowingBar

_VOLUME_TOLERANCE = 5e-4  # relative; the analytic volume uses chords for arcs
_MESH_MM, _MESH_RAD = 0.05, 0.2  # largest distance of a mesh from a curved face, and turn between its facets
_RIM_MM = 3.0  # of a gauge's pocket behind the ears


@dataclass(frozen=True, eq=False)
class Part:
    """A piece to print."""

    name: str
    body: int
    side: str
    solid: Solid  # solid, in place in the robot
    outline: Polygon
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
class Gauge:
    """A slice of a part, as it lies on the bed."""

    name: str
    solid: Solid
    mass_g: float


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed surface of triangles whose normals point outward."""

    vertices: Float64  # (n_vertices, 3) positions [mm]
    triangles: Int64  # (n_triangles, 3) indices of vertices

    def on_bed(self) -> Self:
        """Return the mesh with its lowest corner at the origin."""
        return replace(self, vertices=self.vertices - self.vertices.min(axis=0))


def parts_of(assembly: Assembly) -> list[Part]:
    """Make both copies of all parts, in pieces if they are split. Raises KitError as :func:`gauges_of`."""
    return [piece for body in assembly.mechanism.bodies for side in SIDES for piece in _pieces(assembly, body, side)]


def _pieces(assembly: Assembly, body: RigidPart, side: str) -> list[Part]:
    settings, split, features = assembly.settings, assembly.splits[body.index], assembly.features[body.index, side]
    cuts = [Feature("cut", "cut", cut, 0.0, settings.thickness_mm) for cut in split.cuts]
    name, n = f"part-{body.index + 1}-{side}", len(split.pieces)
    solids = _cut_out(name, assembly.profiles[body.index], [*features, *cuts], settings.thickness_mm, n)
    parts = []
    for number, outline in enumerate(split.pieces):
        solid = min(solids, key=lambda s: _mismatch(s, outline))
        piece = _placed(solid, assembly, body.index, side).solids()[0]
        parts.append(
            Part(
                name=name if n == 1 else f"{name}-{chr(ord('a') + number)}",
                body=body.index,
                side=side,
                solid=piece,
                outline=outline,
                mass_g=printed_g(piece.volume, piece.area, settings.infill),
                face_down=any(feature.label == "pocket" for feature in features),
                face_is_up=not assembly.placement(body.index, side)[0],
                turn_deg=turn_to_fit(outline, bed_mm(settings)) or 0.0,
            )
        )
    return parts


def gauges_of(servo_joints: Sequence[ServoJoint]) -> tuple[Gauge, ...]:
    """Make two small prints that show whether servo and horn fit before the parts are printed; none without a servo.

    The gauges are slices of the kit's own parts: the plate that the ears are screwed to with a rim of the pocket, and
    the horn's recess with the plastic under it. With servo and horn in place, the gap between the gauges equals the gap
    between the layers. Raises KitError if the CAD kernel made a solid that does not match the outlines.
    """
    if not servo_joints:
        return ()
    at_origin = replace(servo_joints[0], joint=replace(servo_joints[0].joint, at=(0.0, 0.0)), angle=0.0)
    settings = at_origin.settings
    bottom = settings.thickness_mm - plate_mm(at_origin) - _RIM_MM
    servo = _slice("gauge-servo", cradle_boss(at_origin), cradle_features(at_origin), bottom, settings)
    height = servo.solid.bounding_box().size.Z
    flipped = servo.solid.rotate(Axis.X, 180.0).moved(Location((0.0, 0.0, height)))  # the pocket opens upward
    bottom = horn_seat_mm(at_origin) - horn_screw(at_origin).web_mm
    horn = _slice("gauge-horn", horn_boss(at_origin), horn_features(at_origin), bottom, settings)
    return (replace(servo, solid=flipped), horn)


def _slice(name: str, boss: Sketch, features: Sequence[Feature], bottom_mm: float, settings: KitSettings) -> Gauge:
    """Make the slice above a height of a part that consists of a boss only."""
    cut = [
        replace(feature, low_mm=max(feature.low_mm - bottom_mm, 0.0), high_mm=feature.high_mm - bottom_mm)
        for feature in features
        if feature.high_mm > bottom_mm
    ]
    face = boss.faces()[0]
    (solid,) = _cut_out(name, Profile(face, polygon_of(face)), cut, settings.thickness_mm - bottom_mm, 1)
    return Gauge(name, solid, printed_g(solid.volume, solid.area, settings.infill))


def _cut_out(name: str, profile: Profile, features: Sequence[Feature], thickness: float, n_pieces: int) -> list[Solid]:
    """Cut features out of an extruded outline, and check the number of solids and their volume.

    A cut that grazes an edge leaves crumbs, which are no pieces.
    """
    whole, tools = extrude(profile.face, thickness), [_tool(feature) for feature in features]
    cut: list[Solid] = (whole.cut(*tools) if tools else whole).solids()
    expected = _volume_mm3(profile, features, thickness)
    volume = sum(solid.volume for solid in cut)
    solids = [solid for solid in cut if solid.volume > MIN_PIECE_MM2 * thickness]
    if len(solids) != n_pieces or not all(solid.is_valid for solid in solids):
        raise KitError(
            f"{name}: expected {n_pieces} valid solids, got {len(solids)} ({sum(s.is_valid for s in solids)} valid)"
        )
    if abs(volume - expected) > _VOLUME_TOLERANCE * expected:
        raise KitError(f"{name}: volume is {volume:.1f} mm³, expected {expected:.1f}")
    return solids


def _volume_mm3(profile: Profile, features: Sequence[Feature], thickness: float) -> float:
    """Compute the volume of a part, layer by layer between the heights where a feature begins or ends."""
    heights = sorted({0.0, thickness, *(f.low_mm for f in features), *(f.high_mm for f in features)})
    volume = profile.face.area * thickness
    for low, high in pairwise(heights):
        here = [f.outline for f in features if f.low_mm <= low and f.high_mm >= high]
        volume -= (high - low) * unary_union(here).intersection(profile.polygon).area if here else 0.0
    return float(volume)


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


def bought_of(assembly: Assembly) -> list[BoughtPart]:
    """Make simple solids of the servos, horns, pins and rods, in place in the robot."""
    things, settings, layers = [], assembly.settings, assembly.layers
    thickness = settings.thickness_mm
    for servo_joint in assembly.servo_joints:
        for side in SIDES:
            label = f"joint {servo_joint.joint.link}, {side}"
            if side in servo_joint.sides:
                for kind, shape in (("servo", _servo(servo_joint, thickness)), ("horn", _horn(servo_joint, thickness))):
                    there = _placed(shape, assembly, servo_joint.carrier, side)
                    things.append(BoughtPart(f"{kind} of {label}", kind, there))
            else:
                low = 0.0 if side == "left" else settings.pitch_mm - thickness - settings.layer_gap_mm
                pin = _rod(servo_joint.joint.at, settings.rod_mm, low, settings.pin_length_mm)
                things.append(BoughtPart(f"pin of {label}", "pin", pin))
    for body, rods in enumerate(layers.rods):
        low, length = layers.low_mm(body, settings), layers.rod_length_mm(body, settings)
        for number, at in enumerate(rods, 1):
            rod = _rod(at, settings.rod_mm, low, length)
            things.append(BoughtPart(f"rod {number} of part {body + 1}", "rod", rod))
    return things


def _placed(shape: Shape, assembly: Assembly, body: int, side: str) -> Shape:
    mirrored, up = assembly.placement(body, side)
    if mirrored:
        shape = mirror(shape, about=Plane.XY.offset(assembly.settings.thickness_mm / 2))
    return shape.moved(Location((0.0, 0.0, up)))


def _rod(at: tuple[float, float], diameter: float, low: float, length: float) -> Solid:
    return Solid.make_cylinder(diameter / 2, length, Plane((*at, low)))


def plate_of(bar: ThrowingBar, settings: KitSettings) -> Solid:
    """Return the plate of a bar to throw, lying with its centre at the origin and its long axis along y."""
    thick, diameter = settings.thickness_mm, settings.rod_mm + ROD_CLEARANCE_MM
    plate = Solid.make_box(bar.width_mm, bar.length_mm, thick, Plane((-bar.width_mm / 2, -bar.length_mm / 2, 0.0)))
    (whole,) = plate.cut(*(_rod((0.0, sign * bar.rod_at_mm), diameter, 0.0, thick) for sign in (1, -1))).solids()
    return whole


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
    return location(servo_joint.joint.at, servo_joint.angle) * (case + ears + hub)


def _horn(servo_joint: ServoJoint, face: float) -> Shape:
    horn = servo_joint.horn
    height = face + horn.top_mm - horn.thickness_mm / 2
    if horn.kind == "disc":
        shape: Shape = Cylinder(horn.long_mm, horn.thickness_mm)
    else:
        shape = Box(2 * horn.long_mm, horn.arm_width_mm, horn.thickness_mm)
        shape += Box(horn.arm_width_mm, 2 * horn.short_mm, horn.thickness_mm)
    return location(servo_joint.joint.at, servo_joint.angle) * (Location((0, 0, height)) * shape)


def mesh_of(shape: Shape) -> Mesh:
    """Triangulate a solid and merge the vertices that neighbouring faces share."""
    points, triangles = shape.tessellate(_MESH_MM, _MESH_RAD)
    corners = np.array([(p.X, p.Y, p.Z) for p in points])
    _, first, same = np.unique(np.round(corners, 5), axis=0, return_index=True, return_inverse=True)
    merged = same.reshape(-1)[np.array(triangles, dtype=np.int64)]
    a, b, c = merged.T
    return Mesh(corners[first], merged[(a != b) & (b != c) & (c != a)])


def on_bed(part: Part, mesh: Mesh) -> Mesh:
    """Place a part's mesh as it is printed: on z = 0, turned to fit, with its corner at the origin."""
    over = part.face_down == part.face_is_up
    turn = radians(-part.turn_deg if over else part.turn_deg)
    x_up = np.diag([1.0, -1.0, -1.0]) if over else np.eye(3)
    about_z = np.array([[cos(turn), -sin(turn), 0.0], [sin(turn), cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return Mesh(mesh.vertices @ (about_z @ x_up).T, mesh.triangles).on_bed()
