"""Findings about a kit on the bench: its servos' loads, its timeline, contacts, floating, scale and predictions."""

from collections.abc import Sequence
from math import isclose
from typing import Literal

import numpy as np

from tasks.analysis.tank import Tank
from tasks.fabrication.calibration import Calibration
from tasks.fabrication.checks import KitFinding, Severity
from tasks.fabrication.contacts import PassingContact
from tasks.fabrication.floating import Floating
from tasks.fabrication.kit_settings import FabricationSettings
from tasks.fabrication.scaling import CONTINUOUS_SHARE, JointLoad
from tasks.fabrication.servos import Servo
from tasks.fabrication.timeline import Timeline, TimelineError, pulses

_MIN_MARGIN = 1.3  # sagging batteries, cables, wet seals and wear may take a quarter of a data sheet's torque and speed
_SATURATION_NOTE = 0.05  # share of the run at the simulated motor's limit that is worth a note
_SATURATION_WARNING = 0.2  # share above which the simulated torques underestimate the gait's
_BRIEF_CONTACT = 0.001  # share of the run up to which a contact is only a note
_MAX_DEVIATIONS = 2.0  # of the ensemble between its mean and the truth

_Shortfall = Literal["travel", "speed", "torque"]


def check_timeline(timeline: Timeline, calibration: Calibration, settings: FabricationSettings) -> list[KitFinding]:
    """Check that the servos can play a timeline.

    Args:
        timeline: The timeline.
        calibration: Its servos.
        settings: The user's settings, for the advice.

    Returns:
        A fault, or nothing.
    """
    try:
        pulses(timeline, calibration)
    except TimelineError as error:
        advice = _advice(_timeline_shortfalls(timeline, calibration), settings)
        return [KitFinding("timeline", "fault", "servos", f"can't play this gait: {str(error).rstrip('.')}.{advice}")]
    return []


def _timeline_shortfalls(timeline: Timeline, calibration: Calibration) -> list[_Shortfall]:
    columns = [(servo, timeline.joints.index(servo.joint)) for servo in calibration.servos]
    shortfalls: dict[_Shortfall, bool] = {
        "travel": any(np.abs(timeline.angle[:, column]).max() > servo.reach for servo, column in columns),
        "speed": any(np.abs(timeline.speed[:, column]).max() > servo.max_speed for servo, column in columns),
    }
    return [shortfall for shortfall, exists in shortfalls.items() if exists]


def _load_shortfalls(load: JointLoad, servo: Servo) -> list[_Shortfall]:
    """Return which of speed and torque is nearly used up by itself; else both, which the servo's line combines."""
    shares: dict[_Shortfall, float] = {
        "speed": load.peak_speed / servo.no_load_speed_rad_s,
        "torque": load.peak_torque / servo.stall_torque_nm,
    }
    return [shortfall for shortfall, share in shares.items() if share * _MIN_MARGIN > 1] or list(shares)


def _advice(shortfalls: Sequence[_Shortfall], settings: FabricationSettings) -> str:
    """Return a sentence per shortfall, each with a space before it; a choice already made is no advice."""
    slower = "" if settings.scaling.law == "kept_frequencies" else ", or --set scaling.law=kept_frequencies"
    two = "" if settings.kit.servos_per_joint == 2 else ", or --set kit.servos_per_joint=2"
    advice = {
        "travel": " It swings too far: choose a servo with more travel (--set kit.servo=...), or another design.",
        "speed": f" It is too fast: choose a faster servo (--set kit.servo=...){slower}.",
        "torque": f" It needs too much torque: choose a stronger servo (--set kit.servo=...){two}.",
    }
    return "".join(advice[shortfall] for shortfall in shortfalls)


