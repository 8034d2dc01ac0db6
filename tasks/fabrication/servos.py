"""The servo library: dimensions, torque, speed and pulses of servos on sale, with their sources.

Lengths are in mm; torques and speeds are SI, at the stated voltage. A hobby servo's torque falls linearly with speed
from the stall torque to zero at the no-load speed.

Every number of the tables has the letter of its source, or a question mark for a typical value without a source. All
sources are second-hand, horns come in many shapes, and clones of a servo differ by tenths of a millimetre. A kit
therefore lists what to measure (put it into ``kit.measured``) and holds two gauges to print first.

The frame of a servo has u along the case's long side, v along its short side, and w along the shaft towards the horn,
with its origin on the shaft at the top of the case. The case reaches from u = -shaft_offset to length - shaft_offset.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from math import radians
from typing import Any, Literal

KG_CM = 9.80665 * 0.01  # A kilogram-force centimetre [N·m]

Sense = Literal[1, -1]
HornKind = Literal["disc", "cross"]


class ServoError(ValueError):
    """The library has no such servo or horn, or measurements contradict each other."""


@dataclass(frozen=True)
class Horn:
    """The horn on the spline, to which the driven part is screwed. :data:`MEASURES` describes its dimensions."""

    kind: HornKind
    long_mm: float
    short_mm: float
    arm_width_mm: float
    hub_mm: float
    top_mm: float
    thickness_mm: float
    screw_radius_mm: float
    screw_mm: float  # diameter of the four screws that hold the driven part
    screw_name: str
    sources: Mapping[str, str] = field(default_factory=dict)  # source of each field; a missing field has no source


@dataclass(frozen=True)
class Servo:
    """A model of servo. :data:`MEASURES` describes the dimensions of its case and ears."""

    name: str
    voltage_v: float  # voltage of the torque and the speed
    stall_torque_nm: float
    no_load_speed_rad_s: float
    mass_g: float
    min_pulse_us: float
    max_pulse_us: float
    travel_rad: float  # angle between the shortest and the longest pulse
    sense: Sense  # 1 if longer pulses turn the horn counter-clockwise, seen from above the horn
    length_mm: float
    width_mm: float
    height_mm: float
    shaft_offset_mm: float
    ear_length_mm: float
    ear_bottom_mm: float
    ear_thickness_mm: float
    hole_span_mm: float
    hole_pitch_mm: float
    ear_screw_mm: float  # diameter of the screws through the ears
    ear_screw_name: str
    spline_mm: float  # outer diameter of the spline
    spline_teeth: int
    centre_screw_mm: float  # diameter of the screw that holds the horn on the spline
    centre_screw_name: str
    cable_width_mm: float
    """Width of the flat cable, which leaves near the bottom at one end; clones differ in which end."""
    horns: tuple[Horn, ...]  # horns for its spline, the preferred one first
    sources: Mapping[str, str] = field(default_factory=dict)  # source of each field; a missing field has no source

    @property
    def us_per_rad(self) -> float:
        """Change of the pulse per radian [µs/rad]."""
        return (self.max_pulse_us - self.min_pulse_us) / self.travel_rad

    @property
    def neutral_us(self) -> float:
        """Pulse in the middle of the range [µs]."""
        return (self.min_pulse_us + self.max_pulse_us) / 2

    def horn(self, kind: HornKind) -> Horn:
        """Return the horn of a kind. Raises ServoError if there is none."""
        for horn in self.horns:
            if horn.kind == kind:
                return horn
        raise ServoError(f"servo {self.name}: no {kind} horn, expected {' or '.join(h.kind for h in self.horns)}")


def _per_60(seconds: float) -> float:
    """Convert a data sheet's s/60° to rad/s."""
    return radians(60.0) / seconds


