"""Floating: the robot's mass against the water that it displaces, and how deep it lies.

The draught is that of the rest pose, upright as drawn: in the simulation buoyancy acts at each link's centre, so that
it never tips a robot over. On the bench it does, until the centre of buoyancy is below or above the centre of mass.
"""

from __future__ import annotations

from dataclasses import dataclass

from shapely import box, unary_union

from tasks.fabrication.kit import Kit

HALVINGS = 60


@dataclass(frozen=True)
class Floating:
    """How a kit lies in a fluid."""

    mass_kg: float
    sealed_m3: float
    """Volume that displaces fluid while every pocket and pore keeps its air."""
    flooded_m3: float
    """Volume of plastic and servos alone, once every pocket is full; infill stays dry."""
    sealed_share: float
    """Share of the sealed volume that lies under when it floats; above 1 it sinks."""
    flooded_share: float
    """Share of the flooded volume; above 1 it sinks once its pockets are full."""
    draught_mm: float | None
    """From the lowest corner of the rest pose up to the waterline, sealed; None where it sinks."""
    height_mm: float
    """Of the rest pose."""

    def stands_in(self, depth_mm: float) -> bool:
        """Say whether it touches the floor, in its rest pose, before it floats."""
        return self.draught_mm is not None and self.draught_mm > depth_mm


def floating_of(kit: Kit, *, fluid_density: float) -> Floating:
    """Weigh a kit against what it displaces.

    Args:
        kit: the robot; rods, and the ends of servos that stand out, are left out of its volume.
        fluid_density: [kg/m³]
    """
    mass = kit.mass_g / 1000
    servos = 0.0
    for servo_joint in kit.servo_joints:
        case = servo_joint.servo.length_mm * servo_joint.servo.width_mm * servo_joint.servo.height_mm
        servos += case * kit.settings.servos_per_joint
    sealed, flooded = kit.hull_mm3 * 1e-9, (kit.printed_mm3 + servos) * 1e-9
    outlines = [profile.polygon for profile in kit.profiles]
    left, bottom, right, top = unary_union(outlines).bounds
    needed = mass / fluid_density
    draught = None
    if needed <= sealed:
        low, high = 0.0, top - bottom
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            under = box(left - 1, bottom - 1, right + 1, bottom + middle)
            area = sum(outline.intersection(under).area for outline in outlines)
            enough = 2 * kit.settings.thickness_mm * area * 1e-9 >= needed
            low, high = (low, middle) if enough else (middle, high)
        draught = high
    return Floating(
        mass_kg=mass,
        sealed_m3=sealed,
        flooded_m3=flooded,
        sealed_share=needed / sealed,
        flooded_share=needed / flooded,
        draught_mm=draught,
        height_mm=top - bottom,
    )
