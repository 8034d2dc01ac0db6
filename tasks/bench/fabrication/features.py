"""Features: the pockets and bores of a part, as outlines in the plane between two heights.

Heights count from the part's back (0) to its face (the thickness), which faces the other layer. The same list makes the
solid, its analytic volume and the check of walls.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from shapely import Point as ShapelyPoint
from shapely import Polygon

from tasks.bench.fabrication.built_bodies import Point
from tasks.bench.fabrication.kit_error import KitError
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.printing import MIN_WALL_MM, ROD_CLEARANCE_MM
from tasks.bench.fabrication.servo_joints import ServoJoint

_ARC_SEGMENTS = 64  # chords per quarter of a circle, whose area is then off by 1 part in 10,000
_NOTCH_DEPTH_MM = 5.0  # of the cable's exit in the rim of the pocket
_PILOT = 0.85  # pilot hole of a self-tapping screw, in screw diameters
_PIVOT_CLEARANCE_MM = 0.3  # added to a pin's diameter where a part turns on it
_CLEARANCE_MM = 0.4  # added to a screw's diameter where it passes freely
_HEAD = 2.0  # head of a screw, in screw diameters
_HEAD_CLEARANCE_MM = 1.0  # added to a head's diameter for the screwdriver
_MIN_WEB_MM = 5.0  # plastic under the heads of the horn's screws
_TIP_MM = 0.5  # by which those screws protrude from the horn, and their distance to the servo's case
_OVERLAP_MM = 0.5  # of sunk heads and the centre screw's hole where there is no room for a wall
SCREW_LENGTHS_MM = (4, 5, 6, 8, 10, 12, 16, 20, 25, 30, 35, 40, 50, 60)  # on sale: those of ISO 4762 and ISO 7049


@dataclass(frozen=True, eq=False)
class Feature:
    """A pocket or bore."""

    label: str
    group: str  # features of one group may meet; those of different groups may not
    outline: Polygon
    low_mm: float
    high_mm: float
    circle: tuple[Point, float] | None = None  # centre and radius of a round feature


def _bore(label: str, group: str, at: Point, diameter: float, low: float, high: float) -> Feature:
    outline = ShapelyPoint(at).buffer(diameter / 2, quad_segs=_ARC_SEGMENTS)
    return Feature(label, group, outline, low, high, (at, diameter / 2))


def plate_mm(servo_joint: ServoJoint) -> float:
    """Return the thickness of the plate that the ears are screwed to: the height of the case above the ears."""
    return servo_joint.servo.height_mm - servo_joint.servo.ear_bottom_mm - servo_joint.servo.ear_thickness_mm


def ear_screw_mm(servo_joint: ServoJoint) -> int:
    """Choose the longest screw on sale that ends within the plate that the ears are screwed to, or raise KitError."""
    reach = servo_joint.servo.ear_thickness_mm + plate_mm(servo_joint)
    fitting = [length for length in SCREW_LENGTHS_MM if length <= reach]
    if not fitting:
        raise KitError(
            f"servo {servo_joint.servo.name}: ears and plate are {reach:g} mm thick, expected at least "
            f"{SCREW_LENGTHS_MM[0]} mm, the shortest screw"
        )
    return fitting[-1]


def check_room_between(servo_joints: Sequence[ServoJoint], settings: KitSettings) -> None:
    """Raise KitError unless the pontoons leave room for their inner layers and the servos that stand out of them."""
    out = max((servo_joint.servo.height_mm - settings.thickness_mm for servo_joint in servo_joints), default=0.0)
    layers = 2 * settings.thickness_mm + settings.layer_gap_mm if servo_joints else settings.thickness_mm
    room = settings.pitch_mm + settings.thickness_mm - 2 * layers - 2 * max(out, 0.0)
    if room <= 0.0:
        raise KitError(
            f"pitch_mm is {settings.pitch_mm:g}: two layers of {settings.thickness_mm:g} mm per pontoon "
            f"and their servos leave {room:.1f} mm between the pontoons, expected more than 0"
        )


def cradle_features(servo_joint: ServoJoint) -> list[Feature]:
    """List the servo's pocket, ear screws and cable exits. Raises KitError if the part is too thin for the servo."""
    servo, group = servo_joint.servo, f"servo of joint {servo_joint.joint.link}"
    thickness = servo_joint.settings.thickness_mm
    floor = thickness - plate_mm(servo_joint)
    if floor < servo.ear_thickness_mm + _NOTCH_DEPTH_MM:
        raise KitError(
            f"thickness_mm is {thickness:g}: servo {servo.name} needs at least "
            f"{plate_mm(servo_joint) + servo.ear_thickness_mm + _NOTCH_DEPTH_MM:g}"
        )
    features = [
        Feature("pocket", group, servo_joint.pocket, 0.0, floor),
        Feature("case", group, servo_joint.case, floor, thickness),
    ]
    pilot = _PILOT * servo.ear_screw_mm
    features += [_bore("ear screw", group, at, pilot, floor, thickness) for at in servo_joint.ear_holes()]
    return features + [Feature("cable", group, way, 0.0, _NOTCH_DEPTH_MM) for way in servo_joint.cable_ways]


