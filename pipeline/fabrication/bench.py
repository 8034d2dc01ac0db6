"""The kit on the bench: what its servos must give, whether it floats, how they are told to move, and what is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isclose, pi, radians
from typing import Literal

import numpy as np
import numpy.typing as npt

from pipeline.fabrication.choices import FabricationSettings
from tasks.analysis.tank import Tank
from tasks.design import Designs
from tasks.fabrication.calibration import Calibration, ServoCalibration
from tasks.fabrication.checks import KitFinding, Severity
from tasks.fabrication.contacts import Contact, passing_contacts
from tasks.fabrication.floating import Floating, floating_of
from tasks.fabrication.kit import Kit
from tasks.fabrication.scaling import HOT, JointLoad, Scales, joint_loads, scales_of
from tasks.fabrication.servo_joints import servo_of
from tasks.fabrication.servos import Servo
from tasks.fabrication.timeline import Timeline, TimelineError, pulses, timeline_of
from tasks.simulation import OK, Rollouts, simulate
from tasks.simulation.box2d import Column
from tasks.world import Environment, Physics

SPARE = radians(5.0)
"""Beyond a joint's range that its servo may still be sent."""

OFTEN = 0.05
"""Share of the run in which the simulated motors may be at their limit before it is said."""

BRIEF = 0.001
"""Share of the run up to which links may touch that pass one another on the bench, and it be no more than a note."""

LOWER_BOUND = 0.2
"""Share of the run at the limit above which the torques are taken for less than the gait needs."""

ENOUGH = 1.3
"""Least margin that is not remarked on. A data sheet's torque and speed are a new servo's at its full voltage;
a battery that sags, a cable, water at the seals and wear may well take a quarter."""

FAR = 2.0
"""Deviations σ of the ensemble that its mean may be off the truth before it is said."""


Cause = Literal["travel", "speed", "torque"]
"""What a servo may have too little of."""


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """The run that the kit's physics is drawn from."""

    world: str
    """Where, in words."""
    displacement: float
    """Of the root [m of simulation]."""
    com_displacement: float
    """Of the whole robot [m of simulation]."""
    duration: float
    """That it took [s of simulation]."""
    torque: npt.NDArray[np.float64]
    """(n_steps, n_joints) given by the simulated motors [N·m of simulation], once the robot has settled: until
    then they jump to their gait, which the bench's timeline does not."""
    speed: npt.NDArray[np.float64]
    """(n_steps, n_joints) [rad/s of simulation]."""
    pose: npt.NDArray[np.floating]
    """(n_steps, n_links, 3) x and y of the links' centres [m of simulation] and their angles [rad]."""


@dataclass(frozen=True)
class MemberPredictions:
    """The same design under every member of a study's ensemble."""

    displacement: tuple[float, ...]
    """Of the root [m of simulation]."""

    @property
    def mean(self) -> float:
        """μ [m of simulation]."""
        return float(np.mean(self.displacement))

    @property
    def deviation(self) -> float:
        """σ, what the members disagree by [m of simulation]."""
        return float(np.std(self.displacement))


@dataclass(frozen=True, eq=False)
class Bench:
    """All that is known of a kit beside its parts."""

    scales: Scales
    servo: Servo
    servos_per_joint: int
    simulated: SimulatedRun | None
    """None where the rollout diverged."""
    loads: tuple[JointLoad, ...]
    floating: Floating
    members: MemberPredictions | None
    calibration: Calibration | None
    """None where no joint is driven."""
    timeline: Timeline | None
    """None where the servos can't play it; a finding says why."""
    findings: tuple[KitFinding, ...]