_SOURCES = {
    "A": "a robot arm of DS3225s by adamb314 (github.com/adamb314/ServoProject: CadFiles/Robot/robot2CadQuery.py)",
    "B": "the DS3218, of the same size, after typical data sheets "
    "(github.com/agenticcad/agenticcad: designkit/components/motors.py)",
    "C": "chosen here, for the hole of the ear or of the horn",
    "D": "DSServo's figures for the DS3225 at 5 V, as sellers repeat them "
    "(wiki.52pi.com, D-0001; github.com/vniclos/-6-Axis-Robot-Arm---ESP-32)",
    "E": "a model of the MG996R, another servo of 40.5 mm, by electro57 "
    "(github.com/electro57/RepRap: lib/servos/TowerPro/MG996.scad)",
    "F": "Fabian Kung's servo driver, calibrated with an HS-85MG (RCServo_API_V100.c, 2016): 10 µs a degree from 610 "
    "to 2190 µs, of which a part is used here",
    "G": "Kpower's guide to drawings of servos: typical sizes (kpower.com/insight_gearbox/7396.html)",
    "H": "Hitec's figures for the HS-85MG at 6 V, as a pilot's page repeats them (docaustinextreme.blogspot.com, 2016)",
    "I": "Hitec's sheet of the HS-311, and Blue Robotics' page of a camera tilt with an HS-5055MG: longer pulses turn "
    "clockwise; taken for the HS-85MG too",
    "J": "openscad-library by Josh Gadeken, after Hitec and ServoCity "
    "(github.com/process1183/openscad-library: servos/hitec_hs-85mg.scad)",
    "K": "measured on a clone by Brad Kartchner (github.com/kartchnb/openscad-servo-library: servos/mg90s_clone.scad)",
    "L": "Lynxmotion's wiki, on the horns of its own servos (wiki.lynxmotion.com, SES gearing and horn information)",
    "M": "a horn of 20 teeth, not said whose, by Brad Kartchner (github.com/kartchnb/servohorn_lib: servohorns/20t)",
    "N": "JX's figures for the PDI-6221MG at 6 V, as a seller's page (rcgoing.com) is repeated "
    "(github.com/anglerud/makespace_servo_demo: docs/index.md; without its name, pastebin.com/iaUgYw2u)",
    "P": "the sheet MG90S_Tower-Pro.pdf that sellers hand out (6 V)",
    "Q": "a robot's driver of the 6221MG: 0 to 180° by 500 to 2500 µs "
    "(github.com/KKawaguchi1219/CatchRobo_2023: Servo6221MG/Servo6221MG.cpp)",
    "R": "measured on clones of the S3003, another standard servo, by Brad Kartchner "
    "(github.com/kartchnb/openscad-servo-library: servos/s3003_clone.scad)",
    "T": "Tower Pro's page of the MG90S (towerpro.com.tw/product/mg90s-3), as others quote it",
    "V": "sellers of the 20 mm aluminium disc of 25 teeth (Amazon B07D56FVK5), as a hexapod's builder quotes them "
    "(github.com/lukas/weird_objects: hexapod_walker/prototype_sts3215/hexapod_prototype.py)",
    "W": "a hexapod of DS3225s, the reach of its cross horns by caliper "
    "(github.com/lukas/weird_objects: hexapod_walker/prototype/hexapod_prototype.py)",
    "Y": "Shenzhen Sky Star's sheet of its MG90S, a clone (tinytronics.nl, 000263), as a hexapod's builder quotes it",
}

