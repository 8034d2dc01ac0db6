"""Checks of a kit before it is printed.

A fault means that the robot can't be built or would damage itself, a warning that it can be built but has a drawback.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import degrees, hypot, pi
from typing import Literal

from shapely.geometry.base import BaseGeometry

from tasks.design import N_LINKS
from tasks.fabrication.assembly import Assembly
from tasks.fabrication.built_bodies import Pose, moved
from tasks.fabrication.features import ear_screw_mm, horn_screw
from tasks.fabrication.servo_joints import ServoJoint
from tasks.fabrication.servos import MEASURES
from tasks.fabrication.splits import bed_mm

Severity = Literal["fault", "warning", "note"]

_VARIANT_MOTORS = 2  # actuated joints of the physical variant; paper, "Manufacturing"
_ROUNDING_MM, _ROUNDING_MM2 = 1e-6, 0.01
_ONE_AXIS_MM = 0.05  # a smaller distance between two axes would read 0.0
_YOUNG_PA = 193e9  # stainless steel 304
_LAG_LIMIT = pi / 18  # lag of one pontoon behind the other that is worth a warning [rad]
_NECK_STEP_MM = 0.25


@dataclass(frozen=True)
class KitFinding:
    """A fault, warning or note about a kit."""

    name: str  # name of the check
    severity: Severity
    where: str
    message: str


def findings_of(assembly: Assembly) -> tuple[KitFinding, ...]:
    """Check a robot to build. Returns faults first, then warnings, then notes."""
    checks = (
        *(_variant, _travel, _cradles, shared_space, _threads, _unmeasured),
        *(_walls, _necks, _collisions, _rods, _bed),
    )
    findings = [finding for check in checks for finding in check(assembly)]
    return tuple(sorted(findings, key=lambda finding: ("fault", "warning", "note").index(finding.severity)))


def _variant(assembly: Assembly) -> Iterator[KitFinding]:
    mechanism = assembly.mechanism
    name, n = "not of the variant", len(mechanism.joints)
    if n != _VARIANT_MOTORS:
        message = (
            f"{n} motors are on, the paper's physical variant has {_VARIANT_MOTORS}. The kit locks joints whose motor "
            f"is off; in the main experiments they swing freely"
        )
        yield KitFinding(name, "warning", "design", message)
    for first, second in combinations(range(N_LINKS), 2):
        if mechanism.parent_link[second] != first:
            area = mechanism.links[first].intersection(mechanism.links[second]).area
            if area > _ROUNDING_MM2:
                message = f"overlap by {area:.0f} mm² at rest without a joint, which the physical variant forbids"
                yield KitFinding(name, "warning", f"links {first} and {second}", message)


def _travel(assembly: Assembly) -> Iterator[KitFinding]:
    for servo_joint in assembly.servo_joints:
        joint, servo = servo_joint.joint, servo_joint.servo
        if joint.motion_range > servo.travel_rad / 2:
            message = (
                f"swings ±{degrees(joint.motion_range):.0f}°, but servo {servo.name} turns only "
                f"±{degrees(servo.travel_rad / 2):.0f}°. Choose a servo with more travel (--set kit.servo=...)"
            )
            yield KitFinding("servo's travel", "fault", f"joint {joint.link}", message)


def _cradles(assembly: Assembly) -> Iterator[KitFinding]:
    mechanism = assembly.mechanism
    for servo_joint in assembly.servo_joints:
        where, body = f"joint {servo_joint.joint.link}", mechanism.bodies[servo_joint.carrier]
        width = mechanism.link_size[servo_joint.carrier_link][0]
        area = servo_joint.cradle.difference(body.outline).area
        if servo_joint.cradle_width_mm > width:
            message = (
                f"the cradle is {servo_joint.cradle_width_mm:.1f} mm wide, link {servo_joint.carrier_link} only "
                f"{width:.1f} mm: a boss of {area:.0f} mm² stands out"
            )
            yield KitFinding("cradle wider than its link", "warning", where, message)
        elif area > _ROUNDING_MM2:
            message = f"a boss of {area:.0f} mm² stands out of {body.name}"
            yield KitFinding("cradle stands out", "note", where, message)


def shared_space(assembly: Assembly) -> Iterator[KitFinding]:
    """Find joints so close on one part that their servos need the same space."""
    for a, b in combinations(assembly.servo_joints, 2):
        for body in {a.carrier, a.driven} & {b.carrier, b.driven}:
            first, second = (one.pocket if one.carrier == body else one.recess for one in (a, b))
            shared = first.intersection(second).area
            if shared > _ROUNDING_MM2:
                apart = hypot(a.joint.at[0] - b.joint.at[0], a.joint.at[1] - b.joint.at[1])
                where = f"are {apart:.1f} mm apart" if apart >= _ONE_AXIS_MM else "turn about one axis"
                message = f"{where} on part {body + 1}: their pockets overlap by {shared:.0f} mm²"
                yield KitFinding("servos in one place", "fault", f"joints {a.joint.link} and {b.joint.link}", message)


def _threads(assembly: Assembly) -> Iterator[KitFinding]:
    """Compare the engaged length of threads, which is equal at all joints, with their diameter."""
    for servo_joint in assembly.servo_joints[:1]:
        servo, horn = servo_joint.servo, servo_joint.horn
        in_horn = horn_screw(servo_joint, assembly.settings).engaged_mm
        in_plate = ear_screw_mm(servo_joint) - servo.ear_thickness_mm
        for what, engaged, diameter in (
            (f"{horn.screw_name} screws in the {horn.kind} horn", in_horn, horn.screw_mm),
            (f"{servo.ear_screw_name} screws in the plate", in_plate, servo.ear_screw_mm),
        ):
            if engaged < diameter:
                message = (
                    f"the {what} engage {engaged:.1f} mm of thread, expected at least their diameter, {diameter:g} mm. "
                    f"Glue the threads, or use a thicker horn (--set kit.measured.thickness_mm=...)"
                )
                yield KitFinding("short thread", "warning", "every joint", message)


def _unmeasured(assembly: Assembly) -> Iterator[KitFinding]:
    for servo_joint in assembly.servo_joints[:1]:
        n = sum(name not in servo_joint.servo.sources for name in MEASURES)
        if n:
            message = (
                f"{n} of {len(MEASURES)} dimensions of a {servo_joint.servo.name} and its {servo_joint.horn.kind} horn "
                f"are typical values without a source. Measure yours and print the gauges first; the page lists them"
            )
            yield KitFinding("not measured", "warning", "every joint", message)


def _walls(assembly: Assembly) -> Iterator[KitFinding]:
    """Find thin walls between two features, and between a feature and the outline."""
    least = assembly.settings.min_wall_mm
    for (body, side), cut in assembly.features.items():
        walls: dict[tuple[str, str], list[float]] = defaultdict(list)
        for a, b in combinations(cut, 2):
            overlap_in_z = min(a.high_mm, b.high_mm) - max(a.low_mm, b.low_mm)
            meet = a.group == b.group and a.outline.distance(b.outline) < _ROUNDING_MM
            if overlap_in_z > 0 and not meet:
                walls[f"{a.label} ({a.group})", f"{b.label} ({b.group})"].append(a.outline.distance(b.outline))
        whole = assembly.outlines[body]
        for feature in cut:
            if feature.label != "cable":
                wall = feature.outline.distance(whole.boundary) if whole.contains(feature.outline) else 0.0
                walls[f"{feature.label} ({feature.group})", "the outside"].append(wall)
        for (first, second), between in walls.items():
            if min(between) < least:
                message = f"{min(between):.2f} mm between {first} and {second}, expected at least {least:g} mm"
                yield KitFinding("wall too thin", "fault", f"part {body + 1}, {side}", message)


def _necks(assembly: Assembly) -> Iterator[KitFinding]:
    """Find the width at which shrinking a part from all sides splits it."""
    settings = assembly.settings
    for body, outline in zip(assembly.mechanism.bodies, assembly.outlines, strict=True):
        width = 0.0
        while width < settings.min_neck_mm:
            width += _NECK_STEP_MM
            left = outline.buffer(-width / 2)
            pieces = [piece for piece in getattr(left, "geoms", [left]) if piece.area > settings.min_neck_mm**2]
            if len(pieces) != 1:
                severity: Severity = "fault" if width <= settings.min_wall_mm else "warning"
                message = f"is {width:.1f} mm wide at its narrowest, expected at least {settings.min_neck_mm:g}"
                yield KitFinding("narrow neck", severity, body.name, message)
                break


def _collisions(assembly: Assembly) -> Iterator[KitFinding]:
    """Check parts of one layer at rest, in the gait, and anywhere in the ranges of their joints."""
    mechanism, outlines, clearance = assembly.mechanism, assembly.outlines, assembly.settings.sweep_clearance_mm
    for a, b in combinations(mechanism.bodies, 2):
        if assembly.layers.outer[a.index] != assembly.layers.outer[b.index]:
            continue
        passing, still = outlines[b.index], outlines[a.index].buffer(clearance)
        joints = " and ".join(f"joint {joint.link}" for joint, _ in mechanism.path(a.index, b.index))
        severity: Severity = "fault"
        if (area := outlines[a.index].intersection(passing).area) > _ROUNDING_MM2:
            message = (
                f"overlap by {area:.0f} mm² at rest. Change rest_angle in the design file, or choose another design"
            )
        elif (area := _largest_overlap(still, passing, mechanism.poses_in_gait(a.index, b.index))) > _ROUNDING_MM2:
            message = (
                f"overlap by {area:.0f} mm² in the gait, with a clearance of {clearance:g} mm. "
                f"Reduce motion_range or change phase of {joints} in the design file, or choose another design"
            )
        elif (area := _largest_overlap(still, passing, mechanism.poses_in_range(a.index, b.index))) > _ROUNDING_MM2:
            severity = "warning"
            message = (
                f"clear one another in the gait, but overlap by {area:.0f} mm² elsewhere in the range of {joints}. "
                f"Do not move these joints one at a time when away from rest"
            )
        else:
            continue
        yield KitFinding("parts collide", severity, f"{a.name} and {b.name}", message)


def _largest_overlap(still: BaseGeometry, passing: BaseGeometry, poses: Sequence[Pose]) -> float:
    return max((still.intersection(moved(passing, pose)).area for pose in poses), default=0.0)


def _rods(assembly: Assembly) -> Iterator[KitFinding]:
    settings, layers = assembly.settings, assembly.layers
    for body, rods in zip(assembly.mechanism.bodies, layers.rods, strict=True):
        if not rods:
            swept = " and clear of the parts that sweep over it" if layers.outer[body.index] else ""
            message = f"has no room for a rod with a wall of {settings.wall_mm:g} mm around it{swept}"
            yield KitFinding("no room for rods", "fault", body.name, message)
        elif len(rods) < settings.rods_per_part:
            message = f"has room for {len(rods)} of {settings.rods_per_part} rods, so its copies twist more"
            yield KitFinding("few rods", "warning", body.name, message)
    if settings.servos_per_joint == 1:
        for servo_joint in assembly.servo_joints:
            lag = lag_rad(assembly, servo_joint)
            if lag > _LAG_LIMIT:
                angle = f"{degrees(lag):.0f}°" if lag < pi / 2 else "more than 90°"
                message = (
                    f"the pontoon without a servo lags by {angle} when half of the full torque acts there. Use two "
                    f"servos (--set kit.servos_per_joint=2) or thicker rods (--set kit.rod_mm=...)"
                )
                yield KitFinding("rods give way", "warning", f"joint {servo_joint.joint.link}", message)


def lag_rad(assembly: Assembly, servo_joint: ServoJoint) -> float:
    """Estimate how far [rad] the pontoon without a servo lags at a joint if half of the full torque acts there.

    A rod clamped at both ends resists a sideways shift of its ends with 12 E I / L³, where L is its free length. Rods
    at distances r from the joint's axis resist a turn about it with the sum of that times r². The lags of both parts
    add up. The lag is infinite if a part has no rod away from the axis.
    """
    settings, layers = assembly.settings, assembly.layers
    inertia = pi * (settings.rod_mm / 1000) ** 4 / 64
    lag = 0.0
    for body in (servo_joint.carrier, servo_joint.driven):
        free = (layers.rod_length_mm(body, settings) - 2 * settings.thickness_mm) / 1000
        sideways = 12 * _YOUNG_PA * inertia / free**3
        at = servo_joint.joint.at
        reach2 = sum((x - at[0]) ** 2 + (y - at[1]) ** 2 for x, y in layers.rods[body]) / 1e6
        if reach2 == 0.0:
            return float("inf")
        lag += servo_joint.servo.stall_torque_nm / 2 / (sideways * reach2)
    return lag


def _bed(assembly: Assembly) -> Iterator[KitFinding]:
    name, settings = "larger than the bed", assembly.settings
    width, depth = bed_mm(settings)
    if settings.thickness_mm > settings.bed_mm[2]:
        message = f"is {settings.thickness_mm:g} mm high, but the printer reaches only {settings.bed_mm[2]:g} mm"
        yield KitFinding(name, "fault", "every part", message)
    for body, split, outline in zip(assembly.mechanism.bodies, assembly.splits, assembly.outlines, strict=True):
        if len(split.pieces) > 1 or not split.fits:
            low_x, low_y, high_x, high_y = outline.bounds
            size = f"is {high_x - low_x:.0f} × {high_y - low_y:.0f} mm, the usable bed {width:.0f} × {depth:.0f} mm"
            if split.fits:
                message = f"{size}. It is split into {len(split.pieces)} pieces: slide them together and glue them"
                yield KitFinding(name, "note", body.name, message)
            else:
                message = f"{size}. No cut across a link that misses servos and rods makes its pieces fit"
                yield KitFinding(name, "fault", body.name, message)
