"""Servos: what can be bought to drive a joint, as data with their sources.

Millimetres, as everywhere in fabrication; torques and speeds are SI, at the voltage that stands beside them, straight
from the source's kg·cm and s/60°. A hobby servo's torque falls linearly from stall to no-load speed. Horns come in many
shapes and clones of a servo differ by some tenths of a millimetre: measure yours before you print.

The frame of a servo: u along the body's long side, v along its short side, w along the shaft towards the horn. The
origin is on the shaft at the top of the case. The body reaches from u = -shaft_offset to u = length - shaft_offset.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians
from typing import Literal

KG_CM = 9.80665 * 0.01
"""One kilogram-force centimetre [N·m]."""

Sense = Literal[1, -1]
HornKind = Literal["disc", "cross"]


class ServoError(ValueError):
    """A servo that the library does not hold: names it and lists those that it does."""


@dataclass(frozen=True)
class Horn:
    """What sits on the spline and is screwed to the driven part."""

    kind: HornKind
    reach_mm: tuple[float, float]
    """From the shaft to the tips of the arms along u and along v; of a disc, its radius twice."""
    arm_width_mm: float
    """Of a cross's arms; of a disc, its diameter."""
    hub_mm: float
    """Diameter of the hub around the spline."""
    top_mm: float
    """From the top of the case to the face that the driven part is screwed to."""
    thickness_mm: float
    """Of the disc or the arms."""
    screw_radius_mm: float
    """From the shaft to each of the four screws that hold the driven part."""
    screw_mm: float
    """Diameter of those screws."""
    screw_name: str


@dataclass(frozen=True)
class Servo:
    """One model of servo."""

    name: str
    source: str
    voltage_v: float
    """At which torque and speed hold."""
    stall_torque_nm: float
    """[N·m]"""
    no_load_speed_rad_s: float
    """[rad/s]"""
    mass_g: float
    min_pulse_us: float
    """Shortest pulse of its range."""
    max_pulse_us: float
    """Longest pulse of its range."""
    travel_rad: float
    """Turned between the shortest and the longest pulse."""
    deadband_us: float
    """A change of the pulse below this moves nothing."""
    sense: Sense
    """1 if longer pulses turn the horn counter-clockwise, seen from above the horn."""
    length_mm: float
    width_mm: float
    height_mm: float
    """From the bottom to the top of the case, any tower around the shaft included."""
    shaft_offset_mm: float
    """From the body's near end to the shaft."""
    ear_length_mm: float
    """Over both ears."""
    ear_bottom_mm: float
    """From the bottom of the case to the underside of the ears."""
    ear_thickness_mm: float
    hole_span_mm: float
    """Between the holes of the two ears, along u."""
    hole_pitch_mm: float
    """Between the two holes of one ear, along v; 0 if it has one hole."""
    ear_screw_mm: float
    """Diameter of the screws through the ears."""
    ear_screw_name: str
    spline_mm: float
    """Outer diameter of the spline."""
    spline_teeth: int
    centre_screw_mm: float
    """Diameter of the screw that holds the horn on the spline."""
    centre_screw_name: str
    cable_width_mm: float
    """Of the flat cable; it leaves at one end of the body, near the bottom. Clones differ in which end."""
    horns: tuple[Horn, ...]
    """Those that come with it, the one to prefer first."""

    @property
    def us_per_rad(self) -> float:
        """Change of the pulse for a turn of one radian [µs/rad]."""
        return (self.max_pulse_us - self.min_pulse_us) / self.travel_rad

    @property
    def neutral_us(self) -> float:
        """The middle of its range [µs]."""
        return (self.min_pulse_us + self.max_pulse_us) / 2

    def torque_at(self, speed_rad_s: float) -> float:
        """Give the most torque at a speed [N·m], on the straight line from stall to no load; 0 beyond it."""
        return self.stall_torque_nm * max(0.0, 1.0 - abs(speed_rad_s) / self.no_load_speed_rad_s)

    def horn(self, kind: HornKind) -> Horn:
        """Give its horn of a kind.

        Raises:
            ServoError: it comes without one; names those that it has.
        """
        for horn in self.horns:
            if horn.kind == kind:
                return horn
        raise ServoError(f"servo {self.name}: has no {kind} horn, expected {' or '.join(h.kind for h in self.horns)}")


def _per_60_degrees(seconds: float) -> float:
    """Turn a data sheet's s/60° into rad/s."""
    return radians(60.0) / seconds