_NAMES = ("ds3225", "hs85mg", "mg90s", "pdi6221mg")
_TAPS_3, _TAPS_2, _TAPS_1_5 = "M3 self-tapping", "2 mm self-tapping", "1.5 mm self-tapping"
_TABLE: dict[str, tuple[tuple[Any, str], ...]] = {
    # Where sources differ, the maker's figure is taken, then the most common one.
    # DS3225: the 270° version. Length: 40 in D, B and W, up to 40.7 in drawings of similar servos. Height: 40.5 in D,
    # 38 without the tower in W. Shaft: 10 from the end in A, B and W, unlike the 10.2 of an MG996R. Ears: 54 over both
    # in W and B, up to 55 elsewhere. Underside of the ears: 27 in W. Case above the ears: 10 here, about 10.7 in A. The
    # cable's moulded root is 7 mm wide and 6.5 long (W): it fits the pocket beside the case.
    # HS-85MG: the ears' holes are 4.5 mm wide (J), for a grommet. Sources differ on the spline: 24 or 25 teeth.
    # MG90S: 20 or 21 teeth, 4.6 to 4.9 mm wide, depending on the clone.
    # PDI-6221MG: the standard size, 40.5 × 20 × 38, and the torque of the paper's servo. Sold with 120, 180 or 360° of
    # travel; this is the 180° version, although a page that repeats N gives 120°. The height of 38 is taken to include
    # the tower, which no source states. For an MG996R of the same length E has 37.6 to the plate around the tower and
    # 39.7 with it, so measure yours. N has no ears; these are those of other servos of this size. Their holes are 4.4
    # to 4.5 mm wide (R, E), 47.4 (E) to 49.5 (A, G) apart along the case and 9 (R) to 10.5 (E) across. The sense is
    # that of most such servos: try it.
    # field                 ds3225                 hs85mg                 mg90s                  pdi6221mg
    "voltage_v": ((5.0, "D"), (6.0, "H"), (6.0, "P"), (6.0, "N")),
    "stall_torque_nm": ((21.0 * KG_CM, "D"), (3.5 * KG_CM, "H"), (2.2 * KG_CM, "P"), (20.32 * KG_CM, "N")),
    "no_load_speed_rad_s": ((_per_60(0.15), "D"), (_per_60(0.14), "H"), (_per_60(0.08), "P"), (_per_60(0.16), "N")),
    "mass_g": ((67.0, "D"), (21.8, "H"), (13.4, "T"), (62.0, "N")),
    "min_pulse_us": ((500.0, "D"), (900.0, "F"), (500.0, "Y"), (500.0, "Q")),
    "max_pulse_us": ((2500.0, "D"), (2100.0, "F"), (2500.0, "Y"), (2500.0, "Q")),
    "travel_rad": ((radians(270.0), "D"), (radians(120.0), "F"), (radians(180.0), "P"), (radians(180.0), "Q")),
    "sense": ((1, "D"), (-1, "I"), (1, "Y"), (1, "?")),
    "length_mm": ((40.0, "D"), (29.1, "J"), (22.8, "T"), (40.5, "N")),
    "width_mm": ((20.0, "D"), (13.0, "J"), (12.4, "T"), (20.2, "N")),
    "height_mm": ((40.5, "D"), (29.9, "J"), (28.4, "T"), (38.0, "N")),
    "shaft_offset_mm": ((10.0, "A"), (6.55, "J"), (6.2, "K"), (10.0, "E")),
    "ear_length_mm": ((54.0, "W"), (40.0, "J"), (32.1, "T"), (54.3, "E")),
    "ear_bottom_mm": ((28.0, "B"), (18.5, "J"), (18.5, "T"), (27.0, "E")),
    "ear_thickness_mm": ((2.5, "W"), (2.0, "J"), (2.5, "K"), (2.5, "E")),
    "hole_span_mm": ((49.5, "A"), (35.6, "J"), (28.3, "K"), (48.9, "R")),
    "hole_pitch_mm": ((10.0, "W"), (0.0, "J"), (0.0, "K"), (10.0, "W")),
    "ear_screw_mm": ((3.0, "W"), (2.0, "C"), (2.0, "K"), (3.0, "C")),
    "ear_screw_name": ((_TAPS_3, "C"), (_TAPS_2, "C"), (_TAPS_2, "C"), (_TAPS_3, "C")),
    "spline_mm": ((5.9, "B"), (4.8, "?"), (4.7, "K"), (5.9, "G")),
    "spline_teeth": ((25, "W"), (24, "?"), (20, "K"), (25, "N")),
    "centre_screw_mm": ((3.0, "W"), (2.0, "?"), (2.0, "?"), (3.0, "?")),
    "centre_screw_name": (("M3 × 8", "L"), ("M2 × 6", "?"), ("M2 × 6", "?"), ("M3 × 8", "?")),
    "cable_width_mm": ((4.0, "G"), (4.0, "G"), (4.0, "G"), (4.0, "G")),
}

