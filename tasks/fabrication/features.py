"""Features: what is cut out of a part, as outlines in the plane between two heights.

Heights are from the part's back (0) to its face (the thickness), which looks at the other layer. The same list makes
the solid, its analytic volume, the DXF and the check of walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from shapely import Point as ShapelyPoint
from shapely import Polygon, unary_union
from shapely.geometry.base import BaseGeometry

from tasks.fabrication.built_bodies import Point
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.servo_joints import ServoJoint

ARC_SEGMENTS = 64
"""Chords for a quarter of a circle: their area misses the circle's by 1 part in 10,000."""
NOTCH_DEPTH_MM = 5.0
"""Of the cable's way out, in the rim of the pocket."""
PILOT = 0.85
"""Of a self-tapping screw's diameter: the hole that it cuts its thread into."""
CLEAR_MM = 0.4
"""Added to a screw's diameter where it passes freely."""
_HEAD = 2.0
"""Of a screw's diameter: its head, nearly."""
HEAD_CLEAR_MM = 1.0
"""Added to a head's diameter where it and the driver pass."""
WEB_MM = 5.0
"""Of plastic under the heads of the horn's screws, at least."""
TIP_MM = 0.5
"""By which those screws come out of the horn, so that its whole thickness holds them, and stay off the servo's case."""
MEET_MM = 0.5
"""By which sunk heads and the centre screw's hole overlap where there is no room for a wall between them."""
SCREW_LENGTHS_MM = (4, 5, 6, 8, 10, 12, 16, 20, 25, 30, 35, 40, 50, 60)
"""That are sold: the preferred lengths of ISO 4762 and ISO 7049."""


class KitError(ValueError):
    """Settings that no part can be made with: names them, what was expected and what came."""


@dataclass(frozen=True, eq=False)
class Feature:
    """Something cut out."""

    label: str
    group: str
    """Features of one group may meet; those of two may not."""
    outline: Polygon
    low_mm: float
    high_mm: float
    circle: tuple[Point, float] | None = None
    """Centre and radius, if it is round."""


def bore(label: str, group: str, at: Point, diameter: float, low: float, high: float) -> Feature:
    """Give a round feature."""
    outline = ShapelyPoint(at).buffer(diameter / 2, quad_segs=ARC_SEGMENTS)
    return Feature(label, group, outline, low, high, (at, diameter / 2))


def plate_mm(servo_joint: ServoJoint) -> float:
    """Give the thickness of the plate that the ears are screwed to: what the case is higher than its ears."""
    return servo_joint.servo.height_mm - servo_joint.servo.ear_bottom_mm - servo_joint.servo.ear_thickness_mm


def ear_screw_mm(servo_joint: ServoJoint) -> int:
    """Choose the longest screw that is sold and ends within the plate that the ears are screwed to.

    Raises:
        KitError: even the shortest would come out of it.
    """
    reach = servo_joint.servo.ear_thickness_mm + plate_mm(servo_joint)
    fitting = [length for length in SCREW_LENGTHS_MM if length <= reach]
    if not fitting:
        raise KitError(
            f"servo {servo_joint.servo.name}: its ears and the plate before them are {reach:g} mm thick, expected "
            f"{SCREW_LENGTHS_MM[0]} or more, the shortest screw"
        )
    return fitting[-1]


def check_room_between(servo_joints: Sequence[ServoJoint], settings: KitSettings) -> None:
    """Refuse pontoons so close that their inner layers, or the servos that stand out of them, would meet.

    Raises:
        KitError: says how much room is left.
    """
    out = max((servo_joint.servo.height_mm - settings.thickness_mm for servo_joint in servo_joints), default=0.0)
    layers = 2 * settings.thickness_mm + settings.layer_gap_mm if servo_joints else settings.thickness_mm
    room = settings.pitch_mm + settings.thickness_mm - 2 * layers - 2 * max(out, 0.0)
    if room <= 0.0:
        raise KitError(
            f"pitch_mm is {settings.pitch_mm:g}: two layers of {settings.thickness_mm:g} mm a pontoon "
            f"and their servos leave {room:.1f} mm between the pontoons, expected more than 0"
        )


def cradle_features(servo_joint: ServoJoint, settings: KitSettings) -> list[Feature]:
    """Cut the servo's pocket, its ears' screws and its cable's ways out into the part that carries it.

    Raises:
        KitError: the part is too thin for the servo.
    """
    servo, group, thickness = servo_joint.servo, f"servo of joint {servo_joint.joint.link}", settings.thickness_mm
    floor = thickness - plate_mm(servo_joint)
    if floor < servo.ear_thickness_mm + NOTCH_DEPTH_MM:
        raise KitError(
            f"thickness_mm is {thickness:g}: servo {servo.name} needs at least "
            f"{plate_mm(servo_joint) + servo.ear_thickness_mm + NOTCH_DEPTH_MM:g}"
        )
    features = [
        Feature("pocket", group, servo_joint.pocket, 0.0, floor),
        Feature("case", group, servo_joint.case, floor, thickness),
    ]
    features += [
        bore("ear screw", group, at, PILOT * servo.ear_screw_mm, floor, thickness) for at in servo_joint.ear_holes()
    ]
    features += [Feature("cable", group, way, 0.0, NOTCH_DEPTH_MM) for way in servo_joint.cable_ways]
    return features