def run(
    design: Designs, world: Environment, *, label: str, physics: Physics, n_settle: int, n_measure: int
) -> SimulatedRun | None:
    """Simulate a design with the reference engine, which alone says what its motors gave."""
    rollouts: Rollouts = simulate(
        design, world, n_settle=n_settle, n_measure=n_measure, engine="reference", trace=True, physics=physics
    )
    if rollouts.status[0] != OK or rollouts.trace is None or rollouts.motor_torque is None:
        return None
    joints = driven(design)
    parent = [int(design.parent[0, joint]) for joint in joints]
    trace = rollouts.trace[0].astype(np.float64)
    return SimulatedRun(
        world=label,
        displacement=float(rollouts.displacement[0]),
        com_displacement=float(rollouts.com_displacement[0]),
        duration=n_measure * physics.time_step,
        torque=rollouts.motor_torque[0][n_settle:, list(joints)].astype(np.float64),
        speed=trace[n_settle:, list(joints), Column.OMEGA] - trace[n_settle:, parent, Column.OMEGA],
        pose=trace[n_settle:, :, [Column.X, Column.Y, Column.ANGLE]],
    )


def driven(design: Designs) -> tuple[int, ...]:
    """List a design's driven joints."""
    return tuple(int(joint) for joint in np.flatnonzero(design.motor_on[0]) if joint > 0)


def bench_of(
    design: Designs,
    kit: Kit,
    settings: FabricationSettings,
    simulated: SimulatedRun | None,
    members: MemberPredictions | None,
    physics: Physics,
    *,
    tank: Tank | None,
    depth: float,
    true_slush: float | None = None,
) -> Bench:
    """Work out how a kit will do.

    Args:
        design: one design.
        kit: made of it.
        settings: the kit's.
        simulated: its run, None where it diverged.
        members: what the study's ensemble says of it.
        physics: of the run.
        tank: that champions were tried in, if any.
        depth: of the slush in the run [m of simulation]; without a tank the robot floats in as much, at its scale.
        true_slush: displacement of the root in True Slush under the study's own physics [m of simulation], if known.
    """
    servo = servo_of(settings.kit)
    simulated_mass = physics.link_density * design.parent.shape[1]  # a link has 1 m²
    scales = scales_of(
        settings.scaling,
        length=settings.kit.scale_mm_per_m / 1000,
        mass_kg=kit.mass_g / 1000,
        simulated_mass_kg=simulated_mass,
    )
    loads: list[JointLoad] = []
    if simulated is not None:
        loads = joint_loads(
            driven(design),
            simulated.torque,
            simulated.speed,
            scales=scales,
            servo=servo,
            servos_per_joint=settings.kit.servos_per_joint,
            max_motor_torque=physics.max_motor_torque,
            commanded_speed=tuple(
                2 * pi * float(design.frequency[0]) * float(design.motion_range[0, joint]) for joint in driven(design)
            ),
        )
    floating = floating_of(kit, fluid_density=settings.scaling.fluid_density)
    calibration = calibration_of(kit, servo)
    timeline: Timeline | None = None
    refused: list[KitFinding] = []
    if calibration is not None:
        timeline = timeline_of(design, settings.playback, time_scale=scales.time)
        if refused := _of_timeline(timeline, calibration, settings):
            timeline = None
    tank_mm = depth * settings.kit.scale_mm_per_m if tank is None else 1000 * tank.depth
    contacts: list[Contact] = []
    if simulated is not None:
        contacts = passing_contacts(design, kit.mechanism, kit.layers, simulated.pose, time_step=physics.time_step)
    found = [
        *refused,
        *_of_loads(loads, servo, simulated, settings),
        *_of_contacts(contacts),
        *_of_floating(floating, tank_mm),
        *_of_scale(tank, settings.kit.scale_mm_per_m),
        *_of_members(members, true_slush),
    ]
    return Bench(
        scales,
        servo,
        settings.kit.servos_per_joint,
        simulated,
        tuple(loads),
        floating,
        members,
        calibration,
        timeline,
        tuple(found),
    )


def _of_timeline(timeline: Timeline, calibration: Calibration, settings: FabricationSettings) -> list[KitFinding]:
    try:
        pulses(timeline, calibration)
    except TimelineError as error:
        return [
            KitFinding(
                "timeline",
                "fault",
                "servos",
                f"they can't play this gait: {str(error).rstrip('.')}."
                f"{_remedies(_too_much(timeline, calibration), settings)}",
            )
        ]
    return []


