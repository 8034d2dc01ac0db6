"""Bars to throw: a link of the simulation at bench scale, with its density and its moment of inertia.

Like the robot (paper, "Manufacturing"), a bar is two plates joined by rods across the tank: a single plate would turn
out of the plane. A bar is as heavy as its share of the fluid, where a link of 1 kg/m² floats in slush of 1.25. The
infill of the plates follows from that; the rods are most of the ballast. They go through the long axis at
√((width² + length²) / 12) to either side of the centre, the radius of gyration of a homogeneous rectangle, so that they
do not change the moment of inertia per mass.
"""

from dataclasses import dataclass
from math import pi, sqrt

from tasks.bench.fabrication.kit_error import KitError
from tasks.bench.fabrication.kit_settings import KitSettings, ThrowingKit
from tasks.bench.fabrication.printing import ROD_CLEARANCE_MM, WALL_MM, infill_of, printed_g, rod_g

_LEAST_INFILL, _INFILL_STEP = 0.1, 0.01  # that print well; that slicers take
_TAG_SHARES = (0.75, 0.375)  # of a bar's width and length that a tag takes, so that white paper surrounds both tags
_LARGEST_TAG_MM = 40.0


@dataclass(frozen=True)
class ThrowingBar:
    """A bar: two plates and two rods."""

    name: str
    length_scale: float  # long axis of the simulated link [m]
    length_mm: float
    width_mm: float
    rod_at_mm: float  # of each rod from the centre, along the long axis
    infill: float
    plate_g: float  # of each plate
    rods_g: float  # of both rods
    trim_g: float  # to add, half at each rod; below 0, to remove
    mass_g: float  # of the bar as it should be
    tag_mm: float  # edge of each of its two tags
    tag_at_mm: float  # of each tag from the centre, along the long axis


def throwing_bars(throwing: ThrowingKit, settings: KitSettings, fluid_density: float) -> tuple[ThrowingBar, ...]:
    """Compute a kit's bars, from the shortest on, for a fluid in the tank of a density [kg/m³].

    Raises KitError if a bar is too narrow for its rods, or too heavy or too light at any infill.
    """
    return tuple(_bar(length, throwing, settings, fluid_density) for length in sorted(throwing.lengths))


def _bar(length_scale: float, throwing: ThrowingKit, settings: KitSettings, fluid_density: float) -> ThrowingBar:
    scale, thick = settings.scale_mm_per_m, settings.thickness_mm
    length, width = scale * length_scale, scale / length_scale
    name = f"bar-{length:.0f}"
    bore = settings.rod_mm + ROD_CLEARANCE_MM
    gyration = sqrt((width**2 + length**2) / 12)
    if min(width, length - 2 * gyration) < bore + 2 * WALL_MM:
        raise KitError(
            f"{name}: {width:.0f} × {length:.0f} mm is too small for rods of {settings.rod_mm:g} mm: expected thinner "
            f"rods (kit.rod_mm), a larger scale (kit.scale_mm_per_m), or another length (throwing.lengths)"
        )
    mass = throwing.density_ratio * fluid_density * 2 * thick * width * length * 1e-6
    rods = 2 * rod_g(settings.rod_mm, settings.pitch_mm + thick)
    bores = 2 * pi * bore**2 / 4
    volume = (width * length - bores) * thick
    surface = 2 * (width * length - bores) + 2 * (width + length + pi * bore) * thick
    infill = round(infill_of((mass - rods) / 2, volume, surface) / _INFILL_STEP) * _INFILL_STEP
    if not _LEAST_INFILL <= infill <= 1:
        weight, rods_of = ("heavy", "thinner") if infill < _LEAST_INFILL else ("light", "thicker")
        raise KitError(
            f"{name}: too {weight} at any infill: it needs {infill:.0%}, expected {_LEAST_INFILL:.0%} to 100%. Use "
            f"{rods_of} rods (kit.rod_mm), another kit.thickness_mm or another throwing.density_ratio"
        )
    plate = printed_g(volume, surface, infill)
    tag = min(_TAG_SHARES[0] * width, _TAG_SHARES[1] * length, _LARGEST_TAG_MM)
    return ThrowingBar(
        name=name,
        length_scale=length_scale,
        length_mm=length,
        width_mm=width,
        rod_at_mm=gyration,
        infill=infill,
        plate_g=plate,
        rods_g=rods,
        trim_g=mass - rods - 2 * plate,
        mass_g=mass,
        tag_mm=tag,
        tag_at_mm=length / 2 - tag / _TAG_SHARES[0] / 2,
    )
