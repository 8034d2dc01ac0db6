"""What 3D printing and steel rods require of every part, whatever the robot."""

from math import pi

WALL_MM = 3.0  # wall of a boss around a servo, a horn or a rod
MIN_WALL_MM = 1.2  # thinnest wall that prints well: three lines of a 0.4 mm nozzle
ROD_CLEARANCE_MM = 0.1  # added to a rod's diameter where it is glued or pressed in
SWEEP_CLEARANCE_MM = 1.0  # between a moving part and anything that it must not touch
_SHELL_MM = 0.8  # solid plastic along every surface: two lines of a 0.4 mm nozzle
_PLA_G_MM3, _STEEL_G_MM3 = 1.24e-3, 7.9e-3  # densities of PLA and of stainless steel


def printed_g(volume_mm3: float, area_mm2: float, infill: float) -> float:
    """Estimate the mass of a print from its shell and the share of its interior that is printed."""
    shell = _shell_mm3(volume_mm3, area_mm2)
    return _PLA_G_MM3 * (shell + infill * (volume_mm3 - shell))


def infill_of(mass_g: float, volume_mm3: float, area_mm2: float) -> float:
    """Return the infill with which a print has a mass; below 0 or above 1 if none gives it."""
    shell = _shell_mm3(volume_mm3, area_mm2)
    return (mass_g / _PLA_G_MM3 - shell) / (volume_mm3 - shell)


def rod_g(diameter_mm: float, length_mm: float) -> float:
    """Return the mass of a steel rod."""
    return _STEEL_G_MM3 * pi * diameter_mm**2 / 4 * length_mm


def _shell_mm3(volume_mm3: float, area_mm2: float) -> float:
    return min(volume_mm3, _SHELL_MM * area_mm2)