def _too_much(timeline: Timeline, calibration: Calibration) -> list[Cause]:
    """Say what of a timeline is past its servos."""
    far = fast = False
    for servo in calibration.servos:
        column = timeline.joints.index(servo.joint)
        reach = min(servo.max_us - servo.centre_us, servo.centre_us - servo.min_us) / servo.us_per_rad
        far |= bool(np.abs(timeline.angle[:, column]).max() > reach)
        fast |= bool(np.abs(timeline.speed[:, column]).max() > servo.max_speed)
    causes: list[tuple[bool, Cause]] = [(far, "travel"), (fast, "speed")]
    return [cause for there, cause in causes if there]


def _remedies(causes: Sequence[Cause], settings: FabricationSettings) -> str:
    """Say what helps, for each thing that a servo falls short of; a sentence each, with a space before it."""
    slower = "" if settings.scaling.law == "kept_frequencies" else ", or --set scaling.law=kept_frequencies"
    two = "" if settings.kit.servos_per_joint == 2 else ", or --set kit.servos_per_joint=2"
    remedies = {
        "travel": " It swings too far: choose a servo that turns farther (--set kit.servo=...), or another design.",
        "speed": f" It is too fast: choose a faster servo (--set kit.servo=...){slower}.",
        "torque": f" It is too hard: choose a stronger servo (--set kit.servo=...){two}.",
    }
    return "".join(remedies[cause] for cause in causes)


def calibration_of(kit: Kit, servo: Servo) -> Calibration | None:
    """Give what a servo of the data sheet, mounted as in the kit, would need: a first guess."""
    servos: list[ServoCalibration] = []
    for servo_joint in kit.servo_joints:
        reach = servo.us_per_rad * (servo_joint.joint.motion_range + SPARE)
        for side in servo_joint.sides(kit.settings.servos_per_joint):
            servos.append(
                ServoCalibration(
                    joint=servo_joint.joint.link,
                    channel=len(servos),
                    centre_us=servo.neutral_us,
                    direction=kit.direction(servo_joint.joint.link, side),
                    us_per_rad=round(servo.us_per_rad, 3),
                    min_us=round(max(servo.min_pulse_us, servo.neutral_us - reach), 1),
                    max_us=round(min(servo.max_pulse_us, servo.neutral_us + reach), 1),
                    max_speed=round(servo.no_load_speed_rad_s, 3),
                )
            )
    return Calibration(servos=tuple(servos)) if servos else None


def _of_loads(
    loads: Sequence[JointLoad], servo: Servo, simulated: SimulatedRun | None, settings: FabricationSettings
) -> list[KitFinding]:
    if simulated is None:
        return [KitFinding("torque", "fault", "joints", "the simulation diverged: what the joints need is not known")]
    found: list[KitFinding] = []
    for load in loads:
        where = f"joint {load.joint}"
        if load.use > 1:
            found.append(
                KitFinding(
                    "torque",
                    "fault",
                    where,
                    f"the servo can't do it: at the worst instant the run asks for {load.use:.2f} times what a "
                    f"{servo.name} can give (up to {load.peak_torque:.2f} N·m, up to {load.peak_speed:.1f} rad/s; it has "
                    f"{servo.stall_torque_nm:.2f} N·m at rest, {servo.no_load_speed_rad_s:.1f} rad/s unloaded)."
                    f"{_remedies(_short_of(load, servo), settings)}",
                )
            )
        elif load.margin < ENOUGH:
            found.append(
                KitFinding(
                    "margin",
                    "warning",
                    where,
                    f"at the worst instant a {servo.name} has {load.margin:.2f} times what the run asks for, expected "
                    f"{ENOUGH:g} or more: a real one gives less than its data sheet says."
                    f"{_remedies(_short_of(load, servo), settings)}",
                )
            )
        if load.stall_share > HOT:
            found.append(
                KitFinding(
                    "heat",
                    "warning",
                    where,
                    f"it asks for {load.stall_share:.0%} of the stall torque (root mean square over the run); above "
                    f"{HOT:.0%} a hobby servo overheats within minutes",
                )
            )
        if load.saturated > LOWER_BOUND:
            found.append(
                KitFinding(
                    "saturation",
                    "warning",
                    where,
                    f"the simulated motor was at its own limit in {load.saturated:.0%} of the run, and gave less than was "
                    f"asked: what is said of this joint's torque is a lower bound",
                )
            )
        elif load.saturated > OFTEN:
            found.append(
                KitFinding(
                    "saturation",
                    "note",
                    where,
                    f"the simulated motor was at its own limit in {load.saturated:.0%} of the run: a stronger servo moves "
                    f"otherwise there",
                )
            )
    return found


