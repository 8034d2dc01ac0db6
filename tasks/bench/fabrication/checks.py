"""Checks of a kit before it is printed.

A fault means that the robot can't be built or would damage itself, a warning that it can be built but has a drawback.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import degrees, inf
from typing import Literal

from shapely.geometry.base import BaseGeometry

from tasks.bench.fabrication.assembly import Assembly
from tasks.bench.fabrication.built_bodies import Pose, moved
from tasks.bench.fabrication.printing import MIN_WALL_MM, SWEEP_CLEARANCE_MM, WALL_MM
from tasks.bench.fabrication.splits import bed_mm

Severity = Literal["fault", "warning"]

_VARIANT_MOTORS = 2  # actuated joints of the physical variant; paper, "Manufacturing"
_ROUNDING_MM, _ROUNDING_MM2 = 1e-6, 0.01
_MIN_NECK_MM, _NECK_STEP_MM = 8.0, 0.25  # narrowest place of an outline that is strong enough; accuracy


@dataclass(frozen=True)
class KitFinding:
    """A fault or a warning about a kit."""

    severity: Severity
    where: str
    message: str


def findings_of(assembly: Assembly) -> tuple[KitFinding, ...]:
    """Check a robot to build."""
    checks = (_variant, _travel, _walls, _necks, _collisions, _rods, _bed)
    return tuple(finding for check in checks for finding in check(assembly))


def _variant(assembly: Assembly) -> Iterator[KitFinding]:
    n = len(assembly.mechanism.joints)
    if n != _VARIANT_MOTORS:
        message = (
            f"{n} motors are on, the paper's physical variant has {_VARIANT_MOTORS}. The kit locks joints whose motor "
            f"is off; in the main experiments they swing freely"
        )
        yield KitFinding("warning", "design", message)


def _travel(assembly: Assembly) -> Iterator[KitFinding]:
    for servo_joint in assembly.servo_joints:
        joint, servo = servo_joint.joint, servo_joint.servo
        if joint.reach > servo.travel_rad / 2:
            message = (
                f"swings ±{degrees(joint.reach):.0f}°, but servo {servo.name} turns only "
                f"±{degrees(servo.travel_rad / 2):.0f}°. Choose a servo with more travel (--set kit.servo=...)"
            )
            yield KitFinding("fault", f"joint {joint.link}", message)


def _walls(assembly: Assembly) -> Iterator[KitFinding]:
    """Find thin walls between two features, and between a feature and the outline."""
    for (body, side), cut in assembly.features.items():
        walls: dict[tuple[str, str], float] = defaultdict(lambda: inf)
        names = [f"{feature.label} ({feature.group})" for feature in cut]
        for (a, first), (b, second) in combinations(zip(cut, names, strict=True), 2):
            between = a.outline.distance(b.outline)
            overlap_in_z = min(a.high_mm, b.high_mm) - max(a.low_mm, b.low_mm)
            if overlap_in_z > 0 and not (a.group == b.group and between < _ROUNDING_MM):
                walls[first, second] = min(walls[first, second], between)
        whole = assembly.outlines[body]
        for feature, name in zip(cut, names, strict=True):
            if feature.label != "cable":
                wall = feature.outline.distance(whole.boundary) if whole.contains(feature.outline) else 0.0
                walls[name, "the outside"] = min(walls[name, "the outside"], wall)
        for (first, second), between in walls.items():
            if between < MIN_WALL_MM:
                message = f"{between:.2f} mm between {first} and {second}, expected at least {MIN_WALL_MM:g} mm"
                yield KitFinding("fault", f"part {body + 1}, {side}", message)


def _necks(assembly: Assembly) -> Iterator[KitFinding]:
    """Find the width at which shrinking a part from all sides splits it."""
    for body, outline in zip(assembly.mechanism.bodies, assembly.outlines, strict=True):
        width = 0.0
        while width < _MIN_NECK_MM:
            width += _NECK_STEP_MM
            left = outline.buffer(-width / 2)
            pieces = [piece for piece in getattr(left, "geoms", [left]) if piece.area > _MIN_NECK_MM**2]
            if len(pieces) != 1:
                message = f"is {width:.1f} mm wide at its narrowest, expected at least {_MIN_NECK_MM:g}"
                yield KitFinding("fault" if width <= MIN_WALL_MM else "warning", body.name, message)
                break


def _collisions(assembly: Assembly) -> Iterator[KitFinding]:
    """Check parts of one layer at rest, in the gait, and anywhere in the ranges of their joints."""
    mechanism, outlines = assembly.mechanism, assembly.outlines
    for a, b in combinations(mechanism.bodies, 2):
        if assembly.layers.outer[a.index] != assembly.layers.outer[b.index]:
            continue
        passing, still = outlines[b.index], outlines[a.index].buffer(SWEEP_CLEARANCE_MM)
        joints = " and ".join(f"joint {joint.link}" for joint, _ in mechanism.path(a.index, b.index))
        severity: Severity = "fault"
        if (area := outlines[a.index].intersection(passing).area) > _ROUNDING_MM2:
            where, advice = "at rest", "Change rest_angle in the design file, or choose another design"
        elif (area := _largest_overlap(still, passing, mechanism.poses_in_gait(a.index, b.index))) > _ROUNDING_MM2:
            where = f"in the gait, with a clearance of {SWEEP_CLEARANCE_MM:g} mm"
            advice = f"Reduce motion_range or change phase of {joints} in the design file, or choose another design"
        elif (area := _largest_overlap(still, passing, mechanism.poses_in_range(a.index, b.index))) > _ROUNDING_MM2:
            severity, where = "warning", f"elsewhere in the range of {joints} than in the gait"
            advice = "Do not move these joints one at a time when away from rest"
        else:
            continue
        yield KitFinding(severity, f"{a.name} and {b.name}", f"overlap by {area:.0f} mm² {where}. {advice}")


def _largest_overlap(still: BaseGeometry, passing: BaseGeometry, poses: Sequence[Pose]) -> float:
    return max((still.intersection(moved(passing, pose)).area for pose in poses), default=0.0)


def _rods(assembly: Assembly) -> Iterator[KitFinding]:
    layers = assembly.layers
    for body, rods in zip(assembly.mechanism.bodies, layers.rods, strict=True):
        if not rods:
            swept = " and clear of the parts that sweep over it" if layers.outer[body.index] else ""
            message = f"has no room for a rod with a wall of {WALL_MM:g} mm around it{swept}"
            yield KitFinding("fault", body.name, message)
        elif len(rods) < 2:
            yield KitFinding("warning", body.name, "has room for 1 of 2 rods, so its copies twist more")


def _bed(assembly: Assembly) -> Iterator[KitFinding]:
    settings, (width, depth) = assembly.settings, bed_mm(assembly.settings)
    if settings.thickness_mm > settings.bed_mm[2]:
        message = f"is {settings.thickness_mm:g} mm high, but the printer reaches only {settings.bed_mm[2]:g} mm"
        yield KitFinding("fault", "every part", message)
    for body, split, outline in zip(assembly.mechanism.bodies, assembly.splits, assembly.outlines, strict=True):
        if not split.fits:
            low_x, low_y, high_x, high_y = outline.bounds
            message = (
                f"is {high_x - low_x:.0f} × {high_y - low_y:.0f} mm, the usable bed {width:.0f} × {depth:.0f} mm. No "
                f"cut across a link that misses servos and rods makes its pieces fit"
            )
            yield KitFinding("fault", body.name, message)
