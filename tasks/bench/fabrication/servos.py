"""The servo library: dimensions, torque, speed and pulses of servos on sale.

Lengths are in mm; torques and speeds are SI, at the stated voltage. A hobby servo's torque falls linearly with speed
from the stall torque to zero at the no-load speed.

All numbers are second-hand, some only typical, horns come in many shapes, and clones of a servo differ by tenths of a
millimetre: measure yours (``kit.measured``) and print a kit's two gauges first. Main sources:

- DS3225, the 270° version: DSServo's figures at 5 V (wiki.52pi.com, D-0001), and the calipers and models of builders
  (github.com/adamb314/ServoProject, github.com/lukas/weird_objects: hexapod_walker, github.com/agenticcad/agenticcad).
- HS-85MG: Hitec's figures at 6 V (docaustinextreme.blogspot.com), github.com/process1183/openscad-library; its pulses
  from Fabian Kung's RCServo_API_V100.c. Sources differ on the spline: 24 or 25 teeth.
- MG90S: Tower Pro's page and the sheet MG90S_Tower-Pro.pdf at 6 V, and clones measured in
  github.com/kartchnb/openscad-servo-library. 20 or 21 teeth, 4.6 to 4.9 mm wide, depending on the clone.
- PDI-6221MG, with the torque of the paper's servo: JX's figures at 6 V (github.com/anglerud/makespace_servo_demo), the
  180° version (github.com/KKawaguchi1219/CatchRobo_2023); ears and holes are those of servos of this size.

The frame of a servo has u along the case's long side, v along its short side, and w along the shaft towards the horn,
with its origin on the shaft at the top of the case. The case reaches from u = -shaft_offset to length - shaft_offset.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import radians
from typing import Annotated, Any, Literal, get_type_hints

from tasks.bench.fabrication.kit_error import KitError

KG_CM = 9.80665 * 0.01  # A kilogram-force centimetre [N·m]

Sense = Literal[1, -1]
HornKind = Literal["disc", "cross"]


@dataclass(frozen=True)
class Horn:
    """The horn on the spline, to which the driven part is screwed; what a caliper can measure of it, in words."""

    kind: HornKind
    long_mm: Annotated[float, "horn: from the shaft to the tips of the long arms; radius of a disc"]
    short_mm: Annotated[float, "horn: from the shaft to the tips of the short arms; radius of a disc"]
    arm_width_mm: Annotated[float, "horn: width of an arm; diameter of a disc"]
    hub_mm: Annotated[float, "horn: diameter of the hub"]
    top_mm: Annotated[float, "horn: from the top of the case to the face that the part is screwed to, when mounted"]
    thickness_mm: Annotated[float, "horn: thickness of the disc or the arms"]
    screw_radius_mm: Annotated[float, "horn: from the shaft to the screw holes"]
    screw_mm: float  # diameter of the four screws that hold the driven part
    screw_name: str


@dataclass(frozen=True)
class Servo:
    """A model of servo; what a caliper can measure of its case and ears, in words."""

    name: str
    voltage_v: float  # voltage of the torque and the speed
    stall_torque_nm: float
    no_load_speed_rad_s: float
    mass_g: float
    min_pulse_us: float
    max_pulse_us: float
    travel_rad: float  # angle between the shortest and the longest pulse
    sense: Sense  # 1 if longer pulses turn the horn counter-clockwise, seen from above the horn
    length_mm: Annotated[float, "case: length without ears"]
    width_mm: Annotated[float, "case: width"]
    height_mm: Annotated[float, "case: from bottom to top, including the tower around the shaft"]
    shaft_offset_mm: Annotated[float, "case: from the near end to the middle of the shaft"]
    ear_length_mm: Annotated[float, "ears: length over both"]
    ear_bottom_mm: Annotated[float, "ears: from the bottom of the case to their underside"]
    ear_thickness_mm: Annotated[float, "ears: thickness"]
    hole_span_mm: Annotated[float, "ears: between the holes of one and the other, along the case"]
    hole_pitch_mm: Annotated[float, "ears: between the two holes of one; 0 if it has one hole"]
    ear_screw_mm: float  # diameter of the screws through the ears
    ear_screw_name: str
    spline_mm: float  # outer diameter of the spline
    spline_teeth: int
    centre_screw_mm: float  # diameter of the screw that holds the horn on the spline
    centre_screw_name: str
    cable_width_mm: Annotated[
        float, "flat cable: width"
    ]  # which leaves near the bottom at one end, clones differ in which
    horns: tuple[Horn, ...]  # horns for its spline, the preferred one first

    @property
    def us_per_rad(self) -> float:
        """Change of the pulse per radian [µs/rad]."""
        return (self.max_pulse_us - self.min_pulse_us) / self.travel_rad

    @property
    def neutral_us(self) -> float:
        """Pulse in the middle of the range [µs]."""
        return (self.min_pulse_us + self.max_pulse_us) / 2


def _per_60(seconds: float) -> float:
    """Convert a data sheet's s/60° to rad/s."""
    return radians(60.0) / seconds


