"""The run of a built robot beside its simulation and its promise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.commands.run_page import render_run
from pipeline.config.loading import load
from pipeline.config.settings import RolloutSettings
from pipeline.errors import PuddleError
from pipeline.fabrication.kit_folder import KIT, KIT_MANIFEST
from pipeline.fabrication.timeline_file import read_timeline
from pipeline.results.recorded_study import Study, open_study
from pipeline.store import disk
from pipeline.store.design_file import read_design
from pipeline.store.encoding import check_format, decode_json
from pipeline.store.track_file import read_track_columns, track_table
from pipeline.vision.markers_file import Markers
from pipeline.vision.track_video import TrackOptions, follow
from tasks.analysis.built_run import (
    Gait,
    Promise,
    RunError,
    check_frequency,
    check_robot,
    fit_gait,
    joint_angles,
    promise_of,
    start_of_run,
    steady_speed,
)
from tasks.arrays import Float64
from tasks.design import N_LINKS, Designs
from tasks.fabrication.kit_settings import FabricationSettings
from tasks.fabrication.timeline import Timeline
from tasks.simulation import OK, simulate
from tasks.simulation.box2d import Column
from tasks.world import ENVIRONMENTS, Environment, Physics, ResidualSlush, froude_time

_MOST_SPEED = 5.0  # of a link in a tank [m/s]


@dataclass(frozen=True)
class RunSource:
    """Where a run comes from."""

    path: Path  # a video, or tracks whose throws are links
    markers: Path | None
    lens: Path | None
    slowdown: float
    start: float | None  # when the timeline began [s]; None if the joints must tell


@dataclass(frozen=True, eq=False)
class RobotKit:
    """What a kit's folder says of its robot."""

    name: str
    design: Designs
    timeline: Timeline
    choices: FabricationSettings
    environment: Environment
    physics: Physics
    rollout: RolloutSettings
    predicted: Float64 | None  # (n_members,) displacements of the root in a rollout [m of simulation]

    @property
    def scale(self) -> float:
        """Bench metres per simulated metre."""
        return self.choices.kit.scale_mm_per_m / 1000

    @property
    def time_scale(self) -> float:
        """Bench seconds per simulated second."""
        return froude_time(self.scale) if self.choices.scaling.law == "froude" else 1.0

    @property
    def frequency(self) -> float:
        """Frequency of the gait on the bench [Hz]."""
        return float(self.design.frequency[0]) / self.time_scale


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
    """Everything about a run."""

    kit: RobotKit
    measured: RobotMotion
    simulated: RobotMotion
    members: Float64 | None  # (n_members, n_frames) x of each member's root at ``simulated.time`` [m]
    promise: Promise | None  # of the speed [m/s]
    promised_by: str
    note: str  # on what was promised, or ""
    lags: Float64  # (2, n_joints) measured and simulated, behind the command [rad]
    start_known: bool

    @property
    def same_way(self) -> bool:
        """Whether the robot and its simulation went the same way."""
        return self.measured.speed * self.simulated.speed > 0

    @property
    def verdict(self) -> str:
        """Whether the robot did what was promised, in a sentence."""
        went = f"it went {_mm(self.measured.speed)} mm/s"
        if self.promise is None:
            share = f"{self.measured.speed / self.simulated.speed:.0%} of" if self.same_way else "against"
            return (
                f"No ensemble promised anything: {went}, {share} the {_mm(self.simulated.speed)} mm/s of its "
                f"simulation. Name the study that it comes from with --study."
            )
        low, high = self.promise.low, self.promise.high
        promised = f"the {_mm(low)} to {_mm(high)} mm/s that {self.promised_by} promised"
        if not self.promise.holds(self.measured.speed):
            than = "less" if self.measured.speed < low else "more"
            return f"The robot did not do what was promised: {went}, {than} than {promised}."
        vague = ", but the promise leaves the direction open" if low < 0 < high else ""
        return f"The robot did what was promised{vague}: {went}, within {promised}."