def _short_of(load: JointLoad, servo: Servo) -> list[Cause]:
    """Say what of a servo is nearly used up: speed or torque, each by itself; else both, which its line ties."""
    shares: list[tuple[float, Cause]] = [
        (load.peak_speed / servo.no_load_speed_rad_s, "speed"),
        (load.peak_torque / servo.stall_torque_nm, "torque"),
    ]
    return [cause for share, cause in shares if share * ENOUGH > 1] or ["speed", "torque"]


def _of_contacts(contacts: Sequence[Contact]) -> list[KitFinding]:
    found = []
    for contact in contacts:
        (first, second), parts = contact.links, " and ".join(f"part {part + 1}" for part in contact.parts)
        where = ("joint " if len(contact.joints) == 1 else "joints ") + " and ".join(map(str, contact.joints))
        severity: Severity = "warning" if contact.share > BRIEF else "note"
        found.append(
            KitFinding(
                "passes on the bench",
                severity,
                where,
                f"links {first} and {second} push one another in {contact.share:.1%} of the simulated run, first after "
                f"{contact.first:.1f} s of it; on the bench {parts} lie in different layers and pass one another, so that "
                f"the robot moves otherwise there",
            )
        )
    return found


def _of_members(members: MemberPredictions | None, true_slush: float | None) -> list[KitFinding]:
    if members is None:
        return []
    mean, deviation = members.mean, members.deviation
    found = []
    if deviation > abs(mean):
        found.append(
            KitFinding(
                "ensemble",
                "warning",
                "robot",
                f"the study's networks do not agree on how far it gets: {mean:+.2f} ± {deviation:.2f} m of simulation",
            )
        )
    if true_slush is not None and abs(mean - true_slush) > FAR * deviation:
        found.append(
            KitFinding(
                "ensemble",
                "warning",
                "robot",
                f"the study's networks promise {mean:+.2f} ± "
                f"{deviation:.2f} m of simulation, and True Slush gives {true_slush:+.2f} m: more than "
                f"{FAR:g} σ off",
            )
        )
    return found


def _of_floating(floating: Floating, tank_mm: float) -> list[KitFinding]:
    if floating.stands_in(tank_mm):
        return [
            KitFinding(
                "floating",
                "warning",
                "robot",
                f"it stands on the floor of a tank of {tank_mm:.0f} mm: its draught is {floating.draught_mm:.0f} mm",
            ),
            *_of_pockets(floating),
        ]
    return _of_pockets(floating)


def _of_scale(tank: Tank | None, scale_mm_per_m: float) -> list[KitFinding]:
    if tank is None or isclose(1000 * tank.scale, scale_mm_per_m):
        return []
    return [
        KitFinding(
            "scale",
            "warning",
            "robot",
            f"the kit has {scale_mm_per_m:g} mm for a metre of simulation, the "
            f"tank of the settings that it is simulated under {1000 * tank.scale:g}: what was said of it in "
            f"that tank is of a robot of another size (--set kit.scale_mm_per_m={1000 * tank.scale:g})",
        )
    ]


def _of_pockets(floating: Floating) -> list[KitFinding]:
    if floating.sealed_share > 1:
        return [
            KitFinding(
                "floating",
                "warning",
                "robot",
                "it sinks: it weighs more than the fluid that it displaces, "
                f"{floating.sealed_share:.2f} times; the simulated one floats",
            )
        ]
    if floating.flooded_share > 1:
        return [
            KitFinding(
                "floating",
                "warning",
                "robot",
                "it floats while its pockets are dry and sinks once they are "
                f"full (then {floating.flooded_share:.2f} of what it displaces): seal them",
            )
        ]
    return []
