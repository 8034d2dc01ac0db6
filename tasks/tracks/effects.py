"""Effects that thrown bars show and links in a model of state and medium do not: walls, the floor, and memory.

A bar that hits a wall of the tank bounces, and one at its floor rests: neither is a residual of the medium. A fluid
that is set in motion (added mass, a wake) pushes on a bar by what it did before, while residuals are learned from the
present state alone. Such effects are reported; rows at contacts are left out.

Added mass that depends on the state alone, as that of a free bar far below the surface, cannot be told from drag: the
networks learn it, and are wrong where joints pull on a link.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from tasks.arrays import Bools, Int64
from tasks.residual import MeasuredTransitions
from tasks.tracks.table import Paths, TrackError

_SLOWEST_CONTACT = 0.5  # speed before and after a contact [m/s]: drag turns no bar at that speed within a frame
_SD_OF_CONTACT = 6.0  # of the difference of two positions, that both speeds exceed
_FRAMES_AROUND = 2  # frames before and after a contact that are left out

_LAG = (6, 3.0)  # steps and frames, whichever is longer, over which the acceleration before a state is taken
_N_NEIGHBOURS = 12
_LEAST_ROWS = 500  # that the test of memory requires
_CLEAR = 0.25  # share of the residuals' deviation that their own uncertainty may be, for a row to be tested
_LEAST_MEMORY = 0.1  # share of the earlier acceleration that counts as an effect
_SD_OF_MEMORY = 5.0

_OF_FREE_FALL, _MORE_UP, _LEAST_UP = 0.1, 5, 0.02  # tolerance of free fall; how many more rows, and what share of all
_SD_OF_GRAVITY = 5.0  # deviations of the estimated fall
_GRAVITY_OFF = 0.15  # share of gravity by which the fall in air may differ


@dataclass(frozen=True, eq=False)
class Contacts:
    """Frames at which bars turn back at once; each (n_throws, n_frames)."""

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


def contacts(paths: Paths, position_sd: tuple[float, float]) -> Contacts:
    """Find where bars bounce: x turns back within a frame, or y turns from down to up.

    Drag never reverses a velocity, and buoyancy does so slowly.

    Args:
        paths: the throws.
        position_sd: deviations of measurements of x and y [m].

    Returns:
        The frames of contacts.
    """
    n_throws, n_frames = paths.time.shape
    interval = np.where(paths.seen[:, 1:], np.diff(paths.time, axis=1), np.inf)
    turned = []
    for axis, sd in enumerate(position_sd):
        velocity = np.diff(paths.pose[..., axis], axis=1) / interval
        fast = np.abs(velocity) > np.maximum(_SLOWEST_CONTACT, _SD_OF_CONTACT * np.sqrt(2) * sd / interval)
        before, after, both = velocity[:, :-1], velocity[:, 1:], fast[:, :-1] & fast[:, 1:]
        up, down = np.zeros((2, n_throws, n_frames), dtype=bool)
        up[:, 1:-1], down[:, 1:-1] = both & (before < 0) & (after > 0), both & (before > 0) & (after < 0)
        turned.append((up, down))
    (left, right), (floor, _) = turned
    return Contacts(left, right, floor)


@dataclass(frozen=True)
class Fall:
    """Acceleration of bars above the water."""

    n_rows: int
    acceleration: float  # upward [m/s²]; NaN if no bar is seen above the water
    sd: float


def refuse_upward_falls(transitions: MeasuredTransitions, gravity: float, time_step: float) -> None:
    """Refuse tracks in which bars fall freely upward and hardly ever down.

    Args:
        transitions: rows of all throws.
        gravity: [m/s²].
        time_step: of the simulation [s].

    Raises:
        TrackError: y grows downward.
    """
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
    fall = Fall(int(dry.sum()), mean / time_step - gravity, scatter / time_step)
    return fall


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
