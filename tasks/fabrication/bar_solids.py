"""The printed plates of bars to throw."""

from build123d import Plane, Solid

from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.throwing_bars import ThrowingBar


def plate_of(bar: ThrowingBar, settings: KitSettings) -> Solid:
    """Return a bar's plate, lying with its centre at the origin and its long axis along y, with two bores."""
    thick, radius = settings.thickness_mm, (settings.rod_mm + settings.rod_clearance_mm) / 2
    corner = (-bar.width_mm / 2, -bar.length_mm / 2, 0.0)
    plate = Solid.make_box(bar.width_mm, bar.length_mm, thick, Plane(corner))
    bores = [Solid.make_cylinder(radius, thick, Plane((0.0, sign * bar.rod_at_mm, 0.0))) for sign in (1, -1)]
    (whole,) = plate.cut(*bores).solids()
    return whole
