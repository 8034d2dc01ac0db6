"""A table of tracks: checked, unwrapped and converted to the units and axes of the simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tasks.arrays import Bools, Float64, Int64, Labels
from tasks.bench.tracks.angles import folds, jumps
from tasks.bench.tracks.conventions import Tracks
from tasks.bench.tracks.repeats import repeated

MIN_FRAMES = 4  # of a throw: velocity and acceleration and one frame to judge them by
_MAX_SPEED = 60.0  # between two frames [m/s of simulation]; the paper's throws begin at up to 28
_MAX_TURN = 0.375  # between two frames, over the period of angles; half a period might have been either way
_MOVES = 3.0  # resolutions that a coordinate changes by between pictures of a bar that moves
_STILL = 0.05  # [m], [rad] within which bars stay that are at rest, in spite of the noise
_LEAST_FOLDS = 3  # of a file; one may be an impact
_AWAY = 10.0  # times the usual change of a path between frames, that a jump is at least
_LEAST_AWAY, _LEAST_TURN = (0.01, 0.05)  # [m of simulation], [rad]; less is no wrong frame
SLOWEST_CONTACT = 0.5  # speed before and after a contact [m/s]: drag turns no bar at that speed within a frame
_UNLIKE = 0.15  # share of the changes of velocity around it that a jump may leave unexplained
_LONGEST_THROW = 120.0  # [s] of the file
_MOST_TURNS = 4 * np.pi  # typical angle in radians at most; degrees exceed 2π, unless nearly every bar is upright


class TrackError(ValueError):
    """Tracks that can't be learned from; the message names the throw, the frame and what to do."""


@dataclass(frozen=True, eq=False)
class TrackTable:
    """Rows of a tracks file, in its units and order."""

    throw: Labels  # (n_rows,)
    time: Float64  # (n_rows,) [s]
    x: Float64
    y: Float64  # 0 at the waterline
    angle: Float64  # 0 where the long axis is upright
    x_sd: Float64 | None = None  # deviations of the measurements, if the file states them
    y_sd: Float64 | None = None
    angle_sd: Float64 | None = None


@dataclass(frozen=True, eq=False)
class Paths:
    """Throws in units and axes of the simulation, padded to the longest; axis 0 is the throw, axis 1 the frame."""

    throw: Labels  # (n_throws,)
    time: Float64  # (n_throws, n_frames) since the throw's first frame [s]; padding repeats the last
    pose: Float64  # (n_throws, n_frames, 3) x, y [m], angle, unwrapped [rad]; padding repeats the last
    sd: Float64 | None  # (n_throws, n_frames, 3) deviations of the measurements
    seen: Bools  # (n_throws, n_frames) False in padding
    n_repeated: int = 0  # frames that were dropped
    period: float = 2 * np.pi  # up to which angles are known: one turn, or half of one [rad]

    @property
    def number(self) -> Int64:
        """(n_throws,) numbers in data sets, which are the labels if those are numbers from 0 on."""
        numbers = np.arange(len(self.throw))
        return self.throw if np.issubdtype(self.throw.dtype, np.integer) and self.throw[0] >= 0 else numbers


def first(wrong: Bools) -> int | None:
    """Return the index of the first True, or None."""
    indices = np.flatnonzero(wrong)
    return int(indices[0]) if len(indices) else None


def paths_of(table: TrackTable, tracks: Tracks) -> Paths:
    """Check a table, drop repeated frames, unwrap angles, and convert it to the simulation.

    Throws may have gaps and uneven frames, and rows of different throws may alternate; within a throw, times increase.
    """
    _check_finite(table)
    _check_angles(table, tracks)
    labels = np.unique(table.throw)
    if len(labels) < 2:
        raise TrackError(f"{len(labels)} throws, expected at least 2: networks are tested on throws that are held out")
    of_rows = np.stack([table.x, table.y, table.angle], axis=1)
    moves = _MOVES * np.array([_resolution(column) for column in of_rows.T])
    every = [np.flatnonzero(table.throw == label) for label in labels]
    rows = [of_throw[~repeated(of_rows[of_throw], np.zeros(3), moves)] for of_throw in every]
    for label, throw_rows in zip(labels, rows, strict=True):
        _check_times(str(label), table.time[throw_rows])
    n_frames = max(map(len, rows))
    last = np.array([len(throw_rows) - 1 for throw_rows in rows])
    frame = np.minimum(np.arange(n_frames), last[:, None])
    at = np.stack([throw_rows[frame[k]] for k, throw_rows in enumerate(rows)])
    unit = tracks.simulated_unit
    scale = np.array([unit, unit, np.pi / 180 if tracks.angle_unit == "deg" else 1.0])
    sign = 1 - 2 * np.array([tracks.flip_x, tracks.flip_y, tracks.flip_angle])
    pose = of_rows[at] * (scale * sign)
    given = (table.x_sd, table.y_sd, table.angle_sd)
    stated = [deviation for deviation in given if deviation is not None]
    sd = np.stack(stated, axis=1)[at] * scale if len(stated) == len(given) else None
    time = (table.time[at] - table.time[at[:, :1]]) / tracks.time_scale
    n_repeated = len(of_rows) - sum(map(len, rows))
    paths = _unwrapped(Paths(labels, time, pose, sd, np.arange(n_frames) <= last[:, None], n_repeated))
    _check_moves(paths)
    _check_jumps(paths, tracks)
    return paths


