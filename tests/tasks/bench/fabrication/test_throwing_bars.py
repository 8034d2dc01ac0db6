"""Bars to throw: their masses and moments of inertia are those of links."""

import numpy as np
import pytest

from tasks.bench.fabrication.kit_error import KitError
from tasks.bench.fabrication.kit_settings import KitSettings, ThrowingKit
from tasks.bench.fabrication.parts import plate_of
from tasks.bench.fabrication.throwing_bars import throwing_bars

KIT = KitSettings()
BARS = throwing_bars(ThrowingKit(), KIT, 1000.0)


def test_a_bar_is_as_heavy_as_its_share_of_the_fluid():
    """Every link has 1 m²: 70 × 70 mm at scale, in two plates of 25 mm, at 0.8 times the density of water."""
    for bar, length in zip(BARS, (1.0, 1.5, 2.0, 3.0), strict=True):
        assert (bar.length_mm, bar.width_mm) == pytest.approx((70 * length, 70 / length))
        assert bar.mass_g == pytest.approx(0.8 * 70 * 70 * 50 / 1000)
        assert 2 * bar.plate_g + bar.rods_g + bar.trim_g == pytest.approx(bar.mass_g)
        assert bar.rod_at_mm**2 == pytest.approx((bar.length_mm**2 + bar.width_mm**2) / 12)  # of inertia
        assert abs(bar.trim_g) < 0.01 * bar.mass_g and 0.4 < bar.infill < 0.5  # the paper's robot has 45 %


def test_the_mass_of_a_plate_is_that_of_its_solid():
    for bar in BARS:
        solid = plate_of(bar, KIT)
        shell = 0.8 * float(solid.area)
        mass = 1.24 * (shell + bar.infill * (solid.volume - shell)) / 1000
        assert bar.plate_g == pytest.approx(mass, rel=1e-6)
        size = solid.bounding_box().size
        assert pytest.approx((bar.width_mm, bar.length_mm, 25.0), abs=1e-6) == (size.X, size.Y, size.Z)
        bores = 2 * np.pi / 4 * 3.1**2 * 25
        assert bar.length_mm * bar.width_mm * 25 - solid.volume == pytest.approx(bores, rel=1e-6)


@pytest.mark.parametrize(
    ("throwing", "kit", "message"),
    [
        ({}, {"rod_mm": 6.0}, "bar-70: too heavy at any infill"),
        ({"density_ratio": 1.6}, {}, "too light at any infill"),
        ({"lengths": (1.0, 2.0, 8.0)}, {}, "bar-560: 9 × 560 mm is too small for rods"),
    ],
)
def test_bars_that_can_not_be_made(throwing, kit, message):
    with pytest.raises(KitError, match=message):
        throwing_bars(ThrowingKit(**throwing), KitSettings(**kit), 1000.0)
