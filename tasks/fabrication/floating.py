"""Floating: the robot's mass, the fluid that it displaces, and its draught.

The draught is that of the rest pose, upright as drawn. In the simulation buoyancy acts at each link's centre and never
tips a robot over. On the bench it does, until the centre of buoyancy is in line with the centre of mass.
"""

from dataclasses import dataclass

from shapely import box, unary_union

from tasks.fabrication.kit import Kit


@dataclass(frozen=True)
class Floating:
    """A kit in a fluid."""

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
    mass = kit.mass_g / 1000
    case = kit.servo.length_mm * kit.servo.width_mm * kit.servo.height_mm
    servos = sum(case * kit.settings.servos_per_joint for _ in kit.servo_joints)
    sealed, flooded = kit.hull_mm3 * 1e-9, (kit.printed_mm3 + servos) * 1e-9
    left, bottom, right, top = unary_union(kit.outlines).bounds
    needed = mass / fluid_density
    draught = None
    if needed <= sealed:
        low, high = 0.0, top - bottom
        for _ in range(60):
            middle = (low + high) / 2
            under = box(left - 1, bottom - 1, right + 1, bottom + middle)
            area = sum(outline.intersection(under).area for outline in kit.outlines)
            enough = 2 * kit.settings.thickness_mm * area * 1e-9 >= needed
            low, high = (low, middle) if enough else (middle, high)
        draught = high
    return Floating(
        mass_kg=mass,
        sealed_m3=sealed,
        sealed_share=needed / sealed,
        flooded_share=needed / flooded,
        draught_mm=draught,
        height_mm=top - bottom,
    )
