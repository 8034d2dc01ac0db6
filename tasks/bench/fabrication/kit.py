"""The kit: everything needed to build one design as a robot. Paper, "Manufacturing".

Needs the optional CAD packages: make setup EXTRAS=cad.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.optimize import brentq
from shapely import box, unary_union

from tasks.bench.fabrication.assembly import Assembly, assemble
from tasks.bench.fabrication.checks import KitFinding, findings_of
from tasks.bench.fabrication.features import ear_screw_mm, horn_screw
from tasks.bench.fabrication.kit_settings import KitSettings
from tasks.bench.fabrication.parts import BoughtPart, Gauge, Part, bought_of, gauges_of, parts_of
from tasks.bench.fabrication.printing import rod_g
from tasks.design import Designs


@dataclass(frozen=True)
class BillLine:
    """A line of the bill."""

    kind: str  # print, servo, screw, rod, pin, electronics or supplies
    item: str
    count: int
    note: str
    length_mm: float | None = None  # length of each rod or pin
    mass_g: float | None = None  # mass of all of them; None unless they are prints, servos or steel


@dataclass(frozen=True, eq=False)
class Kit(Assembly):
    """A robot to build, with its parts, bill and findings."""

    parts: tuple[Part, ...]  # pieces to print
    bought: tuple[BoughtPart, ...]  # servos, horns, rods and pins, in place
    gauges: tuple[Gauge, ...]  # test prints for the fit of servo and horn
    findings: tuple[KitFinding, ...]
    bill: tuple[BillLine, ...]

    @property
    def mass_g(self) -> float:
        """Mass of prints, servos and steel, without screws and cables."""
        return sum(line.mass_g for line in self.bill if line.mass_g is not None)


def build_kit(design: Designs, settings: KitSettings) -> Kit:
    """Make the parts of one design and check them. Raises as :func:`tasks.bench.fabrication.assembly.assemble`."""
    assembly = assemble(design, settings)
    parts = parts_of(assembly)
    return Kit(
        **vars(assembly),
        parts=tuple(parts),
        bought=tuple(bought_of(assembly)),
        gauges=gauges_of(assembly.servo_joints),
        findings=findings_of(assembly),
        bill=tuple(_bill_of(assembly, parts)),
    )


def _bill_of(assembly: Assembly, parts: Sequence[Part]) -> list[BillLine]:
    """List what to print, to buy and to cut to length, with what docs/assembly.md and docs/servo.md ask for."""
    lines, settings, layers, servo = [], assembly.settings, assembly.layers, assembly.servo
    for part in parts:
        note = f"PLA, {settings.infill:.0%} infill, printed on its {'face' if part.face_down else 'back'}"
        lines.append(BillLine("print", part.name, 1, note, mass_g=part.mass_g))
    n_each, screws = settings.servos_per_joint, Counter[tuple[str, str]]()
    n_servos = n_each * len(assembly.servo_joints)
    for servo_joint in assembly.servo_joints:
        ear = f"{servo.ear_screw_name} × {ear_screw_mm(servo_joint)}"
        horn = f"{servo_joint.horn.screw_name} × {horn_screw(servo_joint).length_mm}"
        screws[ear, "ears"] += n_each * len(servo_joint.ear_holes())
        screws[horn, "horn"] += n_each * len(servo_joint.horn_holes())
        screws[servo.centre_screw_name, "centre of the horn, supplied with the servo"] += n_each
    if n_servos:
        item, note = f"{servo.name} with a {settings.horn} horn", f"{servo.spline_teeth} teeth, {servo.voltage_v:g} V"
        lines.append(BillLine("servo", item, n_servos, note, mass_g=n_servos * servo.mass_g))
    lines += [BillLine("screw", item, n, note) for (item, note), n in sorted(screws.items())]
    rods: Counter[float] = Counter()
    for body, of_body in enumerate(layers.rods):
        rods[round(layers.rod_length_mm(body, settings), 1)] += len(of_body)
    steel = [("rod", length, n, "through both pontoons, glued") for length, n in sorted(rods.items(), reverse=True)]
    n_pins = (2 - n_each) * len(assembly.servo_joints)
    steel.append(("pin", settings.pin_length_mm, n_pins, "turns in the part with the wider bore"))
    for kind, length, n, note in steel:
        grams = n * rod_g(settings.rod_mm, length)
        if n:
            lines.append(BillLine(kind, f"stainless steel rod, {settings.rod_mm:g} mm", n, note, length, grams))
    lines.append(BillLine("supplies", "glue", 1, "for rods, pins and pieces of split parts"))
    if n_servos:
        lines += [
            BillLine("supplies", "silicone sealant", 1, "for servo cases and cable entries"),
            BillLine("supplies", "marine grease", 1, "for the servo gearboxes and the O-rings"),
            BillLine("supplies", f"O-ring for a {servo.spline_mm:g} mm shaft", n_servos, "under the horn"),
            BillLine("electronics", "Pololu Maestro", 1, f"with at least {n_servos} channels"),
            BillLine("electronics", f"{servo.voltage_v:g} V supply", 1, "2.5 A per standard servo, with a switch"),
        ]
    return lines


@dataclass(frozen=True)
class Floating:
    """A kit in a fluid.

    The draught is that of the rest pose, upright as drawn. In the simulation buoyancy acts at each link's centre and
    never tips a robot over. On the bench it does, until the centre of buoyancy is in line with the centre of mass.
    """

    mass_kg: float
    sealed_m3: float  # displaced volume while all pockets hold air [m³]
    sealed_share: float  # submerged share of the sealed volume; it sinks above 1
    flooded_share: float  # the same once all pockets are full; the infill stays dry
    draught_mm: float | None
    """Height of the waterline above the lowest corner of the rest pose, sealed; None if it sinks."""
    height_mm: float  # height of the rest pose


def floating_of(kit: Kit, *, fluid_density: float) -> Floating:
    """Compare a kit's mass with the fluid of a density [kg/m³] that it displaces.

    The volume leaves out the rods and the ends of servos that stand out of the parts.
    """
    servo, n_servos = kit.servo, kit.settings.servos_per_joint * len(kit.servo_joints)
    servos_mm3 = n_servos * servo.length_mm * servo.width_mm * servo.height_mm
    hull_mm3 = 2 * kit.settings.thickness_mm * sum(profile.face.area for profile in kit.profiles)
    printed_mm3 = sum(part.solid.volume for part in kit.parts)
    needed_mm3 = kit.mass_g / 1000 / fluid_density * 1e9
    left, bottom, right, top = unary_union(kit.outlines).bounds

    def missing_mm3(draught: float) -> float:
        under = box(left - 1, bottom - 1, right + 1, bottom + draught)
        area = sum(outline.intersection(under).area for outline in kit.outlines)
        return float(2 * kit.settings.thickness_mm * area - needed_mm3)

    height, draught = top - bottom, None
    if needed_mm3 <= hull_mm3:
        draught = brentq(missing_mm3, 0.0, height) if missing_mm3(height) > 0 else height
    return Floating(
        mass_kg=kit.mass_g / 1000,
        sealed_m3=hull_mm3 * 1e-9,
        sealed_share=needed_mm3 / hull_mm3,
        flooded_share=needed_mm3 / (printed_mm3 + servos_mm3),
        draught_mm=draught,
        height_mm=height,
    )
