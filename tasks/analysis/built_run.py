"""A built robot's run beside its simulation: speed, gait of each joint, and whether its prediction held.

The robot's joints follow a timeline that rises from rest, so where its start is not known, it is the shift in time at
which the joints that the camera saw fit the timeline best. What is common to all joints' lags then vanishes in the
start, and only differences between joints remain. Then the start is that at which the joints lag as simulated, on
average.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tasks.arrays import Float64
from tasks.design import N_LINKS, Designs, rest_pose
from tasks.simulation import OK, simulate
from tasks.simulation.box2d import Column
from tasks.world import EnsembleMedium, Environment, Physics, ResidualSlush

_FREQUENCIES = np.linspace(0.5, 2.0, 151)  # shares of the gait's that are tried
_MOST_OFF = 0.1  # share by which the frequency of a gait, or a distance of links, may differ
_LEAST_FRAMES = 3  # in which a gait can be seen
_LEAST_SWING = 0.5  # share of the joints' motion that a gait must explain
_CLEARLY = 0.5  # share of the misfit that a start before the video may have
_LEAST_FOLLOWED = 0.25  # share of the joints' angles that the timeline must explain; servos are mounted a tooth off
_DEVIATIONS = 2.0  # of the ensemble, that its interval has to either side


class RunError(ValueError):
    """A run is not one of this robot. The message says why."""


LinkPath = tuple[Float64, Float64]  # (n,) times [s] and (n, 3) x, y [m] and angle [rad] of a link

SpeedPrediction = tuple[float, float, float]  # mean over an ensemble's members, and the ends of an interval [m/s]


@dataclass(frozen=True, eq=False)
class BuiltRobot:
    """A robot that was built, and how it is simulated."""

    name: str
    design: Designs
    scale: float  # bench metres per simulated metre
    time_scale: float  # bench seconds per simulated second
    joints: tuple[int, ...]  # driven joints, by the numbers of their child links
    commanded_time: Float64  # (n_commands,) of the servos' timeline [s of the bench]
    commanded: Float64  # (n_commands, n_joints) angles from rest [rad]
    ramp: float  # time in which the servos rise from rest, and in which they return to it [s of the bench]
    environment: Environment
    physics: Physics
    n_settle: int  # steps of a rollout before displacement is measured
    n_measure: int  # steps over which it is measured
    predicted: Float64 | None  # (n_members,) displacements of the root in a rollout [m of simulation]

    @property
    def frequency(self) -> float:
        """Frequency of the gait on the bench [Hz]."""
        return float(self.design.frequency[0]) / self.time_scale


@dataclass(frozen=True)
class Gait:
    """A joint's oscillation offset + amplitude · sin(2π f t + phase)."""

    amplitude: float  # [rad]
    phase: float  # [rad]
    left: float  # share of the variance that it does not explain


@dataclass(frozen=True, eq=False)
class RobotMotion:
    """A run, measured or simulated, at bench scale, from the moment on at which its gait is steady."""

    time: Float64  # (n_frames,) since the timeline began [s]
    x: Float64  # (n_frames,) of the root, from where it began [m]
    y: Float64  # (n_frames,) over the waterline [m]
    angle: Float64  # (n_frames, n_joints) of the joints from rest [rad]
    speed: float  # [m/s]
    gaits: tuple[Gait, ...]


@dataclass(frozen=True, eq=False)
class RunPredictor:
    """A study's ensemble, which predicts a run of the robot."""

    study: str
    ensemble: EnsembleMedium
    physics: Physics  # of the study's robots; that of the built robot may differ


@dataclass(frozen=True, eq=False)
class RunComparison:
    """A run, its simulation and its prediction."""

    robot: BuiltRobot
    measured: RobotMotion
    simulated: RobotMotion
    lags: Float64  # (2, n_joints) measured and simulated, behind the command [rad]
    start_known: bool  # whether lags are absolute; if not, they are relative to the mean over the joints
    prediction: SpeedPrediction | None
    predictor: RunPredictor | None  # whose ensemble that is; None for the one that the kit records
    members: Float64 | None  # (n_members, n_frames) x of each member's root at ``simulated.time`` [m]

    @property
    def same_way(self) -> bool:
        """Whether the robot and its simulation went the same way."""
        return self.measured.speed * self.simulated.speed > 0


