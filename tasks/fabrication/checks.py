"""Findings: what is wrong with a kit, or worth knowing, said before anybody prints it.

A fault means that the robot can't be built or would break itself; a warning, that it can, but with a drawback.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import degrees, pi
from typing import Literal

from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from tasks.design import N_LINKS
from tasks.fabrication.built_bodies import Mechanism, Pose, moved
from tasks.fabrication.features import Feature, ear_screw_mm, horn_screw
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.rods import Layers
from tasks.fabrication.servo_joints import ServoJoint
from tasks.fabrication.servos import MEASURES
from tasks.fabrication.splits import Split, bed_mm

Severity = Literal["fault", "warning", "note"]

VARIANT_MOTORS = 2
"""Actuated joints of the physical variant. Paper, "Manufacturing"."""
OVERLAP_MM2 = 0.01
"""Less is rounding."""
_ROUNDING_MM = 1e-6
YOUNG_PA = 193e9
"""Of stainless steel 304."""
TWIST_LIMIT = pi / 18
"""By which one pontoon may lag behind the other at the servo's full torque before it is said [rad]."""
NECK_STEP_MM = 0.25


@dataclass(frozen=True)
class KitFinding:
    """One thing to know of a kit."""

    name: str
    """What kind of thing."""
    severity: Severity
    where: str
    message: str


def findings_of(
    mechanism: Mechanism,
    servo_joints: Sequence[ServoJoint],
    outlines: Sequence[Polygon],
    layers: Layers,
    splits: Sequence[Split],
    features: Mapping[tuple[int, str], Sequence[Feature]],
    settings: KitSettings,
) -> tuple[KitFinding, ...]:
    """Check a kit.

    Args:
        mechanism: n parts.
        servo_joints: one for every joint that turns.
        outlines: of the parts, bosses and fillets included.
        layers: with every part's rods.
        splits: every part's pieces.
        features: of every part's copies, by its index and side.
        settings: what the kit was made with.

    Returns:
        Faults first, then warnings, then notes.
    """
    found = [
        *_not_of_the_variant(mechanism),
        *_travel(servo_joints),
        *_cradles(mechanism, servo_joints),
        *_shared_room(servo_joints),
        *_screws(servo_joints, settings),
        *_unmeasured(servo_joints),
        *_walls(mechanism, outlines, features, settings),
        *_necks(mechanism, outlines, settings),
        *_collisions(mechanism, outlines, layers, settings),
        *_rods(mechanism, servo_joints, layers, settings),
        *_bed(mechanism, splits, settings),
    ]
    return tuple(sorted(found, key=lambda finding: ("fault", "warning", "note").index(finding.severity)))


def _not_of_the_variant(mechanism: Mechanism) -> Iterator[KitFinding]:
    n = len(mechanism.joints)
    if n != VARIANT_MOTORS:
        yield KitFinding(
            "not of the variant",
            "warning",
            "design",
            f"{n} motors are on, the physical variant has {VARIANT_MOTORS}; joints whose motor is off swing "
            f"freely in the main experiments, but are locked here",
        )
    for first, second in combinations(range(N_LINKS), 2):
        if mechanism.parent_link[second] != first:
            area = mechanism.links[first].intersection(mechanism.links[second]).area
            if area > OVERLAP_MM2:
                yield KitFinding(
                    "not of the variant",
                    "warning",
                    f"links {first} and {second}",
                    f"overlap by {area:.0f} mm² at rest without being joined; the variant forbids that",
                )


def _travel(servo_joints: Sequence[ServoJoint]) -> Iterator[KitFinding]:
    for servo_joint in servo_joints:
        asked, half = servo_joint.joint.motion_range, servo_joint.servo.travel_rad / 2
        if asked > half:
            yield KitFinding(
                "servo's travel",
                "fault",
                f"joint {servo_joint.joint.link}",
                f"swings ±{degrees(asked):.0f}°, servo {servo_joint.servo.name} turns ±{degrees(half):.0f}°",
            )


def _cradles(mechanism: Mechanism, servo_joints: Sequence[ServoJoint]) -> Iterator[KitFinding]:
    for servo_joint in servo_joints:
        width = mechanism.link_size[servo_joint.carrier_link][0]
        out = servo_joint.cradle.difference(mechanism.bodies[servo_joint.carrier].outline).area
        if servo_joint.cradle_width_mm > width:
            yield KitFinding(
                "cradle wider than its link",
                "warning",
                f"joint {servo_joint.joint.link}",
                f"the cradle is {servo_joint.cradle_width_mm:.1f} mm wide, link {servo_joint.carrier_link} "
                f"{width:.1f}; a boss of {out:.0f} mm² stands out",
            )
        elif out > OVERLAP_MM2:
            yield KitFinding(
                "cradle stands out",
                "note",
                f"joint {servo_joint.joint.link}",
                f"a boss of {out:.0f} mm² stands out of {mechanism.bodies[servo_joint.carrier].name}",
            )


