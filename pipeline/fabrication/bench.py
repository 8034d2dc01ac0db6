"""The kit on the bench: the loads of its servos, its floating, its timeline, and what speaks against building it."""

from dataclasses import dataclass
from math import pi, radians

import numpy as np

from pipeline.fabrication.bench_checks import (
    check_contacts,
    check_floating,
    check_loads,
    check_predictions,
    check_scale,
    check_timeline,
)
from pipeline.fabrication.choices import FabricationSettings
from tasks.analysis.tank import Tank
from tasks.arrays import Float64
from tasks.design import Designs
from tasks.fabrication.calibration import Calibration, ServoCalibration
from tasks.fabrication.checks import KitFinding
from tasks.fabrication.contacts import PassingContact, passing_contacts
from tasks.fabrication.floating import Floating, floating_of
from tasks.fabrication.kit import Kit
from tasks.fabrication.scaling import JointLoad, Scales, joint_loads, scales_of
from tasks.fabrication.servo_joints import servo_of
from tasks.fabrication.servos import Servo
from tasks.fabrication.timeline import Timeline, timeline_of
from tasks.simulation import OK, Rollouts, simulate
from tasks.simulation.box2d import Column
from tasks.world import Environment, Physics

_SPARE_RANGE = radians(5.0)  # beyond a joint's range that a calibration allows


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """The simulated run from which the loads are taken."""

    environment: str  # the environment, in words
    displacement: float  # displacement of the root [m of simulation]
    com_displacement: float  # displacement of the centre of mass [m of simulation]
    duration: float  # duration of the measurement [s of simulation]
    torque: Float64
    """(n_steps, n_joints) torques of the motors [N·m of simulation], after settling: before, the motors jump to the
    gait, which a timeline does not."""
    speed: Float64  # (n_steps, n_joints) speeds of the joints [rad/s of simulation]
    pose: Float64  # (n_steps, n_links, 3) x, y [m of simulation] and angle [rad] of the links


@dataclass(frozen=True, eq=False)
class Bench:
    """Everything about a kit beside its parts."""

    scales: Scales
    servo: Servo
    servos_per_joint: int
    simulated: SimulatedRun | None  # none if the simulation diverged
    loads: tuple[JointLoad, ...]
    floating: Floating
    predicted: tuple[float, ...] | None
    """(n_members) displacements of the root that the study's ensemble predicts [m of simulation]."""
    calibration: Calibration | None  # none if no joint has a servo
    timeline: Timeline | None  # none if the servos can't play it; the findings say why
    findings: tuple[KitFinding, ...]


def run(
    design: Designs, environment: Environment, *, label: str, physics: Physics, n_settle: int, n_measure: int
) -> SimulatedRun | None:
    """Simulate a design on the reference engine, the only one that reports motor torques.

    Args:
        design: One design.
        environment: The environment.
        label: The environment, in words.
        physics: Physics of the simulation.
        n_settle: Steps before the measurement.
        n_measure: Steps of the measurement.

    Returns:
        The run; None if it diverged.
    """
    rollouts: Rollouts = simulate(
        design, environment, n_settle=n_settle, n_measure=n_measure, engine="reference", trace=True, physics=physics
    )
    if rollouts.status[0] != OK or rollouts.trace is None or rollouts.motor_torque is None:
        return None
    joints = driven(design)
    parent = [int(design.parent[0, joint]) for joint in joints]
    trace = rollouts.trace[0].astype(np.float64)
    return SimulatedRun(
        environment=label,
        displacement=float(rollouts.displacement[0]),
        com_displacement=float(rollouts.com_displacement[0]),
        duration=n_measure * physics.time_step,
        torque=rollouts.motor_torque[0][n_settle:, list(joints)].astype(np.float64),
        speed=trace[n_settle:, list(joints), Column.OMEGA] - trace[n_settle:, parent, Column.OMEGA],
        pose=trace[n_settle:, :, [Column.X, Column.Y, Column.ANGLE]],
    )


def driven(design: Designs) -> tuple[int, ...]:
    """List the driven joints of one design."""
    return tuple(int(joint) for joint in np.flatnonzero(design.motor_on[0]) if joint > 0)


def bench_of(
    design: Designs,
    kit: Kit,
    settings: FabricationSettings,
    simulated: SimulatedRun | None,
    predicted: tuple[float, ...] | None,
    physics: Physics,
    *,
    tank: Tank | None,
    depth: float,
    true_slush: float | None = None,
) -> Bench:
    """Compute loads, floating and timeline of a kit and check them.

    Args:
        design: One design.
        kit: Its kit.
        settings: The kit's settings.
        simulated: Its simulated run; None if it diverged.
        predicted: (n_members) displacements that the study's ensemble predicts [m of simulation], if there is one.
        physics: Physics of the run.
        tank: The study's virtual tank, if it has one.
        depth: Depth of the slush in the run [m of simulation]; without a tank the kit floats in it, at its scale.
        true_slush: Displacement of the root in the study's True Slush [m of simulation], if known.

    Returns:
        Loads, floating, timeline and findings.
    """
    servo, joints = servo_of(settings.kit), driven(design)
    scales = scales_of(
        settings.scaling,
        length=settings.kit.scale_mm_per_m / 1000,
        mass_kg=kit.mass_g / 1000,
        simulated_mass_kg=physics.link_density * design.parent.shape[1],  # a link has 1 m²
    )
    loads: list[JointLoad] = []
    contacts: list[PassingContact] = []
    if simulated is not None:
        amplitudes = [float(design.motion_range[0, joint]) for joint in joints]
        loads = joint_loads(
            joints,
            simulated.torque,
            simulated.speed,
            scales=scales,
            servo=servo,
            servos_per_joint=settings.kit.servos_per_joint,
            max_motor_torque=physics.max_motor_torque,
            commanded_speed=tuple(2 * pi * float(design.frequency[0]) * amplitude for amplitude in amplitudes),
        )
        contacts = passing_contacts(design, kit.mechanism, kit.layers, simulated.pose, time_step=physics.time_step)
    floating = floating_of(kit, fluid_density=settings.scaling.fluid_density)
    calibration = calibration_of(kit, servo)
    timeline: Timeline | None = None
    refused: list[KitFinding] = []
    if calibration is not None:
        timeline = timeline_of(design, settings.playback, time_scale=scales.time)
        if refused := check_timeline(timeline, calibration, settings):
            timeline = None
    findings = [
        *refused,
        *check_loads(loads if simulated is not None else None, servo, settings),
        *check_contacts(contacts),
        *check_floating(floating, depth * settings.kit.scale_mm_per_m if tank is None else 1000 * tank.depth),
        *check_scale(tank, settings.kit.scale_mm_per_m),
        *check_predictions(predicted, true_slush),
    ]
    return Bench(
        scales=scales,
        servo=servo,
        servos_per_joint=settings.kit.servos_per_joint,
        simulated=simulated,
        loads=tuple(loads),
        floating=floating,
        predicted=predicted,
        calibration=calibration,
        timeline=timeline,
        findings=tuple(findings),
    )


def calibration_of(kit: Kit, servo: Servo) -> Calibration | None:
    """Return the calibration of servos that match the data sheet: a first guess. None if no joint has a servo."""
    servos: list[ServoCalibration] = []
    for servo_joint in kit.servo_joints:
        reach = servo.us_per_rad * (servo_joint.joint.motion_range + _SPARE_RANGE)
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
