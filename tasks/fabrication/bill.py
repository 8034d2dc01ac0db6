"""The bill of materials: what to print, what to buy, and what to cut to which length."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

from tasks.fabrication.features import ear_screw_mm, horn_screw
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.parts import Part, pin_length_mm
from tasks.fabrication.rods import Layers
from tasks.fabrication.servo_joints import ServoJoint


@dataclass(frozen=True)
class BillLine:
    """One line of the bill."""

    kind: str
    """print, servo, screw, rod, pin, electronics or supplies."""
    item: str
    count: int
    length_mm: float | None
    """To cut each to, of a rod or pin."""
    mass_g: float | None
    """Of all of them; only of prints, servos and steel."""
    note: str


def bill_of(
    parts: Sequence[Part], servo_joints: Sequence[ServoJoint], layers: Layers, settings: KitSettings
) -> list[BillLine]:
    """List what a kit is made of."""
    lines = [
        BillLine(
            "print",
            part.name,
            1,
            None,
            part.mass_g,
            f"PLA, {settings.infill:.0%} infill, on its {'face' if part.face_down else 'back'}",
        )
        for part in parts
    ]
    screws: Counter[tuple[str, str]] = Counter()
    n_servos = n_pins = 0
    for servo_joint in servo_joints:
        servo, n = servo_joint.servo, settings.servos_per_joint
        n_servos, n_pins = n_servos + n, n_pins + 2 - n
        screws[f"{servo.ear_screw_name} × {ear_screw_mm(servo_joint)}", "ears"] += n * len(servo_joint.ear_holes())
        screw = f"{servo_joint.horn.screw_name} × {horn_screw(servo_joint, settings).length_mm}"
        screws[screw, "horn"] += n * len(servo_joint.horn_holes())
        screws[servo.centre_screw_name, "centre of the horn, comes with the servo"] += n
    if n_servos:
        servo = servo_joints[0].servo
        lines.append(
            BillLine(
                "servo",
                f"{servo.name} with a {settings.horn} horn",
                n_servos,
                None,
                n_servos * servo.mass_g,
                f"{servo.spline_teeth} teeth, {servo.voltage_v:g} V",
            )
        )
    lines += [BillLine("screw", item, n, None, None, note) for (item, note), n in sorted(screws.items())]
    lengths: Counter[float] = Counter()
    for body, rods in enumerate(layers.rods):
        lengths[round(layers.rod_length_mm(body, settings), 1)] += len(rods)
    for length, count in sorted(lengths.items(), reverse=True):
        if count:
            lines.append(_steel("rod", length, count, settings, "through both pontoons, glued"))
    if n_pins:
        lines.append(_steel("pin", pin_length_mm(settings), n_pins, settings, "turns in the part with the wider bore"))
    return lines + _what_pages_ask_for(servo_joints, n_servos)


def _what_pages_ask_for(servo_joints: Sequence[ServoJoint], n_servos: int) -> list[BillLine]:
    """List what docs/assembly.md and docs/servo.md need beside the robot's own things."""
    lines = [BillLine("supplies", "glue", 1, None, None, "rods, pins, pieces of split parts")]
    if n_servos:
        servo = servo_joints[0].servo
        lines += [
            BillLine("supplies", "silicone sealant", 1, None, None, "seams of the servos' cases, cables' entries"),
            BillLine("supplies", "marine grease", 1, None, None, "in the servos' gearboxes, on the O-rings"),
            BillLine("supplies", f"O-ring for a {servo.spline_mm:g} mm shaft", n_servos, None, None, "under the horn"),
            BillLine("electronics", "Pololu Maestro", 1, None, None, f"of {n_servos} channels or more"),
            BillLine(
                "electronics",
                f"{servo.voltage_v:g} V supply",
                1,
                None,
                None,
                "2.5 A for each standard servo, with a switch",
            ),
        ]
    return lines


def _steel(kind: str, length: float, n: int, settings: KitSettings, note: str) -> BillLine:
    grams = settings.steel_density_g_cm3 * pi * settings.rod_mm**2 / 4 * length / 1000 * n
    return BillLine(kind, f"stainless steel rod, {settings.rod_mm:g} mm", n, length, grams, note)