_TAPS_3, _TAPS_2, _TAPS_1_5 = "M3 self-tapping", "2 mm self-tapping", "1.5 mm self-tapping"
_TABLE: dict[str, tuple[Any, ...]] = {
    "name": ("ds3225", "hs85mg", "mg90s", "pdi6221mg"),
    "voltage_v": (5.0, 6.0, 6.0, 6.0),
    "stall_torque_nm": (21.0 * KG_CM, 3.5 * KG_CM, 2.2 * KG_CM, 20.32 * KG_CM),
    "no_load_speed_rad_s": (_per_60(0.15), _per_60(0.14), _per_60(0.08), _per_60(0.16)),
    "mass_g": (67.0, 21.8, 13.4, 62.0),
    "min_pulse_us": (500.0, 900.0, 500.0, 500.0),
    "max_pulse_us": (2500.0, 2100.0, 2500.0, 2500.0),
    "travel_rad": (radians(270.0), radians(120.0), radians(180.0), radians(180.0)),
    "sense": (1, -1, 1, 1),
    "length_mm": (40.0, 29.1, 22.8, 40.5),
    "width_mm": (20.0, 13.0, 12.4, 20.2),
    "height_mm": (40.5, 29.9, 28.4, 38.0),
    "shaft_offset_mm": (10.0, 6.55, 6.2, 10.0),
    "ear_length_mm": (54.0, 40.0, 32.1, 54.3),
    "ear_bottom_mm": (28.0, 18.5, 18.5, 27.0),
    "ear_thickness_mm": (2.5, 2.0, 2.5, 2.5),
    "hole_span_mm": (49.5, 35.6, 28.3, 48.9),
    "hole_pitch_mm": (10.0, 0.0, 0.0, 10.0),
    "ear_screw_mm": (3.0, 2.0, 2.0, 3.0),
    "ear_screw_name": (_TAPS_3, _TAPS_2, _TAPS_2, _TAPS_3),
    "spline_mm": (5.9, 4.8, 4.7, 5.9),
    "spline_teeth": (25, 24, 20, 25),
    "centre_screw_mm": (3.0, 2.0, 2.0, 3.0),
    "centre_screw_name": ("M3 × 8", "M2 × 6", "M2 × 6", "M3 × 8"),
    "cable_width_mm": (4.0, 4.0, 4.0, 4.0),
}
_HORN_TABLE: dict[str, tuple[Any, ...]] = {  # for 25 teeth twice, the HS-85MG's, the MG90S's, and one for both of these
    "kind": ("disc", "cross", "cross", "cross", "disc"),
    "long_mm": (10.0, 18.0, 16.0, 18.5, 8.0),
    "short_mm": (10.0, 18.0, 8.5, 8.3, 8.0),
    "arm_width_mm": (20.0, 7.0, 4.5, 6.9, 16.0),
    "hub_mm": (9.0, 12.0, 7.0, 6.9, 7.0),
    "top_mm": (7.5, 6.5, 5.1, 5.0, 5.5),
    "thickness_mm": (2.5, 3.0, 1.6, 1.4, 2.0),
    "screw_radius_mm": (7.0, 10.4, 6.5, 5.0, 5.5),
    "screw_mm": (3.0, 2.0, 1.5, 2.0, 2.0),
    "screw_name": ("M3", _TAPS_2, _TAPS_1_5, _TAPS_2, "M2"),
}


def _column(table: Mapping[str, tuple[Any, ...]], column: int) -> dict[str, Any]:
    return {name: row[column] for name, row in table.items()}


_DISC, _CROSS, _HS85MG_CROSS, _MG90S_CROSS, _MICRO_DISC = (Horn(**_column(_HORN_TABLE, i)) for i in range(5))
_HORNS = ((_DISC, _CROSS), (_HS85MG_CROSS, _MICRO_DISC), (_MG90S_CROSS, _MICRO_DISC), (_DISC, _CROSS))

DIMENSIONS: dict[str, str] = {
    name: hint.__metadata__[0]
    for kind in (Servo, Horn)
    for name, hint in get_type_hints(kind, include_extras=True).items()
    if hasattr(hint, "__metadata__")
}
"""Dimensions that decide the fit and that a caliper can measure: fields of a servo and its horn, in words."""

SERVOS = {name: Servo(horns=_HORNS[i], **_column(_TABLE, i)) for i, name in enumerate(_TABLE["name"])}

_MOST_OFF = 2.0  # factor between a measurement and the library; a larger one is a typing error or another unit


def as_measured(name: str, kind: HornKind, measured: Mapping[str, float]) -> Servo:
    """Return a servo of the library with one horn and the user's measurements [mm] by the names in :data:`DIMENSIONS`.

    Raises KitError if there is no such servo or horn, or a measurement is far from the library's.
    """
    if name not in SERVOS:
        raise KitError(f"servo {name!r} is unknown, expected one of {', '.join(sorted(SERVOS))}")
    servo = SERVOS[name]
    horn = next((horn for horn in servo.horns if horn.kind == kind), None)
    if horn is None:
        kinds = " or ".join(horn.kind for horn in servo.horns)
        raise KitError(f"servo {name}: no {kind} horn, expected {kinds}")
    of_horn = {field.name for field in fields(Horn)}
    for key, value in measured.items():
        usual = getattr(horn if key in of_horn else servo, key)
        if key != "hole_pitch_mm" and not usual / _MOST_OFF <= value <= usual * _MOST_OFF:
            raise KitError(
                f"servo {name}: {key} is {value:g}, expected {usual / _MOST_OFF:g} to {usual * _MOST_OFF:g} mm"
            )
    horn_changes: dict[str, Any] = {key: value for key, value in measured.items() if key in of_horn}
    case_changes: dict[str, Any] = {key: value for key, value in measured.items() if key not in of_horn}
    measured_servo = replace(servo, horns=(replace(horn, **horn_changes),), **case_changes)
    along = ("length_mm", "hole_span_mm", "ear_length_mm")
    sizes = [getattr(measured_servo, key) for key in along]
    if not sizes[0] < sizes[1] < sizes[2]:
        said = " < ".join(along)
        raise KitError(f"servo {name}: expected {said}, got {', '.join(f'{size:g}' for size in sizes)} mm")
    return measured_servo
