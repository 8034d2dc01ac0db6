"""From tracked paths to the transitions that networks learn from, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tasks.arrays import Bools, Float64
from tasks.bench.tracks.bars import Bars, TrackedBarError, length_scales
from tasks.bench.tracks.conventions import Tracks
from tasks.bench.tracks.free_fall import Fall, check_falls
from tasks.bench.tracks.smoother import Measured, Smoothed, smooth
from tasks.bench.tracks.table import Paths, TrackError, TrackTable, paths_of
from tasks.bench.tracks.tank_contacts import contacts, n_contacts
from tasks.bench.tracks.unseen import Unseen, errors_on
from tasks.residual import MeasuredTransitions, robot_ranges, simulate_throws
from tasks.residual.throws import Starts, even_starts, precision_weights
from tasks.seeding import generator
from tasks.simulation.free_links import FreeLinks
from tasks.world import Medium, Physics

N_FOLDS = 4  # fits of a medium, each to all throws but its share
_N_FURTHER = 256  # throws in the fitted medium
_NEAR = 3  # intervals before and after a contact, whose steps are left out
_LONGEST_GAP = 4.0  # typical intervals between a throw's frames; steps in a longer gap are left out


@dataclass(frozen=True)
class TrackReport:
    """What the tracks are like, in units of the simulation."""

    n_throws: int
    n_frames: int
    frame_interval: float  # median [s]
    n_gaps: int  # intervals longer than the steps inside them are worth
    n_rows_in_gaps: int  # transitions left out
    noise: tuple[float, float, float]  # deviations of measurements of x, y [m] and the angle [rad]
    sd_given: bool  # whether the file states them; they are estimated otherwise
    n_contacts: int  # with the walls and the floor
    n_rows_at_contacts: int  # transitions left out
    fall: Fall
    n_repeated: int  # frames that were dropped, because they repeat the one before
    angle_period: float  # up to which angles are known [rad]
    unseen: Unseen | None = None  # errors of the fitted medium on the throws held out of the fit


@dataclass(frozen=True, eq=False)
class SmoothedThrows:
    """What smoothed poses alone say of the throws, which underestimates what dies out between two frames."""

    paths: Paths
    long_axes: Float64  # (n_throws,) of their bars [m]
    time: Float64  # (n_throws, n_steps + 1) of the simulation's steps [s]; padding repeats the last
    begins: Bools  # (n_throws, n_frames) frames that do not follow from those before: the first, after gaps, at walls
    usable: Bools  # (n_throws, n_steps) steps outside gaps and away from contacts
    transitions: MeasuredTransitions
    report: TrackReport


def check_throws(table: TrackTable, bars: Bars, tracks: Tracks, physics: Physics) -> Paths:
    """Return the throws in the simulation's units, if networks can learn from them.

    Raises TrackError if something is wrong with a throw or a bar, or with how bars fall, or if no bar gets wet.
    """
    paths = smooth_throws(table, bars, tracks, physics).paths
    lowest = float(paths.pose[..., 1].min())
    if lowest > 0:
        raise TrackError(
            f"no bar's centre is ever below the waterline, y = 0 (lowest: {lowest * tracks.metres_per_metre:.3g} m): "
            f"there is no water to learn from: check that y is 0 at the waterline"
        )
    return paths


def residual_transitions(
    table: TrackTable, bars: Bars, tracks: Tracks, physics: Physics, *, fold: int = 0, n_iterations: int = 200
) -> tuple[MeasuredTransitions, TrackReport]:
    """Smooth tracked throws, and compare each step of the simulator's clock with the base simulator's.

    A model of the medium is fitted in n_iterations to the poses of all throws but those of a fold, and what its
    rollouts leave is smoothed. E(x) is then the velocity one step later, E'(x) the base simulator's step from the same
    state; positions follow by integration, as in the simulation. Throws in the fitted medium, whose numbers are
    negative, are added.

    Returns:
        MeasuredTransitions with their uncertainty, ordered by throw and step, and what the tracks are like.
    """
    first = smooth_throws(table, bars, tracks, physics)
    usable = np.flatnonzero(first.usable.any(axis=1))
    chosen = generator(0, "folds").permutation(usable)[fold % len(usable) :: N_FOLDS]
    held_out = np.isin(np.arange(len(first.usable)), chosen)
    medium, smoothed, in_range, persists = _rolled_out(first, held_out, physics, n_iterations)
    tracked = _transitions(first.paths, first.long_axes, smoothed, physics, first.usable & in_range, held_out)
    unseen = tracked[tracked.held_out]
    report = replace(first.report, noise=_noise(smoothed), unseen=errors_on(unseen, medium, physics, persists))
    return MeasuredTransitions.concatenate([tracked, _thrown_further(medium, unseen, physics, fold)]), report


def smooth_throws(table: TrackTable, bars: Bars, tracks: Tracks, physics: Physics) -> SmoothedThrows:
    """Check throws, smooth their poses, and compare each step with the base simulator's.

    Raises TrackError if something is wrong with a throw or a bar, or with how bars fall.
    """
    of_bars = length_scales(bars, tracks)
    paths = paths_of(table, tracks)
    if missing := [throw for throw in map(str, paths.throw) if throw not in of_bars]:
        raise TrackedBarError(f"throw {missing[0]} has no bar: give its length, width and mass")
    long_axes, dt = np.array([of_bars[throw] for throw in map(str, paths.throw)]), physics.time_step
    n_steps = np.floor(paths.time[:, -1] / dt + 1e-6).astype(int)
    if (n_steps < 1).any():
        throw = paths.throw[np.argmin(n_steps)]
        raise TrackError(f"throw {throw} is shorter than a step, {dt:.3g} s of simulation: leave it out")
    step = np.minimum(np.arange(n_steps.max() + 1), n_steps[:, None])
    time = np.minimum(step * dt, paths.time[:, -1:])
    smoothed = _smoothed(paths, paths.pose, time)
    at = contacts(paths, long_axes, _noise(smoothed)[:2])

    real = np.arange(n_steps.max()) < n_steps[:, None]
    gap, last = _gaps(paths), paths.time.shape[1] - 1
    in_gap = _inside(paths, [(throw, frame, frame + 1) for throw, frame in np.argwhere(gap)], time)
    near = [(throw, max(frame - _NEAR, 0), min(frame + _NEAR, last)) for throw, frame in np.argwhere(at)]
    at_contact = _inside(paths, near, time)
    usable = real & ~in_gap & ~at_contact
    if usable.any(axis=1).sum() < 2:  # one to fit, one held out
        raise TrackError("every step is in a gap between frames or at a wall or the floor: film throws in open water")
    transitions = _transitions(paths, long_axes, smoothed, physics, usable, np.zeros(len(usable), dtype=bool))
    report = TrackReport(
        n_throws=len(paths.throw),
        n_frames=int(paths.seen.sum()),
        frame_interval=float(np.median(np.diff(paths.time, axis=1)[paths.seen[:, 1:]])),
        n_gaps=int(gap.sum()),
        n_rows_in_gaps=int((real & in_gap).sum()),
        noise=_noise(smoothed),
        sd_given=paths.sd is not None,
        n_contacts=n_contacts(at),
        n_rows_at_contacts=int((real & at_contact & ~in_gap).sum()),
        fall=check_falls(transitions, paths.throw[np.nonzero(usable)[0]], physics.gravity, dt),
        n_repeated=paths.n_repeated,
        angle_period=paths.period,
    )
    begins = at.copy()
    begins[:, 0] = True
    begins[:, 1:] |= gap
    return SmoothedThrows(paths, long_axes, time, begins & paths.seen, usable, transitions, report)


def _smoothed(paths: Paths, pose: Float64, time: Float64) -> list[Smoothed]:
    """Smooth each coordinate of (n_throws, n_frames, 3) poses."""
    sds = [None] * 3 if paths.sd is None else [paths.sd[..., axis] for axis in range(3)]
    return [smooth(Measured(paths.time, pose[..., axis], paths.seen, sds[axis]), time) for axis in range(3)]


def _rolled_out(
    first: SmoothedThrows, held_out: Bools, physics: Physics, n_iterations: int
) -> tuple[Medium, list[Smoothed], Bools, float]:
    """Fit a model of the medium, roll the throws out, and smooth by how much the poses seen differ from them.

    Returns the model, which has not seen the throws that are held out, the states, which of the (n_throws, n_steps)
    steps begin no faster than smoothed poses ever do, because drag soon hides how fast a bar was before its first
    frame, and how far the errors of successive frames of the throws held out are alike.
    """
    from tasks.residual.rollouts import SeenPaths, fit_medium, follow, persistence  # imports torch

    paths = first.paths
    at_frames = _smoothed(paths, paths.pose, paths.time)
    seen = SeenPaths(
        time=paths.time,
        pose=paths.pose,
        sd=np.broadcast_to(_noise(at_frames), paths.pose.shape) if paths.sd is None else paths.sd,
        velocity=np.stack([coordinate.mean[..., 1] for coordinate in at_frames], axis=-1),
        seen=paths.seen,
        begins=first.begins,
        length_scale=first.long_axes,
    )
    model = fit_medium(seen[~held_out], physics, n_iterations=n_iterations)
    pose, velocity = follow(model, seen, np.concatenate([paths.time, first.time], axis=1), physics)
    n_frames = paths.time.shape[1]
    smoothed = _smoothed(paths, paths.pose - pose[:, :n_frames], first.time)
    for axis, coordinate in enumerate(smoothed):
        coordinate.mean[..., 0] += pose[:, n_frames:, axis]
        coordinate.mean[..., 1] += velocity[:, n_frames:, axis]
    fastest = np.abs(first.transitions.state[:, 3:]).max(axis=0)
    velocity = np.stack([coordinate.mean[:, :-1, 1] for coordinate in smoothed], axis=-1)
    in_range = (np.abs(velocity) <= fastest).all(axis=-1)
    return model, smoothed, in_range, persistence(model, seen[held_out], physics)


def _thrown_further(medium: Medium, unseen: MeasuredTransitions, physics: Physics, fold: int) -> MeasuredTransitions:
    """Simulate throws in the fitted medium, evenly over the states of robots, where few bars were thrown.

    Their residuals are as uncertain as the medium is wrong about those of throws that it has not seen.
    """
    starts = even_starts(_N_FURTHER, physics, generator(0, "throws in the fitted medium", fold))
    starts = Starts(-1 - starts.throw, starts.length_scale, starts.state)
    further = simulate_throws(starts, robot_ranges(physics).n_steps, medium, physics)
    wrong_by = FreeLinks(unseen.length_scale, physics).step(unseen.state, medium) - unseen.next_in_target
    weights = precision_weights(unseen.residual, unseen.residual_sd)
    sd = np.sqrt(np.average(np.square(wrong_by), axis=0, weights=weights)).astype(np.float32)
    never = np.zeros(len(further), dtype=bool)
    return MeasuredTransitions(**further.columns(), residual_sd=np.tile(sd, (len(further), 1)), held_out=never)


def _noise(smoothed: list[Smoothed]) -> tuple[float, float, float]:
    return smoothed[0].noise, smoothed[1].noise, smoothed[2].noise


def _gaps(paths: Paths) -> Bools:
    """Return which of the (n_throws, n_frames - 1) intervals are long for their throw, which one camera filmed."""
    interval = np.where(paths.seen[:, 1:], np.diff(paths.time, axis=1), np.nan)
    return np.asarray(interval > _LONGEST_GAP * np.nanmedian(interval, axis=1, keepdims=True))


def _inside(paths: Paths, spans: list[tuple[int, int, int]], time: Float64) -> Bools:
    """Return which of the steps between (n_throws, n_steps + 1) times touch spans of a throw from frame to frame."""
    inside = np.zeros((len(time), time.shape[1] - 1), dtype=bool)
    for throw, begin, end in spans:
        inside[throw] |= (time[throw, 1:] > paths.time[throw, begin]) & (time[throw, :-1] < paths.time[throw, end])
    return inside


def _transitions(
    paths: Paths, long_axes: Float64, smoothed: list[Smoothed], physics: Physics, chosen: Bools, held_out: Bools
) -> MeasuredTransitions:
    """Return the chosen (n_throws, n_steps) steps, each with the state before it."""
    # (n_throws, n_times, 3 coordinates, 3 derivatives)
    mean = np.stack([coordinate.mean for coordinate in smoothed], axis=-2)
    now, after = mean[:, :-1], mean[:, 1:]
    throw, step = np.nonzero(chosen)
    state = np.concatenate([now[..., 0], now[..., 1]], axis=-1)[chosen].astype(np.float32)
    dry = FreeLinks(long_axes[throw], physics).step(state, None)
    velocity = after[..., 1][chosen].astype(np.float32)
    dt = np.float32(physics.time_step)
    reached = np.concatenate([state[:, :3] + dt * velocity, velocity], axis=1)
    variance = np.stack([_variance_of_change(coordinate) for coordinate in smoothed], axis=-1)[chosen]
    sd = np.sqrt(np.maximum(variance, 0.0)).astype(np.float32)
    return MeasuredTransitions(
        throw=paths.number[throw],
        step=step,
        length_scale=long_axes[throw],
        state=state,
        next_in_target=reached,
        next_on_dry_land=dry,
        residual=reached - dry,
        residual_sd=np.concatenate([dt * sd, sd], axis=1),
        held_out=held_out[throw],
    )


def _variance_of_change(coordinate: Smoothed) -> Float64:
    """Return the (n_throws, n_steps) variance of the difference of two successive velocities."""
    velocity = coordinate.covariance[..., 1, 1]
    return velocity[:, :-1] + velocity[:, 1:] - 2 * coordinate.with_next[:, :-1, 1, 1]
