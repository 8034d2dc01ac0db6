"""The kit on the bench: the loads of its servos, its floating, its timeline, and what speaks against building it."""

from dataclasses import dataclass
from math import pi, radians

import numpy as np

from pipeline.fabrication import bench_checks
from pipeline.fabrication.source import DesignSource
from pipeline.stages import environments
from tasks.arrays import Float64
from tasks.fabrication.calibration import Calibration, ServoCalibration
from tasks.fabrication.checks import KitFinding
from tasks.fabrication.contacts import PassingContact, passing_contacts
from tasks.fabrication.floating import Floating, floating_of
from tasks.fabrication.kit import Kit
from tasks.fabrication.kit_settings import FabricationSettings
from tasks.fabrication.scaling import JointLoad, Scales, joint_loads, scales_of
from tasks.fabrication.servos import Servo
from tasks.fabrication.timeline import Timeline, driven_joints, timeline_of
from tasks.simulation import OK, simulate
from tasks.simulation.box2d import Column
from tasks.world import Physics

_SPARE_RANGE = radians(5.0)  # beyond a joint's range that a calibration allows


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """The simulated run from which the loads are taken."""

    environment: str  # the environment, in words
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
    calibration: Calibration | None  # none if no joint has a servo
    timeline: Timeline | None  # none if the servos can't play it; the findings say why
    findings: tuple[KitFinding, ...]


def bench_of(source: DesignSource, kit: Kit, choices: FabricationSettings, physics: Physics) -> Bench:
    """Simulate a design, compute loads, floating and timeline of its kit, and check them.

    Args:
        source: The design, its settings and what its study knows of it.
        kit: Its kit.
        choices: The kit's settings.
        physics: Physics of the simulated run.

    Returns:
        Loads, floating, timeline and findings.
    """
    design, settings, servo = source.design, choices.kit, kit.servo
    scales = scales_of(
        choices.scaling,
        length=settings.scale_mm_per_m / 1000,
        mass_kg=kit.mass_g / 1000,
        simulated_mass_kg=physics.link_density * design.parent.shape[1],  # a link has 1 m²
    )
    simulated = _simulated(source, physics)
    loads: list[JointLoad] = []
    contacts: list[PassingContact] = []
    if simulated is not None:
        joints = driven_joints(design)
        loads = joint_loads(
            joints,
            simulated.torque,
            simulated.speed,
            scales=scales,
            servo=servo,
            servos_per_joint=settings.servos_per_joint,
            max_motor_torque=physics.max_motor_torque,
            commanded_speed=2 * pi * design.frequency[0] * design.motion_range[0, list(joints)],
        )
        contacts = passing_contacts(design, kit.mechanism, kit.layers, simulated.pose, time_step=physics.time_step)
    floating = floating_of(kit, fluid_density=choices.scaling.fluid_density)
    calibration = _calibration_of(kit)
    timeline: Timeline | None = None
    refused: list[KitFinding] = []
    if calibration is not None:
        timeline = timeline_of(design, choices.playback, time_scale=scales.time)
        if refused := bench_checks.check_timeline(timeline, calibration, choices):
            timeline = None
    tank = source.settings.tank  # without one the kit floats in slush of the simulated depth, at its scale
    depth_mm = source.depth * settings.scale_mm_per_m if tank is None else 1000 * tank.depth
    findings = (
        *refused,
        *bench_checks.check_loads(loads if simulated is not None else None, servo, choices),
        *bench_checks.check_contacts(contacts),
        *bench_checks.check_floating(floating, depth_mm),
        *bench_checks.check_scale(tank, settings.scale_mm_per_m),
        *bench_checks.check_predictions(source.predicted, source.true_slush),
    )
    return Bench(
        scales=scales,
        servo=servo,
        servos_per_joint=settings.servos_per_joint,
        simulated=simulated,
        loads=tuple(loads),
        floating=floating,
        calibration=calibration,
        timeline=timeline,
        findings=findings,
    )


def _simulated(source: DesignSource, physics: Physics) -> SimulatedRun | None:
    """Simulate a design on the reference engine, the only one that reports motor torques. None if it diverges."""
    design, rollout = source.design, source.settings.rollout
    environment = environments.true_slush(environments.media_of(source.settings, "true_slush"), source.depth)
    rollouts = simulate(design, environment, engine="reference", trace=True, physics=physics, **rollout.model_dump())
    if rollouts.status[0] != OK or rollouts.trace is None or rollouts.motor_torque is None:
        return None
    joints = list(driven_joints(design))
    trace = rollouts.trace[0, rollout.n_settle :].astype(np.float64)
    return SimulatedRun(
        environment=source.environment,
        com_displacement=float(rollouts.com_displacement[0]),
        duration=rollout.n_measure * physics.time_step,
        torque=rollouts.motor_torque[0][rollout.n_settle :, joints].astype(np.float64),
        speed=trace[:, joints, Column.OMEGA] - trace[:, design.parent[0, joints], Column.OMEGA],
        pose=trace[:, :, [Column.X, Column.Y, Column.ANGLE]],
    )


def _calibration_of(kit: Kit) -> Calibration | None:
    """Return the calibration of servos that match the data sheet: a first guess. None if no joint has a servo."""
    servo = kit.servo
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