def _shared_room(servo_joints: Sequence[ServoJoint]) -> Iterator[KitFinding]:
    """Two drives in one part whose hollows meet."""
    for a, b in combinations(servo_joints, 2):
        for body in {a.carrier, a.driven} & {b.carrier, b.driven}:
            rooms = [d.pocket if d.carrier == body else d.recess for d in (a, b)]
            shared = rooms[0].intersection(rooms[1]).area
            if shared > OVERLAP_MM2:
                apart = ((a.joint.at[0] - b.joint.at[0]) ** 2 + (a.joint.at[1] - b.joint.at[1]) ** 2) ** 0.5
                yield KitFinding(
                    "servos in one place",
                    "fault",
                    f"joints {a.joint.link} and {b.joint.link}",
                    f"are {apart:.1f} mm apart on part {body + 1}; their hollows share {shared:.0f} mm²",
                )


def _screws(servo_joints: Sequence[ServoJoint], settings: KitSettings) -> Iterator[KitFinding]:
    """Threads shorter than their diameter; the same at every joint."""
    for servo_joint in servo_joints[:1]:
        servo, horn = servo_joint.servo, servo_joint.horn
        for what, held, diameter in (
            (
                f"{horn.screw_name} screws hold in the {horn.kind} horn",
                horn_screw(servo_joint, settings).engaged_mm,
                horn.screw_mm,
            ),
            (
                f"{servo.ear_screw_name} screws through the ears hold in the plate",
                ear_screw_mm(servo_joint) - servo.ear_thickness_mm,
                servo.ear_screw_mm,
            ),
        ):
            if held < diameter:
                yield KitFinding(
                    "short thread",
                    "warning",
                    "every joint",
                    f"{what} by {held:.1f} mm, expected their diameter, {diameter:g} mm, or more: glue the "
                    f"threads, or take a thicker one (--set kit.measured...)",
                )


def _unmeasured(servo_joints: Sequence[ServoJoint]) -> Iterator[KitFinding]:
    for servo_joint in servo_joints[:1]:
        unknown = [name for name in MEASURES if name not in servo_joint.servo.sources]
        if unknown:
            yield KitFinding(
                "not measured",
                "warning",
                "every joint",
                f"{len(unknown)} of {len(MEASURES)} measures of a {servo_joint.servo.name} and its "
                f"{servo_joint.horn.kind} horn are common ones that nobody has checked; the page lists them. "
                f"Measure yours and print the gauges before the parts",
            )


def _walls(
    mechanism: Mechanism,
    outlines: Sequence[Polygon],
    features: Mapping[tuple[int, str], Sequence[Feature]],
    settings: KitSettings,
) -> Iterator[KitFinding]:
    """Between two hollows, and between a hollow and the outside."""
    for (body, side), cut in features.items():
        thin: dict[tuple[str, str], float] = {}

        def note(key: tuple[str, str], wall: float, thin: dict[tuple[str, str], float] = thin) -> None:
            thin[key] = min(wall, thin.get(key, wall))

        for a, b in combinations(cut, 2):
            overlap_in_z = min(a.high_mm, b.high_mm) - max(a.low_mm, b.low_mm)
            meet = a.group == b.group and a.outline.distance(b.outline) < _ROUNDING_MM
            if overlap_in_z > 0 and not meet:
                note((f"{a.label} ({a.group})", f"{b.label} ({b.group})"), a.outline.distance(b.outline))
        edge = outlines[body].boundary
        for feature in cut:
            if feature.label != "cable":
                wall = feature.outline.distance(edge) if outlines[body].contains(feature.outline) else 0.0
                note((f"{feature.label} ({feature.group})", "the outside"), wall)
        for (first, second), wall in thin.items():
            if wall < settings.min_wall_mm:
                yield KitFinding(
                    "wall too thin",
                    "fault",
                    f"{mechanism.bodies[body].name}, {side}",
                    f"{wall:.2f} mm between {first} and {second}, expected {settings.min_wall_mm:g} or more",
                )


def _necks(mechanism: Mechanism, outlines: Sequence[Polygon], settings: KitSettings) -> Iterator[KitFinding]:
    """Places where a part would come apart if so much were taken from either side."""
    for body, outline in zip(mechanism.bodies, outlines, strict=True):
        width = 0.0
        while width < settings.min_neck_mm:
            width += NECK_STEP_MM
            left = outline.buffer(-width / 2)
            pieces = [piece for piece in getattr(left, "geoms", [left]) if piece.area > settings.min_neck_mm**2]
            if len(pieces) != 1:
                severity: Severity = "fault" if width <= settings.min_wall_mm else "warning"
                yield KitFinding(
                    "narrow neck",
                    severity,
                    body.name,
                    f"it is {width:.1f} mm wide at its narrowest, expected {settings.min_neck_mm:g} or more",
                )
                break