def _resolution(values: Float64) -> float:
    """Return the least difference between values, but for rounding errors."""
    gaps = np.diff(np.unique(values))
    return float(np.min(gaps[gaps > 1e-9 * np.abs(values).max()], initial=np.inf))


def _unwrapped(paths: Paths) -> Paths:
    """Unwrap angles by whole turns, or by half turns if they are known up to those; refuse what tells less."""
    angle = np.unwrap(paths.pose[..., 2], axis=1)
    by_quarter, by_half = (jumps(paths.time, angle, paths.seen, by) for by in (np.pi / 2, np.pi))
    if len(at := np.argwhere(by_quarter)):
        raise TrackError(
            f"throw {paths.throw[at[0, 0]]}, frame {at[0, 1]}: the angle jumps by a quarter turn, and goes on as "
            f"before: expected that of the long axis: OpenCV's minAreaRect gives that of either side: add a quarter "
            f"turn where the width exceeds the height"
        )
    if len(at := np.argwhere(folds(angle, paths.seen))) >= _LEAST_FOLDS:
        raise TrackError(
            f"throw {paths.throw[at[0, 0]]}, frame {at[0, 1]}: the angle turns back as fast as it came, as in "
            f"{len(at) - 1} other places: expected angles with a sign: an absolute tilt, or an inverse sine or cosine, "
            f"does not tell to which side a bar leans"
        )
    period = np.pi if by_half.any() else 2 * np.pi
    pose = np.dstack([paths.pose[..., :2], np.unwrap(angle, axis=1, period=period)])
    return replace(paths, pose=pose, period=period)


def _check_moves(paths: Paths) -> None:
    """Refuse a throw in which nothing changes, and a file in which every bar stays where it is."""
    way = np.ptp(paths.pose, axis=1)
    if (k := first((way <= (_STILL if (way < _STILL).all() else 0.0)).all(axis=1))) is not None:
        raise TrackError(
            f"throw {paths.throw[k]}: the bar is at rest in all {paths.seen[k].sum()} frames, expected it to move: "
            f"leave the throw out, and see that the bar was tracked, and not what is behind it"
        )


def _check_finite(table: TrackTable) -> None:
    for name in ("time", "x", "y", "angle", "x_sd", "y_sd", "angle_sd"):
        values = getattr(table, name)
        if values is None:
            continue
        is_deviation = name.endswith("_sd")
        wrong = ~np.isfinite(values) | ((values <= 0) if is_deviation else False)
        if (row := first(wrong)) is not None:
            throw = table.throw[row]
            frame = int(np.count_nonzero(table.throw[:row] == throw))
            expected = "a number above 0" if is_deviation else "a number"
            raise TrackError(
                f"throw {throw}, frame {frame}: {name} is {values[row]:g}, expected {expected}: leave out frames in "
                f"which the bar was not seen"
            )


def _check_times(throw: str, time: Float64) -> None:
    if len(time) < MIN_FRAMES:
        raise TrackError(
            f"throw {throw} has {len(time)} frame{'s' * (len(time) != 1)}, expected at least {MIN_FRAMES}: leave the "
            f"throw out, or give all frames of a throw the same number"
        )
    if (k := first(np.diff(time) <= 0)) is not None:
        raise TrackError(
            f"throw {throw}, frame {k + 1}: the time is {time[k + 1]:.6g} s after {time[k]:.6g} s, expected a later "
            f"one: sort the frames, and give each throw a number of its own"
        )
    if time[-1] - time[0] > _LONGEST_THROW:
        raise TrackError(
            f"throw {throw} lasts for {time[-1] - time[0]:.4g} s, expected at most {_LONGEST_THROW:g} s: give times in "
            f"seconds, and each throw a number of its own"
        )