def compare_with_simulation(
    robot: BuiltRobot, paths: Mapping[int, LinkPath], *, start: float | None, predictor: RunPredictor | None
) -> RunComparison:
    """Compare a run with its simulation, and with what an ensemble predicts of it.

    Args:
        robot: the robot.
        paths: path of each link that was tracked.
        start: when the servos' timeline began, on the clock of the paths [s]; None if the joints must tell.
        predictor: a study's ensemble; None for the prediction that the robot's kit records, if it does.

    Returns:
        The steady parts of the run and of its simulation, and the prediction for that time.

    Raises:
        RunError: the run is not of this robot or too short, or its simulation diverged.
    """
    if 0 not in paths:
        raise RunError("no tag of link 0, the root, was tracked: expected it, because its path is compared")
    time, root = paths[0]
    poses = {
        link: np.column_stack([np.interp(time, link_time, path[:, i]) for i in range(3)])
        for link, (link_time, path) in paths.items()
    }
    check_robot(robot.design, {link: pose[:, :2] for link, pose in poses.items()}, robot.scale)
    angle = joint_angles(robot.design, robot.joints, {link: pose[:, 2] for link, pose in poses.items()})
    if start is None:
        check_frequency(time, angle, robot.frequency)  # first, because a start is found in any gait of this frequency
    began = start_of_run(time, angle, robot.commanded_time, robot.commanded) if start is None else start
    measured, simulated, lags = _beside_simulation(robot, time - began, root, angle)
    if start is None:  # what all joints share is not known: let it be the simulation's
        shared = lags.mean(axis=1)
        began -= (shared[1] - shared[0]) / (2 * np.pi * robot.frequency)
        measured, simulated, lags = _beside_simulation(robot, time - began, root, angle)
        lags = lags - lags.mean(axis=1, keepdims=True)
    members, prediction = None, None
    if predictor is not None:
        environment = ResidualSlush(depth=robot.environment.depth, ensemble=predictor.ensemble)
        where = f"under the ensemble of study {predictor.study}"
        _, members = _simulated(robot, environment, predictor.physics, measured, where)
        speeds = [steady_speed(simulated.time, x, 1 / robot.frequency) for x in members]
        prediction = speed_prediction(np.array(speeds))
    elif robot.predicted is not None:
        seconds = robot.n_measure * robot.physics.time_step * robot.time_scale
        prediction = speed_prediction(robot.predicted * robot.scale / seconds)
    return RunComparison(robot, measured, simulated, lags, start is not None, prediction, predictor, members)


def fit_gait(time: Float64, angle: Float64, frequency: float) -> Gait:
    """Fit a joint's oscillation.

    Args:
        time: (n_frames,) [s].
        angle: (n_frames,) [rad].
        frequency: of the gait [Hz].

    Returns:
        The oscillation.
    """
    turn = 2 * np.pi * frequency * time
    columns = np.stack((np.sin(turn), np.cos(turn), np.ones_like(turn)), axis=1)
    (a, b, c), *_ = np.linalg.lstsq(columns, angle, rcond=None)
    left = angle - columns @ (a, b, c)
    return Gait(float(np.hypot(a, b)), float(np.arctan2(b, a)), float(left.var() / max(angle.var(), 1e-12)))


def joint_angles(design: Designs, joints: tuple[int, ...], angle: Mapping[int, Float64]) -> Float64:
    """Return (n_frames, n_joints) angles of joints from rest, within ±π.

    Args:
        design: one design; joints whose motor is off are locked.
        joints: numbers of the child links.
        angle: (n_frames,) angles of links [rad]; any link of each rigid part will do.

    Raises:
        RunError: no link of a part is given.
    """
    body, rest = _bodies(design), rest_pose(design)[2][0]

    def link_angle(link: int) -> Float64:
        known = [other for other in angle if body[other] == body[link]]
        if not known:
            same = " or ".join(str(other) for other in range(N_LINKS) if body[other] == body[link])
            raise RunError(f"link {link} moves a joint, and no tag of its part was tracked: expected link {same}")
        other = link if link in known else known[0]
        return np.asarray(angle[other] - rest[other] + rest[link])

    parent = design.parent[0]
    turned = [link_angle(j) - link_angle(int(parent[j])) - design.rest_angle[0, j] for j in joints]
    return np.asarray((np.stack(turned, axis=1) + np.pi) % (2 * np.pi) - np.pi)