def _collisions(
    mechanism: Mechanism, outlines: Sequence[Polygon], layers: Layers, settings: KitSettings
) -> Iterator[KitFinding]:
    """Parts that lie in one layer, in the gait and anywhere in their joints' ranges."""
    for a, b in combinations(mechanism.bodies, 2):
        if layers.outer[a.index] != layers.outer[b.index]:
            continue
        still = outlines[a.index].buffer(settings.sweep_clearance_mm)
        where, passing = f"{a.name} and {b.name}", outlines[b.index]
        joints = " and ".join(f"joint {joint.link}" for joint, _ in mechanism.path(a.index, b.index))
        if outlines[a.index].intersection(passing).area > OVERLAP_MM2:
            yield KitFinding(
                "parts collide",
                "fault",
                where,
                f"overlap by {outlines[a.index].intersection(passing).area:.0f} mm² at rest: take another "
                f"design, or another rest_angle in the design file",
            )
            continue
        in_gait = _deepest(still, passing, mechanism.poses_in_gait(a.index, b.index))
        if in_gait > OVERLAP_MM2:
            yield KitFinding(
                "parts collide",
                "fault",
                where,
                f"meet in the gait, through {joints}: by {in_gait:.0f} mm² with a clearance of "
                f"{settings.sweep_clearance_mm:g} mm. In the design file, a smaller motion_range or another "
                f"phase of one of these joints may keep them apart; or take another design",
            )
            continue
        in_range = _deepest(still, passing, mechanism.poses_in_range(a.index, b.index))
        if in_range > OVERLAP_MM2:
            yield KitFinding(
                "parts collide",
                "warning",
                where,
                f"miss one another in the gait but meet elsewhere in the ranges of {joints}, by "
                f"{in_range:.0f} mm²: move one joint at a time only near rest",
            )


def _deepest(still: BaseGeometry, passing: BaseGeometry, poses: Sequence[Pose]) -> float:
    return max((still.intersection(moved(passing, pose)).area for pose in poses), default=0.0)


def _rods(
    mechanism: Mechanism, servo_joints: Sequence[ServoJoint], layers: Layers, settings: KitSettings
) -> Iterator[KitFinding]:
    for body, rods in zip(mechanism.bodies, layers.rods, strict=True):
        if not rods:
            swept = " that no other part sweeps" if layers.outer[body.index] else ""
            yield KitFinding(
                "no room for rods",
                "fault",
                body.name,
                f"it has no place{swept} for a rod with a wall of {settings.wall_mm:g} mm",
            )
        elif len(rods) < settings.rods_per_part:
            yield KitFinding(
                "few rods",
                "warning",
                body.name,
                f"there is room for {len(rods)} of {settings.rods_per_part} rods; its copies twist more",
            )
    if settings.servos_per_joint == 1:
        for servo_joint in servo_joints:
            twist = lag_rad(servo_joint, layers, settings)
            if twist > TWIST_LIMIT:
                said = f"{degrees(twist):.0f}°" if twist < pi / 2 else "more than 90°"
                yield KitFinding(
                    "rods give way",
                    "warning",
                    f"joint {servo_joint.joint.link}",
                    f"at the servo's full torque, half of it at the other pontoon, that pontoon lags "
                    f"by {said}; servos_per_joint: 2 or thicker rods help",
                )


def lag_rad(servo_joint: ServoJoint, layers: Layers, settings: KitSettings) -> float:
    """Give the angle at a joint by which the pontoon without a servo lags when half of the full torque is used there.

    A rod clamped at both ends resists a sideways shift of its ends with 12 E I / L³ over its free length L; rods at
    distances r from the joint's axis resist a turn about it with the sum of that times r². Both parts' rods give way.
    """
    inertia = pi * (settings.rod_mm / 1000) ** 4 / 64
    lag = 0.0
    for body in (servo_joint.carrier, servo_joint.driven):
        free = (layers.rod_length_mm(body, settings) - 2 * settings.thickness_mm) / 1000
        sideways = 12 * YOUNG_PA * inertia / free**3
        reach2 = (
            sum((x - servo_joint.joint.at[0]) ** 2 + (y - servo_joint.joint.at[1]) ** 2 for x, y in layers.rods[body])
            / 1e6
        )
        if reach2 == 0.0:
            return float("inf")
        lag += servo_joint.servo.stall_torque_nm / 2 / (sideways * reach2)
    return lag


def _bed(mechanism: Mechanism, splits: Sequence[Split], settings: KitSettings) -> Iterator[KitFinding]:
    width, depth = bed_mm(settings)
    if settings.thickness_mm > settings.bed_mm[2]:
        yield KitFinding(
            "larger than the bed",
            "fault",
            "every part",
            f"is {settings.thickness_mm:g} mm high, the printer {settings.bed_mm[2]:g}",
        )
    for body, split in zip(mechanism.bodies, splits, strict=True):
        if len(split.pieces) > 1 or not split.fits:
            whole = split.whole
            low_x, low_y, high_x, high_y = whole.bounds
            size = (
                f"it is {high_x - low_x:.0f} × {high_y - low_y:.0f} mm, "
                f"the bed {width:.0f} × {depth:.0f} inside its margin"
            )
            if split.fits:
                yield KitFinding(
                    "larger than the bed",
                    "note",
                    body.name,
                    f"{size}: split into {len(split.pieces)} pieces that slide together along the extrusion; glue them",
                )
            else:
                yield KitFinding(
                    "larger than the bed",
                    "fault",
                    body.name,
                    f"{size}: no straight cut across a link that misses servos and rods makes its pieces fit",
                )