def _check_angles(table: TrackTable, tracks: Tracks) -> None:
    """Refuse angles in the other unit: bars turn, but seldom several times."""
    share, least, most = (0.9, 2 * np.pi, np.inf) if tracks.angle_unit == "deg" else (0.5, -1.0, _MOST_TURNS)
    typical = float(np.quantile(np.abs(table.angle), share))
    if not least < typical <= most:
        expected = f"more than {least:.3g}" if typical <= least else f"at most {most:.3g}"
        raise TrackError(
            f"{share:.0%} of the angles are at most {typical:.3g} {tracks.angle_unit}, expected {expected}: check "
            f"tracks.angle_unit (rad or deg), and give all throws in one unit"
        )


def _check_jumps(paths: Paths, tracks: Tracks) -> None:
    interval = np.diff(paths.time, axis=1)
    step = np.diff(paths.pose, axis=1)
    both = paths.seen[:, 1:]
    speed = np.hypot(step[..., 0], step[..., 1]) / np.where(both, interval, 1.0)
    if len(at := np.argwhere(both & (speed > _MAX_SPEED))):
        k, frame = at[0]
        to_bench = tracks.metres_per_metre / tracks.time_scale
        raise TrackError(
            f"throw {paths.throw[k]}, frame {frame + 1}: the bar jumps at {speed[k, frame] * to_bench:.3g} m/s of the "
            f"file, expected at most {_MAX_SPEED * to_bench:.3g} m/s: remove frames that were tracked wrongly, give "
            f"each throw a number of its own, and check tracks.length_unit and the unit of time"
        )
    _check_frames_apart(paths, tracks)
    turn = np.abs(step[..., 2])
    if len(at := np.argwhere(both & (turn > _MAX_TURN * paths.period))):
        k, frame = at[0]
        raise TrackError(
            f"throw {paths.throw[k]}, frame {frame + 1}: the bar turns by {turn[k, frame]:.3g} rad since the frame "
            f"before, expected at most {_MAX_TURN * paths.period:.3g}, or it might have turned the other way: remove "
            f"frames that were tracked wrongly, film more frames a second, split the throw at a gap, and check "
            f"tracks.angle_unit (rad or deg)"
        )


def _check_frames_apart(paths: Paths, tracks: Tracks) -> None:
    """Refuse a frame in which a bar is elsewhere than its path leads, and returns in the next.

    A frame that is off by d changes the velocity by d / h before it, by - d / h - d / h' at it and by d / h' after it,
    where h and h' are the intervals before and after. A bar that hits a floor or a wall may do the same, but comes down
    and leaves upward, or its horizontal velocity is reversed, which no fluid does at once.
    """
    if paths.pose.shape[1] < MIN_FRAMES + 1:
        return
    interval = np.where(paths.seen[:, 1:], np.diff(paths.time, axis=1), 1.0)
    before, after = 1 / interval[:, 1:-2], 1 / interval[:, 2:-1]  # of the frames 2 to n - 3
    template = np.stack([before, -before - after, after], axis=-1)[:, :, None]
    motion = np.diff(paths.pose[..., :2], axis=1) / interval[..., None]
    into, out = motion[:, :-3], motion[:, 3:]
    reversed_ = (into * out < 0) & (np.abs(into) > SLOWEST_CONTACT)
    bounces = reversed_[..., 0] | (reversed_[..., 1] & (into[..., 1] < 0))
    for verb, axes, least, size, symbol in (
        ("jumps", slice(2), _LEAST_AWAY, tracks.simulated_unit, f" {tracks.length_unit}"),
        ("turns", slice(2, 3), _LEAST_TURN, np.pi / 180, "°"),
    ):
        velocity = np.diff(paths.pose[..., axes], axis=1) / interval[..., None]
        change = np.diff(velocity, axis=1)  # at the frames 1 to n - 2
        usual = float(np.median((np.linalg.norm(change, axis=-1) * interval[:, 1:])[paths.seen[:, 2:]]))
        around = np.lib.stride_tricks.sliding_window_view(change, 3, axis=1)  # (n_throws, n_windows, n axes, 3)
        off = (around * template).sum(axis=-1, keepdims=True) / np.square(template).sum(axis=-1, keepdims=True)
        unlike = np.square(around - off * template).sum(axis=(2, 3))
        distance = np.linalg.norm(off[..., 0], axis=-1)
        alike = unlike < _UNLIKE * np.square(around).sum(axis=(2, 3))
        far = (distance > max(_AWAY * usual, least)) & alike & ~bounces & paths.seen[:, 4:]
        if far.any():
            k, window = np.argwhere(far)[0]
            raise TrackError(
                f"throw {paths.throw[k]}, frame {window + 2}: the bar {verb} by "
                f"{distance[k, window] / size:.3g}{symbol} and back: remove frames that were tracked wrongly"
            )