def compare_built_run(source: RunSource, kit: Path, study: str | None, store: Path, out: Path) -> list[str]:
    """Compare a run with its simulation; write the page.

    Args:
        source: the run.
        kit: the robot's kit.
        study: the study whose ensemble predicts the run; None for what the kit records.
        store: the store of the study.
        out: the page.

    Returns:
        Lines for the terminal; the last one is the verdict.

    Raises:
        PuddleError: the run can't be read, is not of this robot, or is too short.
    """
    if out.suffix != ".html" or not out.parent.is_dir() or out.is_dir():
        raise PuddleError(f"--out: expected a file name that ends in .html, in an existing folder, got {out}")
    robot = read_kit(kit)
    recorded = None if study is None else open_study(study, store)
    tracks, lines = _tracks(source)
    try:
        comparison = _compared(robot, tracks, source.start, recorded)
    except RunError as error:
        raise PuddleError(f"{source.path} with {kit}: {error}") from None
    page = render_run(comparison, source.path.name)
    with disk.explained("writing the page", out, advice="choose another file"):
        disk.place(out, page.encode())
    lines += _lines(comparison)
    return [*lines, f"page: {out}", comparison.verdict]


def read_kit(folder: Path) -> RobotKit:
    """Read a kit's folder. Raises PuddleError if it is none, or lacks its timeline or simulation."""
    path = folder / KIT_MANIFEST
    try:
        document = decode_json(disk.read_document(path), str(path))
    except OSError as error:
        raise PuddleError(
            f"{folder}: expected a kit of `puddle fabricate`, found no {path.name}: {error.strerror}"
        ) from None
    check_format(document, schema=KIT.schema, version=KIT.version, source=str(path))
    if "simulated" not in document:
        raise PuddleError(
            f"{path}: does not say how the robot was simulated. Make the kit again with `puddle fabricate`."
        )
    if not (folder / "timeline.json").exists():
        raise PuddleError(f"{folder}: has no timeline.json, because its servos can't play the gait: no run is its own")
    simulated: Mapping[str, Any] = document["simulated"]
    predicted = simulated["predicted"]
    return RobotKit(
        name=str(document["name"]),
        design=read_design(folder / "design.json"),
        timeline=read_timeline(folder / "timeline.json"),
        choices=FabricationSettings.model_validate(document["settings"]),
        environment=ENVIRONMENTS["true_slush"].environment(simulated["depth"], simulated["media"]),
        physics=Physics.model_validate(simulated["physics"]),
        rollout=RolloutSettings.model_validate(simulated["rollout"]),
        predicted=None if predicted is None else np.array(predicted, dtype=np.float64),
    )


LinkPath = tuple[Float64, Float64]  # (n,) times [s] and (n, 3) x, y [m] and angle [rad] of a link


def _tracks(source: RunSource) -> tuple[dict[int, LinkPath], list[str]]:
    """Return the path of each link, and lines for the terminal."""
    if source.path.suffix in (".csv", ".parquet"):
        return _read_tracks(source.path), []
    if source.markers is None:
        raise PuddleError(
            f"{source.path}: a video needs --markers, markers.yaml of a throwing kit; tracks end in .csv or .parquet"
        )
    options = TrackOptions(source.lens, source.slowdown, robot=True)
    (video,), lines = follow([source.path], load(Markers, source.markers), options)
    return {track.throw: (track.time, track.pose) for track in video.tracks}, lines


def _read_tracks(path: Path) -> dict[int, LinkPath]:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PuddleError(f"{path}: expected tracks, got: {error.strerror}") from None
    rows = track_table(read_track_columns(content, str(path)), str(path))
    table = np.column_stack((rows.throw, rows.time, rows.x, rows.y, rows.angle))
    if not np.isfinite(table).all():
        raise PuddleError(f"{path}: row {int(np.argwhere(~np.isfinite(table))[0, 0]) + 1}: expected finite numbers")
    found: dict[int, LinkPath] = {}
    for link in np.unique(table[:, 0]).astype(int).tolist():
        if not 0 <= link < N_LINKS:
            raise PuddleError(
                f"{path}: throw {link}: expected links of a robot, 0 to {N_LINKS - 1}: track the run with --robot"
            )
        own = table[table[:, 0] == link]
        if (late := np.flatnonzero(np.diff(own[:, 1]) <= 0)).size:
            raise PuddleError(f"{path}: link {link}, frame {late[0] + 1}: expected a time later than the frame before")
        speed = np.hypot(*np.diff(own[:, 2:4], axis=0).T) / np.diff(own[:, 1])
        if (fast := np.flatnonzero(speed > _MOST_SPEED)).size:
            raise PuddleError(
                f"{path}: link {link}, frame {fast[0] + 1}: it moves at {speed[fast[0]]:.3g} m/s, expected at most "
                f"{_MOST_SPEED:g}: x and y are in metres and times in seconds; remove frames that were tracked wrongly"
            )
        found[link] = (own[:, 1], np.column_stack((own[:, 2:4], np.unwrap(own[:, 4]))))
    return found