def check_loads(loads: Sequence[JointLoad] | None, servo: Servo, settings: FabricationSettings) -> list[KitFinding]:
    """Check the loads of a simulated run against a servo.

    Args:
        loads: One per driven joint; None if the simulation diverged.
        servo: Servo of every joint.
        settings: The user's settings, for the advice.

    Returns:
        A finding per excess, in order of the joints.
    """
    if loads is None:
        return [KitFinding("torque", "fault", "joints", "loads are unknown because the simulation diverged")]
    findings = []
    for load in loads:
        where, advice = f"joint {load.joint}", _advice(_load_shortfalls(load, servo), settings)
        if load.use > 1:
            message = (
                f"the servo is too weak or too slow: at the worst instant the run needs {load.use:.2f} times what a "
                f"{servo.name} gives (needs up to {load.peak_torque:.2f} N·m and {load.peak_speed:.1f} rad/s; has "
                f"{servo.stall_torque_nm:.2f} N·m at stall, {servo.no_load_speed_rad_s:.1f} rad/s unloaded).{advice}"
            )
            findings.append(KitFinding("torque", "fault", where, message))
        elif load.margin < _MIN_MARGIN:
            message = (
                f"at the worst instant a {servo.name} gives {load.margin:.2f} times what the run needs, expected at "
                f"least {_MIN_MARGIN:g} because real servos give less than their data sheet.{advice}"
            )
            findings.append(KitFinding("margin", "warning", where, message))
        if load.stall_share > CONTINUOUS_SHARE:
            message = (
                f"needs {load.stall_share:.0%} of the stall torque (root mean square); above {CONTINUOUS_SHARE:.0%} a "
                f"hobby servo overheats within minutes"
            )
            findings.append(KitFinding("heat", "warning", where, message))
        at_limit = f"the simulated motor was at its torque limit in {load.saturated:.0%} of the run"
        if load.saturated > _SATURATION_WARNING:
            message = f"{at_limit}: the torques given for this joint are a lower bound"
            findings.append(KitFinding("saturation", "warning", where, message))
        elif load.saturated > _SATURATION_NOTE:
            message = f"{at_limit}: a stronger servo moves differently there"
            findings.append(KitFinding("saturation", "note", where, message))
    return findings


def check_contacts(contacts: Sequence[PassingContact]) -> list[KitFinding]:
    """Report contacts of the simulated run that the bench does not have."""
    findings = []
    for contact in contacts:
        (first, second), parts = contact.links, " and ".join(f"part {part + 1}" for part in contact.parts)
        where = ("joint " if len(contact.joints) == 1 else "joints ") + " and ".join(map(str, contact.joints))
        severity: Severity = "warning" if contact.share > _BRIEF_CONTACT else "note"
        message = (
            f"links {first} and {second} touch in {contact.share:.1%} of the simulated run, first after "
            f"{contact.first:.1f} s. On the bench {parts} lie in different layers and pass each other, so the robot "
            f"moves differently there"
        )
        findings.append(KitFinding("passes on the bench", severity, where, message))
    return findings


def check_floating(floating: Floating, tank_mm: float) -> list[KitFinding]:
    """Check that the kit floats in a tank of a depth [mm]."""
    findings = []
    if floating.draught_mm is not None and floating.draught_mm > tank_mm:
        message = f"stands on the floor of a {tank_mm:.0f} mm deep tank: its draught is {floating.draught_mm:.0f} mm"
        findings.append(KitFinding("floating", "warning", "robot", message))
    if floating.sealed_share > 1:
        message = f"sinks: it weighs {floating.sealed_share:.2f} times the fluid that it displaces"
        findings.append(KitFinding("floating", "warning", "robot", message))
    elif floating.flooded_share > 1:
        message = (
            f"floats while its pockets are dry, but sinks once they are full: it then weighs "
            f"{floating.flooded_share:.2f} times the displaced fluid. Seal the pockets"
        )
        findings.append(KitFinding("floating", "warning", "robot", message))
    return findings


def check_scale(tank: Tank | None, scale_mm_per_m: float) -> list[KitFinding]:
    """Check that the kit has the scale of the virtual tank, if there is one."""
    if tank is None or isclose(1000 * tank.scale, scale_mm_per_m):
        return []
    expected = f"{1000 * tank.scale:g}"
    message = (
        f"the kit has {scale_mm_per_m:g} mm per metre of simulation, the tank of its settings {expected} mm. Results "
        f"from that tank do not apply to this kit; to match it, --set kit.scale_mm_per_m={expected}"
    )
    return [KitFinding("scale", "warning", "robot", message)]


def check_predictions(displacements: Sequence[float] | None, true_slush: float | None) -> list[KitFinding]:
    """Check the (n_members) displacements [m of simulation] that an ensemble predicts, also against True Slush's."""
    if displacements is None:
        return []
    mean, deviation = float(np.mean(displacements)), float(np.std(displacements))
    predicted, findings = f"{mean:+.2f} ± {deviation:.2f} m of simulation", []
    if deviation > abs(mean):
        message = f"the study's networks disagree on its displacement: {predicted}"
        findings.append(KitFinding("ensemble", "warning", "robot", message))
    if true_slush is not None and abs(mean - true_slush) > _MAX_DEVIATIONS * deviation:
        message = (
            f"the study's networks predict {predicted}, but True Slush gives {true_slush:+.2f} m, more than "
            f"{_MAX_DEVIATIONS:g} σ away"
        )
        findings.append(KitFinding("ensemble", "warning", "robot", message))
    return findings