def check_robot(design: Designs, position: Mapping[int, Float64], scale: float) -> None:
    """Check that links that are one part stay as far apart as they are at rest.

    Args:
        design: one design.
        position: (n_frames, 2) positions of links [m].
        scale: bench metres per simulated metre.

    Raises:
        RunError: they do not.
    """
    body, (x, y, _) = _bodies(design), rest_pose(design)
    links = sorted(position)
    for i, first in enumerate(links):
        for second in links[i + 1 :]:
            if body[first] != body[second]:
                continue
            expected = scale * float(np.hypot(x[0, first] - x[0, second], y[0, first] - y[0, second]))
            found = float(np.median(np.hypot(*(position[first] - position[second]).T)))
            if abs(found - expected) > _MOST_OFF * expected + 0.003:
                raise RunError(
                    f"links {first} and {second} are {1000 * found:.0f} mm apart, expected {1000 * expected:.0f} mm: "
                    f"is this the kit of another robot, or are tags on other links?"
                )


def _bodies(design: Designs) -> list[int]:
    """Return the rigid part of each link."""
    body = list(range(N_LINKS))
    for link in range(1, N_LINKS):
        if not design.motor_on[0, link]:
            body[link] = body[int(design.parent[0, link])]
    return body


def check_frequency(time: Float64, angle: Float64, frequency: float) -> None:
    """Check that joints oscillate at the frequency of a gait.

    Args:
        time: (n_frames,) [s].
        angle: (n_frames, n_joints) [rad].
        frequency: expected [Hz].

    Raises:
        RunError: they do not, or do not swing at all.
    """
    if len(time) < _LEAST_FRAMES:
        raise RunError(f"it is seen in {len(time)} frame{'s' * (len(time) != 1)}, expected at least {_LEAST_FRAMES}")
    variance = np.maximum(angle.var(axis=0), 1e-12)
    left = [
        np.average([fit_gait(time, joint_angle, frequency * share).left for joint_angle in angle.T], weights=variance)
        for share in _FREQUENCIES
    ]
    if min(left) > 1 - _LEAST_SWING:
        raise RunError(
            f"its joints do not swing, expected a gait of {frequency:.2f} Hz: do its servos turn, and is this the kit "
            f"of another robot?"
        )
    found = float(_FREQUENCIES[int(np.argmin(left))])
    slack = max(_MOST_OFF, 0.5 / (frequency * float(time[-1] - time[0])))
    if abs(found - 1) > slack:
        raise RunError(
            f"its joints swing at {found * frequency:.2f} Hz, expected {frequency:.2f} Hz: is this the kit of another "
            f"robot, does the video play slower than life (--slowdown), or is scaling.law another one?"
        )


def start_of_run(time: Float64, angle: Float64, commanded_time: Float64, commanded: Float64) -> float:
    """Return the time at which a timeline began [s], as the joints' angles show it.

    It is in the video, unless an earlier one fits clearly better. The command is scaled to the range through which each
    joint swings: a weak servo does not reach its command, and the closest shift would be the one that commands nothing.

    Args:
        time: (n_frames,) times of the frames [s].
        angle: (n_frames, n_joints) angles of joints from rest [rad].
        commanded_time: (n_commands,) times of the timeline [s].
        commanded: (n_commands, n_joints) commanded angles from rest [rad].

    Raises:
        RunError: the joints do not follow the timeline.
    """
    reached, asked = (np.ptp(np.quantile(angles, (0.02, 0.98), axis=0), axis=0) for angles in (angle, commanded))
    scaled = commanded * (reached / np.maximum(asked, 1e-9))

    def misfit(start: float) -> float:
        columns = [np.interp(time - start, commanded_time, column, left=0.0, right=0.0) for column in scaled.T]
        return float(np.square(angle - np.stack(columns, axis=1)).mean())

    coarse = np.arange(time[0] - commanded_time[-1], time[-1], 0.04)
    misfits = np.array([misfit(start) for start in coarse])
    filmed = np.where(coarse >= time[0], misfits, np.inf)
    best = float(coarse[int(np.argmin(misfits if misfits.min() < _CLEARLY * filmed.min() else filmed))])
    fine = best + np.linspace(-0.04, 0.04, 41)
    best = float(fine[int(np.argmin([misfit(start) for start in fine]))])
    if misfit(best) > (1 - _LEAST_FOLLOWED) * float(np.square(angle).mean()):
        raise RunError(
            "its joints do not follow the kit's timeline wherever it may begin: film the run from before the servos "
            "start, check that this is its kit, or give --start"
        )
    return best