def _compared(
    robot: RobotKit, tracks: Mapping[int, LinkPath], start: float | None, study: Study | None
) -> RunComparison:
    if 0 not in tracks:
        raise RunError("no tag of link 0, the root, was tracked: expected it, because its path is compared")
    time, root = tracks[0]
    poses = {
        link: np.column_stack([np.interp(time, link_time, path[:, i]) for i in range(3)])
        for link, (link_time, path) in tracks.items()
    }
    check_robot(robot.design, {link: pose[:, :2] for link, pose in poses.items()}, robot.scale)
    joints, line = robot.timeline.joints, robot.timeline
    angle = joint_angles(robot.design, joints, {link: pose[:, 2] for link, pose in poses.items()})
    if start is None:
        check_frequency(time, angle, robot.frequency)  # first, because a start is found in any gait of this frequency
    began = start_of_run(time, angle, line.time, line.angle) if start is None else start
    measured, simulated, lags = _beside_simulation(robot, time - began, root, angle)
    if start is None:  # what all joints share is not known: let it be the simulation's
        shared = lags.mean(axis=1)
        began -= (shared[1] - shared[0]) / (2 * np.pi * robot.frequency)
        measured, simulated, lags = _beside_simulation(robot, time - began, root, angle)
        lags = lags - lags.mean(axis=1, keepdims=True)
    members, promise, promised_by, note = None, None, "", ""
    if study is not None:
        environment = ResidualSlush(depth=robot.environment.depth, ensemble=study.ensemble())
        promised_by, note = f"the ensemble of study {study.name}", _other_physics(robot, study)
        _, members = _simulated(robot, environment, study.settings.physics, measured, f"under {promised_by}")
        speeds = [steady_speed(simulated.time, x, 1 / robot.frequency) for x in members]
        promise = promise_of(np.array(speeds))
    elif robot.predicted is not None:
        seconds = robot.rollout.n_measure * robot.physics.time_step * robot.time_scale
        promise, promised_by = promise_of(robot.predicted * robot.scale / seconds), "the kit's ensemble"
    return RunComparison(robot, measured, simulated, members, promise, promised_by, note, lags, start is not None)


def _beside_simulation(
    robot: RobotKit, time: Float64, root: Float64, angle: Float64
) -> tuple[RobotMotion, RobotMotion, Float64]:
    """Return the steady part of a run, as long a one of its simulation, and the lags of both.

    Args:
        robot: the robot.
        time: (n_frames,) since the timeline began [s].
        root: (n_frames, 3) poses of the root.
        angle: (n_frames, n_joints) of the joints from rest [rad].
    """
    line = robot.timeline
    ramp = min(robot.choices.playback.ramp, float(line.time[-1]) / 2)
    steady = (time >= ramp) & (time <= line.time[-1] - ramp)
    if steady.sum() < 3:
        raise RunError(
            f"the gait is steady in {steady.sum()} frames: expected a video of the run between {ramp:g} and "
            f"{line.time[-1] - ramp:g} s after the servos began; it shows {time[0]:.1f} to {time[-1]:.1f} s"
        )
    check_frequency(time[steady], angle[steady], robot.frequency)
    measured = _motion(time[steady], root[steady, :2], angle[steady], robot)
    simulated, _ = _simulated(robot, robot.environment, robot.physics, measured, "in True Slush")
    commanded = robot.design.phase[0, list(line.joints)]
    lags = np.array(
        [[at - gait.phase for at, gait in zip(commanded, run.gaits, strict=True)] for run in (measured, simulated)]
    )
    return measured, simulated, (lags + np.pi) % (2 * np.pi) - np.pi