def horn_features(servo_joint: ServoJoint) -> list[Feature]:
    """List the recess and screw holes in the part that a horn turns. Raises KitError if that part is too thin."""
    horn, settings, group = servo_joint.horn, servo_joint.settings, f"horn of joint {servo_joint.joint.link}"
    thickness, clearance = settings.thickness_mm, settings.servo_clearance_mm
    seat = horn_seat_mm(servo_joint)
    if seat < _MIN_WEB_MM:
        raise KitError(
            f"thickness_mm is {thickness:g}: the horn of servo {servo_joint.servo.name} needs at least "
            f"{thickness - seat + _MIN_WEB_MM:g}"
        )
    at = servo_joint.joint.at
    if horn.kind == "disc":
        features = [_bore("horn", group, at, 2 * servo_joint.recess_radius_mm, seat, thickness)]
    else:
        half = horn.arm_width_mm / 2 + clearance
        long, wide = (reach + clearance for reach in (horn.long_mm, horn.short_mm))
        features = [
            Feature("horn", group, servo_joint.rectangle((-long, long), half), seat, thickness),
            Feature("horn", group, servo_joint.rectangle((-half, half), wide), seat, thickness),
            _bore("horn", group, at, horn.hub_mm + 2 * clearance, seat, thickness),
        ]
    through = _HEAD * servo_joint.servo.centre_screw_mm + _HEAD_CLEARANCE_MM
    head = _HEAD * horn.screw_mm + _CLEARANCE_MM
    between = horn.screw_radius_mm - head / 2 - through / 2
    sunk = seat - horn_screw(servo_joint).web_mm
    features.append(_bore("centre screw", group, at, through, sunk, seat))
    if sunk > 0.0:  # where a wall between the bores would be too thin, they meet
        wide = through if between >= MIN_WALL_MM else 2 * (horn.screw_radius_mm - head / 2 + _OVERLAP_MM)
        features.append(_bore("centre screw", group, at, wide, 0.0, sunk))
    for hole in servo_joint.horn_holes():
        features.append(_bore("horn screw", group, hole, horn.screw_mm + _CLEARANCE_MM, sunk, seat))
        if sunk > 0.0:
            features.append(_bore("screw head", group, hole, head, 0.0, sunk))
    return features


def horn_seat_mm(servo_joint: ServoJoint) -> float:
    """Return the height of the recess's floor, on which the horn's top lies."""
    return servo_joint.settings.thickness_mm - (servo_joint.horn.top_mm - servo_joint.settings.layer_gap_mm)


class HornScrew(NamedTuple):
    """A screw that holds a part on its horn."""

    length_mm: int
    web_mm: float  # plastic that it passes through; its head is sunk into the rest


def horn_screw(servo_joint: ServoJoint) -> HornScrew:
    """Choose the shortest screw on sale that passes through the horn, and sink its head as deep as needed.

    Raises KitError if every length leaves too little plastic or touches the servo's case.
    """
    horn, seat = servo_joint.horn, horn_seat_mm(servo_joint)
    for length in SCREW_LENGTHS_MM:
        web = min(length - horn.thickness_mm - _TIP_MM, seat)
        if web >= _MIN_WEB_MM and length - web <= horn.top_mm - _TIP_MM:
            return HornScrew(length, web)
    raise KitError(
        f"servo {servo_joint.servo.name}: no screw of {SCREW_LENGTHS_MM[0]} to {SCREW_LENGTHS_MM[-1]} mm holds a "
        f"{horn.kind} horn {horn.thickness_mm:g} mm thick that ends {horn.top_mm:g} mm above the case. It must pass "
        f"through {_MIN_WEB_MM:g} to {seat:g} mm of plastic and the horn, and end {_TIP_MM:g} mm before the case"
    )


def features_of(
    body: int, side: str, servo_joints: Sequence[ServoJoint], rods: Sequence[Point], settings: KitSettings
) -> tuple[Feature, ...]:
    """List the pockets and bores of a part's copy in one pontoon, left or right, with its rods."""
    features: list[Feature] = []
    for servo_joint in servo_joints:
        if body not in (servo_joint.carrier, servo_joint.driven):
            continue
        carries = servo_joint.carrier == body
        if side in servo_joint.sides:
            features += cradle_features(servo_joint) if carries else horn_features(servo_joint)
        else:
            diameter = settings.rod_mm + (ROD_CLEARANCE_MM if carries else _PIVOT_CLEARANCE_MM)
            group = f"pin of joint {servo_joint.joint.link}"
            features.append(_bore("pin", group, servo_joint.joint.at, diameter, 0.0, settings.thickness_mm))
    for number, rod in enumerate(rods, 1):
        diameter = settings.rod_mm + ROD_CLEARANCE_MM
        features.append(_bore("rod", f"rod {number}", rod, diameter, 0.0, settings.thickness_mm))
    return tuple(features)