_KINDS: tuple[HornKind, ...] = ("disc", "cross", "cross", "cross", "disc")
_HORN_TABLE: dict[str, tuple[tuple[Any, str], ...]] = {
    # The HS-85MG's hub, top and thickness are those of its double arm, whose holes are 1.15 mm wide. M's arms taper
    # from the hub's 6.9 mm to 4; of the two holes in its short arms, 1.5 mm wide, this is the inner one.
    # field              disc, 25 teeth   cross, 25 teeth    hs85mg's cross      mg90s's cross      micro disc
    "long_mm": ((10.0, "V"), (18.0, "W"), (16.0, "?"), (18.5, "M"), (8.0, "?")),
    "short_mm": ((10.0, "V"), (18.0, "W"), (8.5, "?"), (8.3, "M"), (8.0, "?")),
    "arm_width_mm": ((20.0, "V"), (7.0, "?"), (4.5, "?"), (6.9, "M"), (16.0, "?")),
    "hub_mm": ((9.0, "V"), (12.0, "W"), (7.0, "J"), (6.9, "M"), (7.0, "?")),
    "top_mm": ((7.5, "?"), (6.5, "?"), (5.1, "J"), (5.0, "?"), (5.5, "?")),
    "thickness_mm": ((2.5, "?"), (3.0, "W"), (1.6, "J"), (1.4, "M"), (2.0, "?")),
    "screw_radius_mm": ((7.0, "V"), (10.4, "W"), (6.5, "?"), (5.0, "M"), (5.5, "?")),
    "screw_mm": ((3.0, "V"), (2.0, "W"), (1.5, "C"), (2.0, "C"), (2.0, "?")),
    "screw_name": (("M3", "V"), (_TAPS_2, "C"), (_TAPS_1_5, "C"), (_TAPS_2, "C"), ("M2", "?")),
}


def _numbers(table: Mapping[str, tuple[tuple[Any, str], ...]], column: int) -> dict[str, Any]:
    """Return the numbers of a column, and the sources of those that have one."""
    rows = {key: row[column] for key, row in table.items()}
    sources = {key: _SOURCES[letter] for key, (_, letter) in rows.items() if letter != "?"}
    return {key: number for key, (number, _) in rows.items()} | {"sources": sources}


_DISC, _CROSS, _HS85MG_CROSS, _MG90S_CROSS, _MICRO_DISC = (
    Horn(kind=kind, **_numbers(_HORN_TABLE, column)) for column, kind in enumerate(_KINDS)
)
_HORNS = ((_DISC, _CROSS), (_HS85MG_CROSS, _MICRO_DISC), (_MG90S_CROSS, _MICRO_DISC), (_DISC, _CROSS))

SERVOS: dict[str, Servo] = {
    name: Servo(name=name, horns=_HORNS[column], **_numbers(_TABLE, column)) for column, name in enumerate(_NAMES)
}

MEASURES: dict[str, str] = {
    "length_mm": "case: length without ears",
    "width_mm": "case: width",
    "height_mm": "case: from bottom to top, including the tower around the shaft",
    "shaft_offset_mm": "case: from the near end to the middle of the shaft",
    "ear_length_mm": "ears: length over both",
    "ear_bottom_mm": "ears: from the bottom of the case to their underside",
    "ear_thickness_mm": "ears: thickness",
    "hole_span_mm": "ears: between the holes of one and the other, along the case",
    "hole_pitch_mm": "ears: between the two holes of one; 0 if it has one hole",
    "cable_width_mm": "flat cable: width",
    "long_mm": "horn: from the shaft to the tips of the long arms; radius of a disc",
    "short_mm": "horn: from the shaft to the tips of the short arms; radius of a disc",
    "arm_width_mm": "horn: width of an arm; diameter of a disc",
    "hub_mm": "horn: diameter of the hub",
    "top_mm": "horn: from the top of the case to the face that the part is screwed to, when mounted",
    "thickness_mm": "horn: thickness of the disc or the arms",
    "screw_radius_mm": "horn: from the shaft to the screw holes",
}
"""Dimensions that decide the fit and that a caliper can measure: fields of a servo and its horn, in words."""

