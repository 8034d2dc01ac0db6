"""The kit on the bench: the loads of its servos, its floating, its timeline, and what speaks against building it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isclose, radians

import numpy as np

from pipeline.bench.fabrication.source import DesignSource
from pipeline.stages import environments
from tasks.arrays import Float64
from tasks.bench.fabrication.calibration import Calibration, ServoCalibration
from tasks.bench.fabrication.checks import KitFinding
from tasks.bench.fabrication.kit import Floating, Kit, floating_of
from tasks.bench.fabrication.kit_settings import FabricationSettings
from tasks.bench.fabrication.scaling import CONTINUOUS_SHARE, JointLoad, Scales, joint_loads, scales_of
from tasks.bench.fabrication.servos import Servo
from tasks.bench.fabrication.timeline import Timeline, TimelineError, driven_joints, pulses, timeline_of
from tasks.design.gait import top_speed
from tasks.simulation import OK, simulate
from tasks.simulation.box2d import Column
from tasks.world import Physics

_SPARE_RANGE = radians(5.0)  # beyond a joint's range that a calibration allows
_MIN_MARGIN = 1.3  # sagging batteries, cables, wet seals and wear may take a quarter of a data sheet's torque and speed
_SATURATION = 0.2  # share of the run at the simulated motor's limit, above which its torques underestimate the gait's


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """The simulated run from which the loads are taken."""

    com_displacement: float  # displacement of the centre of mass [m of simulation]
    duration: float  # duration of the measurement [s of simulation]
    torque: Float64
    """(n_steps, n_joints) torques of the motors [N·m of simulation], after settling: before, the motors jump to the
    gait, which a timeline does not."""
    speed: Float64  # (n_steps, n_joints) speeds of the joints [rad/s of simulation]


@dataclass(frozen=True, eq=False)
class Bench:
    """Everything about a kit beside its parts."""

    scales: Scales
    simulated: SimulatedRun | None  # none if the simulation diverged or has no torques; the findings say which
    loads: tuple[JointLoad, ...]
    floating: Floating
    calibration: Calibration | None  # none if no joint has a servo
    timeline: Timeline | None  # none if the servos can't play it; the findings say why
    findings: tuple[KitFinding, ...]


def bench_of(source: DesignSource, kit: Kit, choices: FabricationSettings, physics: Physics) -> Bench:
    """Simulate a design, compute loads, floating and timeline of its kit, and check them."""
    scales = scales_of(
        choices.scaling,
        length=choices.kit.scale_mm_per_m / 1000,
        mass_kg=kit.mass_g / 1000,
        simulated_mass_kg=physics.link_density * source.design.parent.shape[1],  # a link has 1 m²
    )
    calibration = _calibration_of(kit)
    timeline, about_timeline = _played(source, scales, calibration)
    simulated = _simulated(source, physics)
    run = simulated if isinstance(simulated, SimulatedRun) else None
    loads = () if run is None else tuple(_loads(source, kit, run, scales, physics))
    about_loads = check_loads(loads, kit.servo) if isinstance(simulated, SimulatedRun) else [simulated]
    floating = floating_of(kit, fluid_density=choices.scaling.fluid_density)
    about_robot = (KitFinding("warning", "robot", message) for message in _check_tank(source, choices, floating))
    return Bench(
        scales=scales,
        simulated=run,
        loads=loads,
        floating=floating,
        calibration=calibration,
        timeline=timeline,
        findings=(*about_timeline, *about_loads, *about_robot),
    )


def _played(
    source: DesignSource, scales: Scales, calibration: Calibration | None
) -> tuple[Timeline | None, list[KitFinding]]:
    """Return the timeline, or the fault of servos that can't play it; neither without a servo."""
    if calibration is None:
        return None, []
    timeline = timeline_of(source.design, time_scale=scales.time)
    try:
        pulses(timeline, calibration)
    except TimelineError as error:
        message = f"can't play this gait: {str(error).rstrip('.')}. {_ADVICE['gait']}"
        return None, [KitFinding("fault", "servos", message)]
    return timeline, []


def _loads(
    source: DesignSource, kit: Kit, simulated: SimulatedRun, scales: Scales, physics: Physics
) -> list[JointLoad]:
    joints = driven_joints(source.design)
    return joint_loads(
        joints,
        simulated.torque,
        simulated.speed,
        scales=scales,
        servo=kit.servo,
        servos_per_joint=kit.settings.servos_per_joint,
        max_motor_torque=physics.max_motor_torque,
        commanded_speed=top_speed(source.design)[0, list(joints)],
    )


def _check_tank(source: DesignSource, choices: FabricationSettings, floating: Floating) -> Iterator[str]:
    """Say what keeps the kit from floating in its study's tank, or in slush of the simulated depth at its scale."""
    tank, scale = source.settings.tank, choices.kit.scale_mm_per_m
    yield from check_floating(floating, source.depth * scale if tank is None else 1000 * tank.depth)
    if tank is not None and not isclose(1000 * tank.scale, scale):
        expected = f"{1000 * tank.scale:g}"
        yield (
            f"the kit has {scale:g} mm per metre of simulation, the tank of its settings {expected} mm. Results from "
            f"that tank do not apply to this kit; to match it, --set kit.scale_mm_per_m={expected}"
        )