_STANDARD_DISC = Horn("disc", (10.0, 10.0), 20.0, 9.0, 7.5, 2.5, 7.0, 3.0, "M3")
_STANDARD_CROSS = Horn("cross", (18.0, 14.0), 7.0, 10.0, 6.5, 2.0, 11.0, 2.0, "2 mm self-tapping")
_MICRO_DISC = Horn("disc", (8.0, 8.0), 16.0, 7.0, 5.5, 2.0, 5.5, 2.0, "M2")
_MICRO_CROSS = Horn("cross", (16.0, 8.5), 4.5, 7.0, 5.0, 1.6, 6.5, 1.5, "1.5 mm self-tapping")

SERVOS: dict[str, Servo] = {
    servo.name: servo
    for servo in (
        Servo(
            name="ds3225",
            source="DSServo DS3225MG data sheet (5 V column); case as the 40.5 × 20 × 38 mm standard size",
            voltage_v=5.0,
            stall_torque_nm=21.0 * KG_CM,
            no_load_speed_rad_s=_per_60_degrees(0.15),
            mass_g=60.0,
            min_pulse_us=500.0,
            max_pulse_us=2500.0,
            travel_rad=radians(270.0),
            deadband_us=3.0,
            sense=1,
            length_mm=40.5,
            width_mm=20.0,
            height_mm=38.0,
            shaft_offset_mm=10.2,
            ear_length_mm=54.5,
            ear_bottom_mm=28.0,
            ear_thickness_mm=2.5,
            hole_span_mm=49.5,
            hole_pitch_mm=10.0,
            ear_screw_mm=3.0,
            ear_screw_name="M3 self-tapping",
            spline_mm=5.9,
            spline_teeth=25,
            centre_screw_mm=3.0,
            centre_screw_name="M3 × 8",
            cable_width_mm=4.0,
            horns=(_STANDARD_DISC, _STANDARD_CROSS),
        ),
        Servo(
            name="hs85mg",
            source="Hitec HS-85MG, manufacturer's page (6 V column)",
            voltage_v=6.0,
            stall_torque_nm=3.5 * KG_CM,
            no_load_speed_rad_s=_per_60_degrees(0.14),
            mass_g=21.9,
            min_pulse_us=900.0,
            max_pulse_us=2100.0,
            travel_rad=radians(120.0),
            deadband_us=8.0,
            sense=-1,
            length_mm=29.1,
            width_mm=13.0,
            height_mm=29.9,
            shaft_offset_mm=6.55,
            ear_length_mm=40.0,
            ear_bottom_mm=18.5,
            ear_thickness_mm=2.0,
            hole_span_mm=35.6,
            hole_pitch_mm=0.0,
            ear_screw_mm=2.0,
            ear_screw_name="2 mm self-tapping",
            spline_mm=4.8,
            spline_teeth=24,
            centre_screw_mm=2.0,
            centre_screw_name="M2 × 6",
            cable_width_mm=4.0,
            horns=(_MICRO_CROSS, _MICRO_DISC),
        ),
        Servo(
            name="mg90s",
            source="Tower Pro MG90S data sheet (6 V column); case from common drawings",
            voltage_v=6.0,
            stall_torque_nm=2.2 * KG_CM,
            no_load_speed_rad_s=_per_60_degrees(0.08),
            mass_g=13.4,
            min_pulse_us=500.0,
            max_pulse_us=2500.0,
            travel_rad=pi,
            deadband_us=5.0,
            sense=1,
            length_mm=22.8,
            width_mm=12.4,
            height_mm=28.4,
            shaft_offset_mm=6.2,
            ear_length_mm=32.3,
            ear_bottom_mm=18.5,
            ear_thickness_mm=2.8,
            hole_span_mm=27.8,
            hole_pitch_mm=0.0,
            ear_screw_mm=2.0,
            ear_screw_name="2 mm self-tapping",
            spline_mm=4.8,
            spline_teeth=20,
            centre_screw_mm=2.0,
            centre_screw_name="M2 × 6",
            cable_width_mm=4.0,
            horns=(_MICRO_CROSS, _MICRO_DISC),
        ),
    )
}
"""The library, by name."""


def servo_named(name: str) -> Servo:
    """Find a servo in the library.

    Raises:
        ServoError: there is none of that name; lists the names.
    """
    if name not in SERVOS:
        raise ServoError(f"servo {name!r} is unknown, expected one of {', '.join(sorted(SERVOS))}")
    return SERVOS[name]
