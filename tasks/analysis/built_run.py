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
from tasks.world import Environment, Physics

_FREQUENCIES = np.linspace(0.5, 2.0, 151)  # shares of the gait's that are tried
_MOST_OFF = 0.1  # share by which the frequency of a gait, or a distance of links, may differ
_LEAST_FRAMES = 3  # in which a gait can be seen
_LEAST_SWING = 0.5  # share of the joints' motion that a gait must explain
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
    predicted: Float64 | None  # (n_members,) speeds of the root under an ensemble [m/s of the bench]
    predicted_by: str = "the kit's ensemble"

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
class RunComparison:
    """A run and its simulation."""

    robot: BuiltRobot
    measured: RobotMotion
    simulated: RobotMotion
    lags: Float64  # (2, n_joints) measured and simulated, behind the command [rad]
    start_known: bool  # whether lags are absolute; if not, they are relative to the mean over the joints

    @property
    def prediction(self) -> SpeedPrediction | None:
        """Mean speed over the members, with two of their deviations to either side."""
        return None if self.robot.predicted is None else speed_prediction(self.robot.predicted)

    @property
    def same_way(self) -> bool:
        """Whether the robot and its simulation went the same way."""
        return self.measured.speed * self.simulated.speed > 0


def compare_with_simulation(robot: BuiltRobot, paths: Mapping[int, LinkPath], *, start: float | None) -> RunComparison:
    """Compare the steady part of a run with its simulation.

    Args:
        robot: the robot.
        paths: path of each link that was tracked.
        start: when the servos' timeline began, on the clock of the paths [s]; None if the joints must tell.

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
    if start is not None:
        return RunComparison(robot, *_beside_simulation(robot, time - start, root, angle), start_known=True)
    check_frequency(time, angle, robot.frequency)  # first, because a start is found in any gait of this frequency
    began = start_of_run(time, angle, robot.commanded_time, robot.commanded)
    _, _, lags = _beside_simulation(robot, time - began, root, angle)
    shared = lags.mean(axis=1)  # what all joints share is not known: let it be the simulation's
    began -= (shared[1] - shared[0]) / (2 * np.pi * robot.frequency)
    measured, simulated, lags = _beside_simulation(robot, time - began, root, angle)
    return RunComparison(robot, measured, simulated, lags - lags.mean(axis=1, keepdims=True), start_known=False)


def fit_gait(time: Float64, angle: Float64, frequency: float) -> Gait:
    """Fit the oscillation of (n_frames,) angles [rad] of a joint at the gait's frequency [Hz]."""
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
    """Check that links of one part, at (n_frames, 2) positions [m], are as far apart as at rest; raise RunError."""
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
    """Check that (n_frames, n_joints) angles [rad] oscillate at the frequency of a gait [Hz]; raise RunError."""
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
    """Return the time in the video at which a timeline began [s], as the joints' angles show it.

    The command is scaled to the range through which each
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

    best = min(np.arange(time[0], time[-1], 0.04).tolist(), key=misfit)
    best = min((best + np.linspace(-0.04, 0.04, 41)).tolist(), key=misfit)
    if misfit(best) > (1 - _LEAST_FOLLOWED) * float(np.square(angle).mean()):
        raise RunError(
            "its joints do not follow the kit's timeline wherever it may begin: film the run from before the servos "
            "start, check that this is its kit, or give --start"
        )
    return float(best)


def speed_prediction(predictions: Float64) -> SpeedPrediction:
    """Return the mean of (n_members,) predictions, with two of their standard deviations to either side."""
    mean, spread = float(predictions.mean()), _DEVIATIONS * float(predictions.std())
    return mean, mean - spread, mean + spread


def steady_speed(time: Float64, x: Float64, period: float) -> float:
    """Return a mean speed without the swing of the gait: between the means of x over the first and last period.

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

    Time is since the timeline began [s], the root's poses are (n_frames, 3).
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
    simulated = _simulated(robot, measured)
    commanded = robot.design.phase[0, list(robot.joints)]
    lags = np.array(
        [[at - gait.phase for at, gait in zip(commanded, run.gaits, strict=True)] for run in (measured, simulated)]
    )
    return measured, simulated, (lags + np.pi) % (2 * np.pi) - np.pi


def _motion(time: Float64, position: Float64, angle: Float64, robot: BuiltRobot) -> RobotMotion:
    gaits = tuple(fit_gait(time, joint_angle, robot.frequency) for joint_angle in angle.T)
    speed = steady_speed(time, position[:, 0], 1 / robot.frequency)
    return RobotMotion(time, position[:, 0] - position[0, 0], position[:, 1], angle, speed, gaits)


def _simulated(robot: BuiltRobot, measured: RobotMotion) -> RobotMotion:
    """Simulate as long a run after settling, from the same phase of the gait on."""
    step = robot.physics.time_step * robot.time_scale
    n_steps = int(np.ceil((measured.time[-1] - measured.time[0]) / step)) + 1
    n_settle = robot.n_settle
    n_settle += round(((measured.time[0] - step * (n_settle + 1)) % (1 / robot.frequency)) / step)
    rollouts = simulate(
        robot.design, robot.environment, n_settle=n_settle, n_measure=n_steps, trace=True, physics=robot.physics
    )
    if rollouts.trace is None or not (rollouts.status == OK).all():
        raise RunError("its simulation in True Slush diverged, so there is nothing to compare with")
    trace = rollouts.trace[0, n_settle:].astype(np.float64)
    time = np.asarray(step * (n_settle + 1 + np.arange(n_steps)), dtype=np.float64)
    angle = joint_angles(robot.design, robot.joints, {link: trace[:, link, Column.ANGLE] for link in range(N_LINKS)})
    return _motion(time, robot.scale * trace[:, 0, : Column.Y + 1], angle, robot)