def _other_physics(robot: RobotKit, study: Study) -> str:
    """Say in what a study simulates another robot than the kit's, if it does."""
    built, evolved = (physics.model_dump(mode="json") for physics in (robot.physics, study.settings.physics))
    other = [f"{name} {evolved[name]} (built: {built[name]})" for name in built if built[name] != evolved[name]]
    if not other:
        return ""
    listed = ", ".join(other)
    return f"study {study.name} promised it of robots with {listed}; a difference need not be the networks' error"


def _motion(time: Float64, position: Float64, angle: Float64, robot: RobotKit) -> RobotMotion:
    gaits = tuple(fit_gait(time, joint_angle, robot.frequency) for joint_angle in angle.T)
    speed = steady_speed(time, position[:, 0], 1 / robot.frequency)
    return RobotMotion(time, position[:, 0] - position[0, 0], position[:, 1], angle, speed, gaits)


def _simulated(
    robot: RobotKit, environment: Environment, physics: Physics, measured: RobotMotion, where: str
) -> tuple[RobotMotion, Float64]:
    """Simulate as long a run after settling, from the same phase of the gait on.

    Returns the first member's, and (n_members, n_steps) x of all [m].
    """
    step = physics.time_step * robot.time_scale
    n_steps = int(np.ceil((measured.time[-1] - measured.time[0]) / step)) + 1
    period = 1 / robot.frequency
    n_settle = robot.rollout.n_settle
    n_settle += round(((measured.time[0] - step * (n_settle + 1)) % period) / step)
    rollouts = simulate(robot.design, environment, n_settle=n_settle, n_measure=n_steps, trace=True, physics=physics)
    if rollouts.trace is None or not (rollouts.status == OK).all():
        raise RunError(f"its simulation {where} diverged, so there is nothing to compare with")
    trace = rollouts.trace.reshape(-1, *rollouts.trace.shape[-3:])[:, n_settle:].astype(np.float64)
    time = np.asarray(step * (n_settle + 1 + np.arange(n_steps)), dtype=np.float64)
    angles = {link: trace[0, :, link, Column.ANGLE] for link in range(N_LINKS)}
    angle = joint_angles(robot.design, robot.timeline.joints, angles)
    root = robot.scale * trace[:, :, 0, : Column.Y + 1]
    motion = _motion(time, root[0], angle, robot)
    x = root[:, :, Column.X]
    return motion, x - x[:, :1]


def _lines(comparison: RunComparison) -> list[str]:
    """Return what the terminal says of a comparison."""
    measured, simulated, turn = comparison.measured, comparison.simulated, 1000 / (2 * np.pi * comparison.kit.frequency)
    seconds = measured.time[-1] - measured.time[0]
    lines = [
        f"{comparison.kit.name}: {seconds:.1f} s of steady gait at {comparison.kit.frequency:.2f} Hz",
        f"path: {1000 * measured.x[-1]:+.0f} mm along the tank, simulated {1000 * simulated.x[-1]:+.0f} mm",
        f"mean height of the root over the water: {1000 * measured.y.mean():+z.0f} mm, simulated "
        f"{1000 * simulated.y.mean():+z.0f} mm",
        f"speed: {_mm(measured.speed)} mm/s, simulated {_mm(simulated.speed)} mm/s",
    ]
    if (promise := comparison.promise) is not None:
        lines.append(f"promised: {_mm(promise.mean)} mm/s, within {_mm(promise.low)} to {_mm(promise.high)}")
    if comparison.note:
        lines.append(f"note: {comparison.note}")
    lag = "lag behind the command" if comparison.start_known else "lag relative to the mean of the joints"
    for column, joint in enumerate(comparison.kit.timeline.joints):
        (real, expected), gait = comparison.lags[:, column], measured.gaits[column]
        lines.append(
            f"joint {joint}: ±{np.degrees(gait.amplitude):.0f}°, simulated "
            f"±{np.degrees(simulated.gaits[column].amplitude):.0f}°; {lag} {np.degrees(real):+z.0f}° "
            f"({turn * real:+z.0f} ms), simulated {np.degrees(expected):+z.0f}°"
        )
    return lines


def _mm(speed: float) -> str:
    """Write a speed [m/s] in mm/s."""
    return f"{1000 * speed:+z.1f}"