def speed_prediction(predictions: Float64) -> SpeedPrediction:
    """Return the mean of (n_members,) predictions, with two of their standard deviations to either side."""
    mean, spread = float(predictions.mean()), _DEVIATIONS * float(predictions.std())
    return mean, mean - spread, mean + spread


def steady_speed(time: Float64, x: Float64, period: float) -> float:
    """Return a mean speed without the swing of the gait: between the means of x over the first and last period.

    Args:
        time: (n_frames,) [s].
        x: (n_frames,) [m].
        period: of the gait [s].

    Raises:
        RunError: the run is shorter than two periods.
    """
    if time[-1] - time[0] < 2 * period:
        raise RunError(
            f"the gait is steady for {time[-1] - time[0]:.1f} s, expected at least two periods, {2 * period:.1f} s: "
            f"film a longer part of the run"
        )
    first, last = time <= time[0] + period, time >= time[-1] - period
    return float((x[last].mean() - x[first].mean()) / (time[last].mean() - time[first].mean()))


def _beside_simulation(
    robot: BuiltRobot, time: Float64, root: Float64, angle: Float64
) -> tuple[RobotMotion, RobotMotion, Float64]:
    """Return the steady part of a run, as long a one of its simulation, and the lags of both.

    Args:
        robot: the robot.
        time: (n_frames,) since the timeline began [s].
        root: (n_frames, 3) poses of the root.
        angle: (n_frames, n_joints) of the joints from rest [rad].
    """
    end = float(robot.commanded_time[-1])
    ramp = min(robot.ramp, end / 2)
    steady = (time >= ramp) & (time <= end - ramp)
    if steady.sum() < _LEAST_FRAMES:
        raise RunError(
            f"the gait is steady in {steady.sum()} frames: expected a video of the run between {ramp:g} and "
            f"{end - ramp:g} s after the servos began; it shows {time[0]:.1f} to {time[-1]:.1f} s"
        )
    check_frequency(time[steady], angle[steady], robot.frequency)
    measured = _motion(time[steady], root[steady, :2], angle[steady], robot)
    simulated, _ = _simulated(robot, robot.environment, robot.physics, measured, "in True Slush")
    commanded = robot.design.phase[0, list(robot.joints)]
    lags = np.array(
        [[at - gait.phase for at, gait in zip(commanded, run.gaits, strict=True)] for run in (measured, simulated)]
    )
    return measured, simulated, (lags + np.pi) % (2 * np.pi) - np.pi


def _motion(time: Float64, position: Float64, angle: Float64, robot: BuiltRobot) -> RobotMotion:
    gaits = tuple(fit_gait(time, joint_angle, robot.frequency) for joint_angle in angle.T)
    speed = steady_speed(time, position[:, 0], 1 / robot.frequency)
    return RobotMotion(time, position[:, 0] - position[0, 0], position[:, 1], angle, speed, gaits)


def _simulated(
    robot: BuiltRobot, environment: Environment, physics: Physics, measured: RobotMotion, where: str
) -> tuple[RobotMotion, Float64]:
    """Simulate as long a run after settling, from the same phase of the gait on.

    Returns the first member's, and (n_members, n_steps) x of all [m].
    """
    step = physics.time_step * robot.time_scale
    n_steps = int(np.ceil((measured.time[-1] - measured.time[0]) / step)) + 1
    period = 1 / robot.frequency
    n_settle = robot.n_settle
    n_settle += round(((measured.time[0] - step * (n_settle + 1)) % period) / step)
    rollouts = simulate(robot.design, environment, n_settle=n_settle, n_measure=n_steps, trace=True, physics=physics)
    if rollouts.trace is None or not (rollouts.status == OK).all():
        raise RunError(f"its simulation {where} diverged, so there is nothing to compare with")
    trace = rollouts.trace.reshape(-1, *rollouts.trace.shape[-3:])[:, n_settle:].astype(np.float64)
    time = np.asarray(step * (n_settle + 1 + np.arange(n_steps)), dtype=np.float64)
    angles = {link: trace[0, :, link, Column.ANGLE] for link in range(N_LINKS)}
    angle = joint_angles(robot.design, robot.joints, angles)
    root = robot.scale * trace[:, :, 0, : Column.Y + 1]
    motion = _motion(time, root[0], angle, robot)
    x = root[:, :, Column.X]
    return motion, x - x[:, :1]
