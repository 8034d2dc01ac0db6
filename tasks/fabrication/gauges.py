"""Gauges: two small prints that show whether servo and horn fit before the parts are printed.

The dimensions of a servo may be those of another clone (tasks/fabrication/servos.py). The gauges are slices of the
kit's own parts: the plate that the ears are screwed to with a rim of the pocket, and the horn's recess with the plastic
under it. If they fit, the parts fit; if not, put your measurements into ``kit.measured``. With servo and horn in
place, the gap between the two gauges equals the gap between the layers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from build123d import Axis, Location, Sketch, Solid, extrude

from tasks.fabrication.features import Feature, cradle_features, horn_features, horn_screw, horn_seat_mm, plate_mm
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.parts import cut_out, printed_mass_g
from tasks.fabrication.profile import cradle_boss, horn_boss, polygon_of
from tasks.fabrication.servo_joints import ServoJoint

_RIM_MM = 3.0  # of the pocket behind the ears


@dataclass(frozen=True, eq=False)
class Gauge:
    """A slice of a part, as it lies on the bed."""

    name: str
    solid: Solid
    volume_mm3: float
    mass_g: float


def gauges_of(servo_joints: Sequence[ServoJoint], settings: KitSettings) -> tuple[Gauge, ...]:
    """Make the gauges of a kit's servo; none if no joint has a servo.

    Raises:
        KitError: The part is too thin for the servo or its horn.
        SolidError: The CAD kernel made a solid that does not match the outlines.
    """
    if not servo_joints:
        return ()
    at_origin = replace(servo_joints[0], joint=replace(servo_joints[0].joint, at=(0.0, 0.0)), angle=0.0)
    bottom = settings.thickness_mm - plate_mm(at_origin) - _RIM_MM
    servo = _slice("gauge-servo", cradle_boss(at_origin), cradle_features(at_origin, settings), bottom, settings)
    height = servo.solid.bounding_box().size.Z
    flipped = servo.solid.rotate(Axis.X, 180.0).moved(Location((0.0, 0.0, height)))  # the pocket opens upward
    bottom = horn_seat_mm(at_origin, settings) - horn_screw(at_origin, settings).web_mm
    horn = _slice("gauge-horn", horn_boss(at_origin), horn_features(at_origin, settings), bottom, settings)
    return (replace(servo, solid=flipped), horn)


def _slice(name: str, boss: Sketch, features: Sequence[Feature], bottom_mm: float, settings: KitSettings) -> Gauge:
    """Make the slice above a height of a part that consists of a boss only."""
    cut = [
        replace(feature, low_mm=max(feature.low_mm - bottom_mm, 0.0), high_mm=feature.high_mm - bottom_mm)
        for feature in features
        if feature.high_mm > bottom_mm
    ]
    face = boss.faces()[0]
    height = settings.thickness_mm - bottom_mm
    (solid,) = cut_out(name, extrude(face, height), cut, face.area, polygon_of(face), height, n_pieces=1)
    return Gauge(name, solid, solid.volume, printed_mass_g(solid, settings))