def horn_features(servo_joint: ServoJoint, settings: KitSettings) -> list[Feature]:
    """Cut the horn's recess and its screws' holes into the part that it turns.

    Raises:
        KitError: the part is too thin for the horn.
    """
    horn, group, thickness = servo_joint.horn, f"horn of joint {servo_joint.joint.link}", settings.thickness_mm
    seat = horn_seat_mm(servo_joint, settings)
    if seat < WEB_MM:
        raise KitError(
            f"thickness_mm is {thickness:g}: the horn of servo {servo_joint.servo.name} needs at least "
            f"{thickness - seat + WEB_MM:g}"
        )
    at = servo_joint.joint.at
    if horn.kind == "disc":
        features = [bore("horn", group, at, 2 * servo_joint.recess_radius_mm, seat, thickness)]
    else:
        half = horn.arm_width_mm / 2 + servo_joint.clearance_mm
        long, wide = (reach + servo_joint.clearance_mm for reach in (horn.long_mm, horn.short_mm))
        features = [
            Feature("horn", group, servo_joint.placed(-long, long, half), seat, thickness),
            Feature("horn", group, servo_joint.placed(-half, half, wide), seat, thickness),
            bore("horn", group, at, horn.hub_mm + 2 * servo_joint.clearance_mm, seat, thickness),
        ]
    through = _HEAD * servo_joint.servo.centre_screw_mm + HEAD_CLEAR_MM
    head = _HEAD * horn.screw_mm + CLEAR_MM
    between = horn.screw_radius_mm - head / 2 - through / 2
    sunk = seat - horn_screw(servo_joint, settings).web_mm
    features.append(bore("centre screw", group, at, through, sunk, seat))
    if sunk > 0.0:  # where a wall between them would be too thin, the bores are made to meet
        wide = through if between >= settings.min_wall_mm else 2 * (horn.screw_radius_mm - head / 2 + MEET_MM)
        features.append(bore("centre screw", group, at, wide, 0.0, sunk))
    for hole in servo_joint.horn_holes():
        features.append(bore("horn screw", group, hole, horn.screw_mm + CLEAR_MM, sunk, seat))
        if sunk > 0.0:
            features.append(bore("screw head", group, hole, head, 0.0, sunk))
    return features


def horn_seat_mm(servo_joint: ServoJoint, settings: KitSettings) -> float:
    """Give the height of the recess' floor, on which the horn's top lies."""
    return settings.thickness_mm - (servo_joint.horn.top_mm - settings.layer_gap_mm)


@dataclass(frozen=True)
class HornScrew:
    """One of the screws that hold a part on its horn."""

    length_mm: int
    web_mm: float
    """Of plastic that it passes; above, its head is sunk into the part."""
    engaged_mm: float
    """Of the horn that its thread holds in."""


def horn_screw(servo_joint: ServoJoint, settings: KitSettings) -> HornScrew:
    """Choose the shortest screw that is sold and comes out of the horn, by sinking its head as deep as that takes.

    Raises:
        KitError: every length leaves too little plastic, or touches the servo's case.
    """
    horn, seat = servo_joint.horn, horn_seat_mm(servo_joint, settings)
    for length in SCREW_LENGTHS_MM:
        web = min(length - horn.thickness_mm - TIP_MM, seat)
        if web >= WEB_MM and length - web <= horn.top_mm - TIP_MM:
            return HornScrew(length, web, min(length - web, horn.thickness_mm))
    raise KitError(
        f"servo {servo_joint.servo.name}: no screw of {SCREW_LENGTHS_MM[0]} to {SCREW_LENGTHS_MM[-1]} mm holds a "
        f"{horn.kind} horn {horn.thickness_mm:g} mm thick that ends {horn.top_mm:g} mm above the case: "
        f"expected one that passes {WEB_MM:g} to {seat:g} mm of plastic and the horn, and stays "
        f"{TIP_MM:g} mm off the case"
    )


def pin_feature(servo_joint: ServoJoint, settings: KitSettings, *, turning: bool) -> Feature:
    """Cut the bore of the pin that stands for a servo in the pontoon that has none."""
    clearance = settings.pivot_clearance_mm if turning else settings.rod_clearance_mm
    group = f"pin of joint {servo_joint.joint.link}"
    return bore("pin", group, servo_joint.joint.at, settings.rod_mm + clearance, 0.0, settings.thickness_mm)


def features_of(
    body: int, side: str, servo_joints: Sequence[ServoJoint], rods: Sequence[Point], settings: KitSettings
) -> tuple[Feature, ...]:
    """List all that is cut out of one copy of a part.

    Args:
        body: index of the part.
        side: the pontoon, left or right.
        servo_joints: of the whole robot.
        rods: this part's.
        settings: of the kit.
    """
    features: list[Feature] = []
    for servo_joint in servo_joints:
        if body not in (servo_joint.carrier, servo_joint.driven):
            continue
        carries = servo_joint.carrier == body
        if side in servo_joint.sides(settings.servos_per_joint):
            features += cradle_features(servo_joint, settings) if carries else horn_features(servo_joint, settings)
        else:
            features.append(pin_feature(servo_joint, settings, turning=not carries))
    for number, rod in enumerate(rods, 1):
        diameter = settings.rod_mm + settings.rod_clearance_mm
        features.append(bore("rod", f"rod {number}", rod, diameter, 0.0, settings.thickness_mm))
    return tuple(features)


def volume_mm3(area: float, outline: BaseGeometry, features: Sequence[Feature], thickness: float) -> float:
    """Give the volume of a part analytically, layer by layer between the heights where a feature begins or ends.

    Args:
        area: of the outline, exactly [mm²].
        outline: as a polygon.
        features: cut out of it.
        thickness: of the part.
    """
    heights = sorted({0.0, thickness, *(f.low_mm for f in features), *(f.high_mm for f in features)})
    volume = area * thickness
    for low, high in pairwise(heights):
        here = [f.outline for f in features if f.low_mm <= low and f.high_mm >= high]
        volume -= (high - low) * unary_union(here).intersection(outline).area if here else 0.0
    return float(volume)
