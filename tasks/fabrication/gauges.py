"""Gauges: two small prints that tell whether servo and horn fit, before hours go into parts.

A servo's numbers may be another clone's (tasks/fabrication/servos.py). The gauges are slices of a kit's own parts: the
plate that the ears are screwed to, with a rim of the pocket, and the horn's recess with the plastic under it. What fits
them fits the parts; what does not goes into ``kit.measured``. With servo and horn between them they are as far
apart as the layers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from build123d import Axis, Location, Sketch, Solid, extrude

from tasks.fabrication.features import Feature, cradle_features, horn_features, horn_screw, horn_seat_mm, plate_mm
from tasks.fabrication.kit_settings import KitSettings
from tasks.fabrication.parts import cut_out, printed_mass_g
from tasks.fabrication.profile import cradle_boss, horn_boss, polygon_of
from tasks.fabrication.servo_joints import ServoJoint

RIM_MM = 3.0
"""Of the pocket behind the ears."""


@dataclass(frozen=True, eq=False)
class Gauge:
    """A slice of a part, as it lies on the bed."""

    name: str
    solid: Solid
    volume_mm3: float
    mass_g: float


def gauges_of(servo_joints: Sequence[ServoJoint], settings: KitSettings) -> tuple[Gauge, ...]:
    """Make the gauges of a kit's servo; none where no joint is driven.

    Raises:
        KitError: the part is too thin for the servo or its horn.
        SolidError: the kernel made something else than what the outlines say.
    """
    if not servo_joints:
        return ()
    servo_joint = replace(servo_joints[0], joint=replace(servo_joints[0].joint, at=(0.0, 0.0)), angle=0.0)
    behind_the_ears = settings.thickness_mm - plate_mm(servo_joint)
    under_the_heads = horn_seat_mm(servo_joint, settings) - horn_screw(servo_joint, settings).web_mm
    servo = _slice(
        "gauge-servo",
        cradle_boss(servo_joint),
        cradle_features(servo_joint, settings),
        behind_the_ears - RIM_MM,
        settings,
    )
    height = servo.solid.bounding_box().size.Z
    over = servo.solid.rotate(Axis.X, 180.0).moved(Location((0.0, 0.0, height)))  # the pocket opens upward
    horn = _slice("gauge-horn", horn_boss(servo_joint), horn_features(servo_joint, settings), under_the_heads, settings)
    return (replace(servo, solid=over), horn)


def _slice(name: str, boss: Sketch, features: Sequence[Feature], bottom_mm: float, settings: KitSettings) -> Gauge:
    """Make what lies above a height of a part that is nothing but a boss."""
    cut = [
        replace(feature, low_mm=max(feature.low_mm - bottom_mm, 0.0), high_mm=feature.high_mm - bottom_mm)
        for feature in features
        if feature.high_mm > bottom_mm
    ]
    face = boss.faces()[0]
    height = settings.thickness_mm - bottom_mm
    (solid,) = cut_out(name, extrude(face, height), cut, face.area, polygon_of(face), height, n_pieces=1)
    return Gauge(name, solid, solid.volume, printed_mass_g(solid, settings))
