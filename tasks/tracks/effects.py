"""Effects that thrown bars show and links in a model of state and medium do not: walls, the floor, and memory.

A bar that hits a wall of the tank bounces or stops, and one on its floor may rest: neither is a residual of the
medium. A fluid
that is set in motion (added mass, a wake) pushes on a bar by what it did before, while residuals are learned from the
present state alone. Such effects are reported; rows at contacts are left out.

Added mass that depends on the state alone, as that of a free bar far below the surface, cannot be told from drag: the
networks learn it, and are wrong where joints pull on a link.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from tasks.arrays import Bools, Float64, Int64
from tasks.residual import MeasuredTransitions
from tasks.tracks.table import Paths, TrackError

_SLOWEST_CONTACT = 0.5  # speed before and after a contact [m/s]: drag turns no bar at that speed within a frame
_SD_OF_CONTACT = 6.0  # of the difference of two positions, that both speeds exceed
_FRAMES_AROUND = 2  # frames before and after a contact that are left out
_AT_THE_EDGE = 0.1  # from where bars get farthest out or deepest, at which one may touch a wall or the floor [m]
_STOPPED = 0.2  # share of its speed that a bar keeps at most, where it stops
_LEAST_STOPS = 3  # bars that stop at a wall; one alone may have been stopped by drag
_MOST_STOPS_ELSEWHERE = 0.1  # share of the fast bars elsewhere that drag stops as soon
_REST_TIME, _REST_WAY = 1.0, 0.02  # a bar rests that moves by less in this time [s], [m]; buoyancy lifts it by more

_LAG = (6, 3.0)  # steps and frames, whichever is longer, over which the acceleration before a state is taken
_N_NEIGHBOURS = 12
_LEAST_ROWS = 500  # that the test of memory requires
_CLEAR = 0.25  # share of the residuals' deviation that their own uncertainty may be, for a row to be tested
_LEAST_MEMORY = 0.1  # share of the earlier acceleration that counts as an effect
_SD_OF_MEMORY = 5.0

_OF_FREE_FALL, _MORE_UP, _LEAST_UP = 0.1, 5, 0.02  # tolerance of free fall; how many more rows, and what share of all
_SD_OF_GRAVITY = 5.0  # deviations of the estimated fall
_GRAVITY_OFF = 0.15  # share of gravity by which the fall in air may differ
_MOST_GRAVITY_OFF = 1.5  # factor from which tracks are refused


@dataclass(frozen=True, eq=False)
class Contacts:
    """Frames at which bars touch a wall or the floor; each (n_throws, n_frames)."""

    left: Bools
    right: Bools
    floor: Bools

    @property
    def any(self) -> Bools:
        """Frames at a contact."""
        return self.left | self.right | self.floor

    @property
    def around(self) -> Bools:
        """Frames at a contact and beside it."""
        at = self.any
        near = at.copy()
        for shift in range(1, _FRAMES_AROUND + 1):
            near[:, shift:] |= at[:, :-shift]
            near[:, :-shift] |= at[:, shift:]
        return near


def n_contacts(at: Bools) -> int:
    """Return the number of contacts in (n_throws, n_frames) frames, each of which may last for several."""
    return int(np.count_nonzero(at[:, 1:] & ~at[:, :-1]) + np.count_nonzero(at[:, 0]))


def contacts(paths: Paths, long_axes: Float64, position_sd: tuple[float, float]) -> Contacts:
    """Find where bars bounce off a wall or the floor, stop at a wall, or rest on the floor.

    Args:
        paths: the throws.
        long_axes: (n_throws,) of their bars [m].
        position_sd: deviations of measurements of x and y [m].

    Returns:
        The frames of contacts.
    """
    x_sd, y_sd = position_sd
    left, right = _bounces(paths, 0, x_sd)
    floor, _ = _bounces(paths, 1, y_sd)
    reach_x, reach_y = _reach(paths, long_axes)
    left |= _stops(paths, -paths.pose[..., 0], reach_x, x_sd)
    right |= _stops(paths, paths.pose[..., 0], reach_x, x_sd)
    return Contacts(left, right, floor | _rests(paths, reach_y, max(position_sd)))


def _reach(paths: Paths, long_axes: Float64) -> tuple[Float64, Float64]:
    """Return how far each bar reaches from its centre along x and y; each (n_throws, n_frames) [m]."""
    sin, cos = np.abs(np.sin(paths.pose[..., 2])), np.abs(np.cos(paths.pose[..., 2]))
    length = long_axes[:, None]
    return (length * sin + cos / length) / 2, (length * cos + sin / length) / 2


def slowest_contact(frame_interval: float, position_sd: tuple[float, float]) -> float:
    """Return the speed below which a bar may touch a wall or the floor unnoticed [m/s].

    Args:
        frame_interval: typical interval between frames [s].
        position_sd: deviations of measurements of x and y [m].
    """
    return max(_SLOWEST_CONTACT, _SD_OF_CONTACT * float(np.sqrt(2)) * max(position_sd) / frame_interval)


def _velocity(paths: Paths, position: Float64, sd: float) -> tuple[Float64, Float64]:
    """Return the velocity in each interval between frames, and the least speed that counts as fast there [m/s]."""
    interval = np.where(paths.seen[:, 1:], np.diff(paths.time, axis=1), np.inf)
    return np.diff(position, axis=1) / interval, np.maximum(
        _SLOWEST_CONTACT, _SD_OF_CONTACT * np.sqrt(2) * sd / interval
    )


def _bounces(paths: Paths, axis: int, sd: float) -> tuple[Bools, Bools]:
    """Return the frames at which a coordinate turns upward, and downward, at once.

    Drag never reverses a velocity, and buoyancy does so slowly.
    """
    velocity, least = _velocity(paths, paths.pose[..., axis], sd)
    fast = np.abs(velocity) > least
    up, down = np.zeros((2, *paths.time.shape), dtype=bool)
    before, after, both = velocity[:, :-1], velocity[:, 1:], fast[:, :-1] & fast[:, 1:]
    up[:, 1:-1], down[:, 1:-1] = both & (before < 0) & (after > 0), both & (before > 0) & (after < 0)
    return up, down


def _stops(paths: Paths, outward: Float64, reach: Float64, sd: float) -> Bools:
    """Return the frames at which bars stop where no bar gets farther out.

    Drag, too, may stop a fast bar within a few frames. At a wall several bars stop at one place, and of those that are
    as fast elsewhere hardly any does.

    Args:
        paths: the throws.
        outward: (n_throws, n_frames) positions of the bars [m], growing towards the wall.
        reach: (n_throws, n_frames) of the bars from their centres [m].
        sd: deviation of a measurement [m].
    """
    edge = outward + reach
    velocity, least = _velocity(paths, outward, sd)
    # The bar may touch the wall between two frames: the intervals before and after it are compared.
    fast = (velocity > least)[:, :-2] & paths.seen[:, 3:]
    stops = fast & (velocity[:, 2:] < _STOPPED * velocity[:, :-2])
    near = edge[:, 2:-1] > edge[paths.seen].max() - _AT_THE_EDGE - _SD_OF_CONTACT * sd
    at = np.zeros(paths.time.shape, dtype=bool)
    n_elsewhere, n_stops_elsewhere = np.count_nonzero(fast & ~near), np.count_nonzero(stops & ~near)
    if (stops & near).any(axis=1).sum() >= _LEAST_STOPS and n_stops_elsewhere <= _MOST_STOPS_ELSEWHERE * n_elsewhere:
        at[:, 2:-1] = stops & near
    return at


def _rests(paths: Paths, reach: Float64, sd: float) -> Bools:
    """Return the frames in which bars below the surface lie still where no bar gets deeper: on the floor.

    Args:
        paths: the throws.
        reach: (n_throws, n_frames) of the bars from their centres along y [m].
        sd: deviation of a measurement [m].
    """
    n = max(round(_REST_TIME / float(np.median(np.diff(paths.time, axis=1)[paths.seen[:, 1:]]))), 2)  # intervals
    at = np.zeros(paths.time.shape, dtype=bool)
    if paths.time.shape[1] <= n:
        return at
    y, lower = paths.pose[..., 1], paths.pose[..., 1] - reach
    on_floor = (y + reach < 0) & (lower < lower[paths.seen].min() + _AT_THE_EDGE + _SD_OF_CONTACT * sd)
    ways = np.ptp(np.lib.stride_tricks.sliding_window_view(paths.pose[..., :2], n + 1, axis=1), axis=-1)
    still = on_floor[:, n:] & paths.seen[:, n:] & (ways < _REST_WAY + _SD_OF_CONTACT * sd).all(axis=-1)
    for shift in range(n + 1):
        at[:, shift : shift + still.shape[1]] |= still
    return at


@dataclass(frozen=True)
class Fall:
    """Acceleration of bars above the water."""

    n_rows: int
    acceleration: float  # upward [m/s²]; NaN if no bar is seen above the water
    sd: float


def check_falls(transitions: MeasuredTransitions, gravity: float, time_step: float) -> Fall:
    """Refuse tracks in which bars fall upward, or in air far faster or slower than bars do.

    Args:
        transitions: rows of all throws.
        gravity: [m/s²].
        time_step: of the simulation [s].

    Returns:
        The fall of bars in air.

    Raises:
        TrackError: y grows downward, or the scale or the clock is wrong.
    """
    _refuse_upward_falls(transitions, gravity, time_step)
    fall = fall_in_air(transitions, gravity, time_step)
    share = -fall.acceleration / gravity if gravity else 1.0
    if falls_oddly(fall, gravity) and not 1 / _MOST_GRAVITY_OFF < share < _MOST_GRAVITY_OFF:
        raise TrackError(
            f"bars above the water fall at {-fall.acceleration:.3g} ± {fall.sd:.2g} m/s² of simulation, expected "
            f"{gravity:g}: check tracks.length_unit, tracks.metres_per_metre, the scale of the calibration, the unit "
            f"of time, and the frame rate (slow motion is tracked with --slowdown)"
        )
    return fall


def _refuse_upward_falls(transitions: MeasuredTransitions, gravity: float, time_step: float) -> None:
    """Refuse tracks in which bars fall freely upward and hardly ever down: y grows downward."""
    a_x, a_y = transitions.residual[:, 3:5].T / time_step
    level = np.abs(a_x) < _OF_FREE_FALL * gravity
    up, down = (level & (np.abs(a_y - gravity + sign * gravity) < _OF_FREE_FALL * gravity) for sign in (-1, 1))
    if up.sum() > max(_MORE_UP * down.sum(), _LEAST_UP * len(up)):
        raise TrackError(
            f"throw {int(transitions.throw[np.argmax(up)])}, and others: bars fall freely upward: expected them to "
            f"fall down: check tracks.flip_y (does y grow downward, as pixels do?)"
        )


def fall_in_air(transitions: MeasuredTransitions, gravity: float, time_step: float) -> Fall:
    """Estimate the acceleration of bars whose corners are all above the water, from their residuals.

    Args:
        transitions: rows of all throws.
        gravity: [m/s²].
        time_step: of the simulation [s].

    Returns:
        The acceleration and its deviation over throws.
    """
    length = transitions.length_scale
    dry = transitions.state[:, 1] > np.hypot(length, 1 / length) / 2
    if not dry.any():
        return Fall(0, float("nan"), float("nan"))
    sd = transitions.residual_sd[dry, 4].astype(np.float64)
    weight = 1 / np.square(np.maximum(sd, 1e-9))
    mean = float(np.sum(weight * transitions.residual[dry, 4]) / weight.sum())
    n_throws = len(np.unique(transitions.throw[dry]))
    # The steps of a throw share their errors, so only throws count as independent.
    scatter = float(np.sqrt(np.sum(weight * np.square(transitions.residual[dry, 4] - mean)) / weight.sum() / n_throws))
    return Fall(int(dry.sum()), mean / time_step - gravity, scatter / time_step)


def falls_oddly(fall: Fall, gravity: float) -> bool:
    """Return whether bars in air fall otherwise than gravity says, so that the scale or the clock is off."""
    return fall.n_rows > 0 and abs(fall.acceleration + gravity) > max(_GRAVITY_OFF * gravity, _SD_OF_GRAVITY * fall.sd)


@dataclass(frozen=True)
class Memory:
    """Dependence of residuals on the acceleration before the present state."""

    n_rows: int  # rows that are tested; 0 if the tracks are too few or too noisy
    share: float  # of the acceleration over the steps before, in the residual acceleration; 0 for a medium of states
    sd: float

    @property
    def found(self) -> bool:
        """Whether the effect is large and beyond chance."""
        return self.n_rows > 0 and abs(self.share) > max(_LEAST_MEMORY, _SD_OF_MEMORY * self.sd)


def memory(transitions: MeasuredTransitions, time_step: float, frame_interval: float) -> Memory:
    """Compare the residuals of bars in the same state that accelerated differently before it.

    Each row below the surface is compared with its nearest neighbours in other throws. Within such a neighbourhood the
    residual is regressed on the state and on the acceleration over the steps before; of a medium that acts by the state
    alone, the acceleration explains nothing.

    Args:
        transitions: rows with their uncertainty.
        time_step: of the simulation [s].
        frame_interval: typical interval between frames [s]; what happens within one is interpolated.

    Returns:
        The dependence.
    """
    lag = max(_LAG[0], round(_LAG[1] * frame_interval / time_step))
    previous = _rows_before(transitions, lag)
    length = transitions.length_scale
    wet = transitions.state[:, 1] < -np.hypot(length, 1 / length) / 2
    spread = transitions.residual[wet, 3:5].std(axis=0) if wet.any() else np.zeros(2)
    clear = (transitions.residual_sd[:, 3:5] < _CLEAR * np.maximum(spread, 1e-12)).all(axis=1)
    rows = np.flatnonzero(wet & clear & (previous >= 0))
    if len(rows) < _LEAST_ROWS:
        return Memory(0, float("nan"), float("nan"))
    state, throw = transitions.state.astype(np.float64), transitions.throw[rows]
    before = (state[rows, 3:5] - state[previous[rows], 3:5]) / (lag * time_step)
    _, _, angle, vx, vy, omega = state[rows].T
    features = np.stack([length[rows], np.cos(angle), np.sin(angle), vx, vy, omega], axis=1)
    features /= np.maximum(features.std(axis=0), 1e-9)
    _, near = scipy.spatial.cKDTree(features).query(features, k=_N_NEIGHBOURS)
    residual = transitions.residual[rows, 3:5].astype(np.float64) / time_step
    slopes, weights = [], []
    for centre in range(0, len(rows), max(len(rows) // 2000, 1)):
        neighbours = near[centre]
        centred = [part[neighbours] - part[neighbours].mean(axis=0) for part in (features, before, residual)]
        explained, *_ = np.linalg.lstsq(centred[0][:, 3:], np.hstack(centred[1:]), rcond=None)
        left = np.hstack(centred[1:]) - centred[0][:, 3:] @ explained
        slopes.append(np.sum(left[:, :2] * left[:, 2:]))
        weights.append(np.sum(np.square(left[:, :2])))
    total = float(np.sum(weights))
    share = float(np.sum(slopes)) / max(total, 1e-12)
    n_throws = len(np.unique(throw))
    errors = np.array(slopes) - share * np.array(weights)
    sd = float(np.sqrt(np.sum(errors**2) * len(errors) / n_throws)) / max(total, 1e-12)
    return Memory(len(rows), share, sd)


def _rows_before(transitions: MeasuredTransitions, lag: int) -> Int64:
    """Return the row of the same throw ``lag`` steps before each row, or -1."""
    pairs = list(zip(transitions.throw.tolist(), transitions.step.tolist(), strict=True))
    row_of = {pair: row for row, pair in enumerate(pairs)}
    return np.array([row_of.get((throw, step - lag), -1) for throw, step in pairs], dtype=np.int64)
