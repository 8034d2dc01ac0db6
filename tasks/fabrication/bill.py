"""The bill of materials: what to print, to buy and to cut to length."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

from tasks.fabrication.assembly import Assembly
from tasks.fabrication.features import ear_screw_mm, horn_screw
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.parts import Part
from tasks.fabrication.servo_joints import ServoJoint


@dataclass(frozen=True)
class BillLine:
    """A line of the bill."""

    kind: str  # print, servo, screw, rod, pin, electronics or supplies
    item: str
    count: int
    note: str
    length_mm: float | None = None  # length of each rod or pin
    mass_g: float | None = None  # mass of all of them; None unless they are prints, servos or steel


def bill_of(assembly: Assembly, parts: Sequence[Part]) -> list[BillLine]:
    """List the materials of a robot: prints first, then items to buy."""
    lines, settings, servo_joints, layers = [], assembly.settings, assembly.servo_joints, assembly.layers
    for part in parts:
        note = f"PLA, {settings.infill:.0%} infill, printed on its {'face' if part.face_down else 'back'}"
        lines.append(BillLine("print", part.name, 1, note, mass_g=part.mass_g))
    screws: Counter[tuple[str, str]] = Counter()
    n_servos = n_pins = 0
    for servo_joint in servo_joints:
        servo, n = servo_joint.servo, settings.servos_per_joint
        n_servos, n_pins = n_servos + n, n_pins + 2 - n
        screws[f"{servo.ear_screw_name} × {ear_screw_mm(servo_joint)}", "ears"] += n * len(servo_joint.ear_holes())
        screw = f"{servo_joint.horn.screw_name} × {horn_screw(servo_joint, settings).length_mm}"
        screws[screw, "horn"] += n * len(servo_joint.horn_holes())
        screws[servo.centre_screw_name, "centre of the horn, supplied with the servo"] += n
    if n_servos:
        servo = servo_joints[0].servo
        item, note = f"{servo.name} with a {settings.horn} horn", f"{servo.spline_teeth} teeth, {servo.voltage_v:g} V"
        lines.append(BillLine("servo", item, n_servos, note, mass_g=n_servos * servo.mass_g))
    lines += [BillLine("screw", item, n, note) for (item, note), n in sorted(screws.items())]
    lengths: Counter[float] = Counter()
    for body, rods in enumerate(layers.rods):
        lengths[round(layers.rod_length_mm(body, settings), 1)] += len(rods)
    for length, count in sorted(lengths.items(), reverse=True):
        if count:
            lines.append(_steel("rod", length, count, settings, "through both pontoons, glued"))
    if n_pins:
        note = "turns in the part with the wider bore"
        lines.append(_steel("pin", settings.pin_length_mm, n_pins, settings, note))
    return lines + _supplies(servo_joints, n_servos)


def _supplies(servo_joints: Sequence[ServoJoint], n_servos: int) -> list[BillLine]:
    """List what docs/assembly.md and docs/servo.md ask for beside the robot itself."""
    lines = [BillLine("supplies", "glue", 1, "for rods, pins and pieces of split parts")]
    if n_servos:
        servo = servo_joints[0].servo
        lines += [
            BillLine("supplies", "silicone sealant", 1, "for servo cases and cable entries"),
            BillLine("supplies", "marine grease", 1, "for the servo gearboxes and the O-rings"),
            BillLine("supplies", f"O-ring for a {servo.spline_mm:g} mm shaft", n_servos, "under the horn"),
            BillLine("electronics", "Pololu Maestro", 1, f"with at least {n_servos} channels"),
            BillLine("electronics", f"{servo.voltage_v:g} V supply", 1, "2.5 A per standard servo, with a switch"),
        ]
    return lines


def _steel(kind: str, length_mm: float, n: int, settings: KitSettings, note: str) -> BillLine:
    grams = settings.steel_density_g_cm3 * pi * settings.rod_mm**2 / 4 * length_mm / 1000 * n
    return BillLine(kind, f"stainless steel rod, {settings.rod_mm:g} mm", n, note, length_mm, grams)