_EARS = "ear_bottom_mm + ear_thickness_mm"
_SMALL_AND_LARGE = (
    ("shaft_offset_mm", "length_mm"),
    ("length_mm", "hole_span_mm"),
    ("hole_span_mm", "ear_length_mm"),
    ("hole_pitch_mm", "width_mm"),
    ("cable_width_mm", "width_mm"),
    (_EARS, "height_mm"),
    ("thickness_mm", "top_mm"),
    ("screw_radius_mm", "short_mm"),
    ("screw_radius_mm", "long_mm"),
    ("hub_mm", "2 * screw_radius_mm"),
    ("hub_mm", "2 * short_mm"),
    ("hub_mm", "2 * long_mm"),
)
"""Pairs of which the first must be less than the second."""
_EQUAL_OF_A_DISC = (("short_mm", "long_mm"), ("arm_width_mm", "2 * long_mm"))
_SMALL_AND_LARGE_OF_A_CROSS = (("arm_width_mm", "2 * short_mm"), ("arm_width_mm", "2 * long_mm"))

YOURS = "measured by you"  # source of the measurements in a kit's settings


def servo_named(name: str) -> Servo:
    """Look up a servo in the library. Raises ServoError if there is none of that name."""
    if name not in SERVOS:
        raise ServoError(f"servo {name!r} is unknown, expected one of {', '.join(sorted(SERVOS))}")
    return SERVOS[name]


def as_measured(servo: Servo, kind: HornKind, measured: Mapping[str, float]) -> Servo:
    """Return a servo with one horn and the user's measurements; its sources are those of both.

    Args:
        servo: Servo of the library.
        kind: Kind of the horn.
        measured: Measurements [mm] by the names in :data:`MEASURES`.

    Raises:
        ServoError: There is no such horn, a measurement is not positive, or two contradict each other.
    """
    of_horn = {field.name for field in fields(Horn)}
    horn_changes: dict[str, Any] = {name: value for name, value in measured.items() if name in of_horn}
    case_changes: dict[str, Any] = {name: value for name, value in measured.items() if name not in of_horn}
    horn = replace(servo.horn(kind), **horn_changes)
    sources = {**servo.sources, **horn.sources, **dict.fromkeys(measured, YOURS)}
    servo = replace(servo, horns=(horn,), sources=sources, **case_changes)
    _check({name: getattr(horn if name in of_horn else servo, name) for name in MEASURES}, servo.name, kind)
    return servo


def _check(measures: dict[str, float], servo: str, kind: HornKind) -> None:
    """Refuse dimensions that contradict each other."""
    for name, value in measures.items():
        if value <= 0.0 and name != "hole_pitch_mm":
            raise ServoError(f"servo {servo}: {name} is {value:g}, expected more than 0")
    measures = measures | {_EARS: measures["ear_bottom_mm"] + measures["ear_thickness_mm"]}
    measures |= {f"2 * {name}": 2 * measures[name] for name in ("long_mm", "short_mm", "screw_radius_mm")}
    disc = kind == "disc"
    for small, large in (*_SMALL_AND_LARGE, *(() if disc else _SMALL_AND_LARGE_OF_A_CROSS)):
        if measures[small] >= measures[large]:
            raise ServoError(
                f"servo {servo}: {small} is {measures[small]:g}, expected less than {large}, {measures[large]:g}"
            )
    for one, other in _EQUAL_OF_A_DISC if disc else ():
        if measures[one] != measures[other]:
            raise ServoError(
                f"servo {servo}: {one} of its disc is {measures[one]:g}, expected {other}, {measures[other]:g}"
            )