def _simulated(source: DesignSource, physics: Physics) -> SimulatedRun | KitFinding:
    """Simulate a design on the reference engine, the only one that reports motor torques."""
    design, rollout = source.design, source.settings.rollout
    target = source.settings.target
    media = environments.media_of(source.settings, target)
    environment = environments.build_environment(media, target, source.depth, source.networks)
    rollouts = simulate(design, environment, engine="reference", trace=True, physics=physics, **rollout.model_dump())
    if rollouts.status[0] != OK or rollouts.trace is None:
        return KitFinding("fault", "joints", "loads are unknown because the simulation diverged")
    if rollouts.motor_torque is None:
        return KitFinding("warning", "joints", f"loads are unknown: the engine of {target} reports no torques")
    joints = list(driven_joints(design))
    trace = rollouts.trace[0, rollout.n_settle :].astype(np.float64)
    return SimulatedRun(
        com_displacement=float(rollouts.com_displacement[0]),
        duration=rollout.n_measure * physics.time_step,
        torque=rollouts.motor_torque[0][rollout.n_settle :, joints].astype(np.float64),
        speed=trace[:, joints, Column.OMEGA] - trace[:, design.parent[0, joints], Column.OMEGA],
    )


def _calibration_of(kit: Kit) -> Calibration | None:
    """Return the calibration of servos that match the data sheet: a first guess. None if no joint has a servo."""
    servo = kit.servo
    servos: list[ServoCalibration] = []
    for servo_joint in kit.servo_joints:
        reach = servo.us_per_rad * (servo_joint.joint.reach + _SPARE_RANGE)
        for side in servo_joint.sides:
            servos.append(
                ServoCalibration(
                    joint=servo_joint.joint.link,
                    channel=len(servos),
                    centre_us=servo.neutral_us,
                    direction=kit.direction(servo_joint, side),
                    us_per_rad=round(servo.us_per_rad, 3),
                    min_us=round(max(servo.min_pulse_us, servo.neutral_us - reach), 1),
                    max_us=round(min(servo.max_pulse_us, servo.neutral_us + reach), 1),
                    max_speed=round(servo.no_load_speed_rad_s, 3),
                )
            )
    return Calibration(servos=tuple(servos)) if servos else None


_ADVICE = {
    "gait": "Choose a servo with more travel or speed (--set kit.servo=...), another scaling.law, or another design",
    "speed": "Choose a faster servo (--set kit.servo=...), or --set scaling.law=kept_frequencies",
    "torque": "Choose a stronger servo (--set kit.servo=...), or --set kit.servos_per_joint=2",
}


def check_loads(loads: Sequence[JointLoad], servo: Servo) -> Iterator[KitFinding]:
    """Check the loads of a simulated run against a servo, in order of the joints."""
    for load in loads:
        where = f"joint {load.joint}"
        speed, torque = load.peak_speed / servo.no_load_speed_rad_s, load.peak_torque / servo.stall_torque_nm
        advice = _ADVICE["speed" if speed > torque else "torque"]
        if load.use > 1:
            message = (
                f"the servo is too weak or too slow: at the worst instant the run needs {load.use:.2f} times what a "
                f"{servo.name} gives (needs up to {load.peak_torque:.2f} N·m and {load.peak_speed:.1f} rad/s; has "
                f"{servo.stall_torque_nm:.2f} N·m at stall, {servo.no_load_speed_rad_s:.1f} rad/s unloaded). {advice}"
            )
            yield KitFinding("fault", where, message)
        elif load.margin < _MIN_MARGIN:
            message = (
                f"at the worst instant a {servo.name} gives {load.margin:.2f} times what the run needs, expected at "
                f"least {_MIN_MARGIN:g} because real servos give less than their data sheet. {advice}"
            )
            yield KitFinding("warning", where, message)
        if load.stall_share > CONTINUOUS_SHARE:
            message = (
                f"needs {load.stall_share:.0%} of the stall torque (root mean square); above {CONTINUOUS_SHARE:.0%} a "
                f"hobby servo overheats within minutes"
            )
            yield KitFinding("warning", where, message)
        if load.saturated > _SATURATION:
            share = f"{load.saturated:.0%} of the run"
            message = f"the simulated motor is at its torque limit in {share}: the torques given are lower bounds"
            yield KitFinding("warning", where, message)


def check_floating(floating: Floating, tank_mm: float) -> Iterator[str]:
    """Say what keeps the kit from floating in a tank of a depth [mm]."""
    if floating.draught_mm is not None and floating.draught_mm > tank_mm:
        yield f"stands on the floor of a {tank_mm:.0f} mm deep tank: its draught is {floating.draught_mm:.0f} mm"
    if floating.sealed_share > 1:
        yield f"sinks: it weighs {floating.sealed_share:.2f} times the fluid that it displaces"
    elif floating.flooded_share > 1:
        yield (
            f"floats while its pockets are dry, but sinks once they are full: it then weighs "
            f"{floating.flooded_share:.2f} times the displaced fluid. Seal the pockets"
        )
