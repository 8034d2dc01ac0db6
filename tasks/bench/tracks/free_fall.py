"""How bars fall in air, which tells whether the scale, the clock, the vertical axis and the waterline are right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.arrays import Bools, Labels
from tasks.bench.tracks.table import TrackError
from tasks.residual import MeasuredTransitions

_OF_FREE_FALL, _MORE_UP, _LEAST_UP = 0.1, 5, 0.02  # tolerance of free fall; how many more rows, and what share of all
_SD_OF_GRAVITY = 5.0  # deviations of the estimated fall
_GRAVITY_OFF = 0.15  # share of gravity by which the fall in air may differ
_LEAST_FALLING, _LEAST_SHARE_FALLING = 10, 0.05  # rows just below the surface, and share of them, that fall as in air
_MOST_GRAVITY_OFF = 1.5  # factor from which tracks are refused
_LEAST_PIECE = 5  # steps in air whose fall is compared with that of the others
_LEAST_SHARE_OFF = 0.1  # of the steps in air, that fall at another speed
_MOSTLY = 0.7  # share of the steps at another speed that fall alike
_PIECE_OFF = 0.4  # share of gravity by which it may differ; half the speed falls at a quarter


@dataclass(frozen=True)
class Fall:
    """Acceleration of bars above the water."""

    n_rows: int
    acceleration: float  # upward [m/s²]; NaN if no bar is seen above the water
    sd: float


def check_falls(transitions: MeasuredTransitions, labels: Labels, gravity: float, time_step: float) -> Fall:
    """Return the fall of bars in air. Raises TrackError if y grows downward, or the waterline, scale or clock is wrong.

    Bars that fall below the surface as in air tell a waterline that is too high, because drag and buoyancy both hold up
    a bar that sinks. One that is too high by less than a bar's length goes unnoticed. ``labels`` are those of the
    transitions' throws.
    """
    a_x, a_y = transitions.residual[:, 3:5].T / time_step
    level = np.abs(a_x) < _OF_FREE_FALL * gravity
    up, down = (level & (np.abs(a_y - gravity + sign * gravity) < _OF_FREE_FALL * gravity) for sign in (-1, 1))
    if up.sum() > max(_MORE_UP * down.sum(), _LEAST_UP * len(up)):
        raise TrackError(
            f"throw {labels[np.argmax(up)]}, and others: bars fall freely upward: expected them to "
            f"fall down: check tracks.flip_y (does y grow downward, as pixels do?)"
        )
    _, y, _, _, vy, _ = transitions.state.T
    reach = np.hypot(transitions.length_scale, 1 / transitions.length_scale) / 2
    sinks = (y < -reach) & (y > -1.5 * reach) & (vy < 0)
    free = sinks & (np.hypot(a_x, a_y) < _OF_FREE_FALL * gravity)
    if free.sum() > max(_LEAST_FALLING, _LEAST_SHARE_FALLING * sinks.sum()):
        raise TrackError(
            f"throw {labels[np.argmax(free)]}, and others: bars fall freely below y = 0: expected the "
            f"water to hold them up: check that y is 0 at the waterline"
        )
    _check_speed_ramps(transitions, labels, gravity, time_step)
    fall = _fall_in_air(transitions, gravity, time_step)
    share = -fall.acceleration / gravity if gravity else 1.0
    if falls_oddly(fall, gravity) and not 1 / _MOST_GRAVITY_OFF < share < _MOST_GRAVITY_OFF:
        raise TrackError(
            f"bars above the water fall at {-fall.acceleration:.3g} ± {fall.sd:.2g} m/s² of simulation, expected "
            f"{gravity:g}: check tracks.length_unit, tracks.metres_per_metre, the scale of the calibration, the unit "
            f"of time, the frame rate (slow motion is tracked with --slowdown), and that y is 0 at the waterline"
        )
    return fall


def _in_air(transitions: MeasuredTransitions) -> Bools:
    """Return the transitions of bars whose corners are all above the water."""
    length = transitions.length_scale
    return np.asarray(transitions.state[:, 1] > np.hypot(length, 1 / length) / 2)


def _check_speed_ramps(transitions: MeasuredTransitions, labels: Labels, gravity: float, time_step: float) -> None:
    """Refuse a file in which some throws, or parts of them, fall far faster or slower than the others in air.

    Phones export slow motion with ends at normal speed: time is then stretched in parts of a file alone, and the fall
    there differs by the square of the factor.
    """
    dry = np.flatnonzero(_in_air(transitions))
    throw, step = transitions.throw[dry], transitions.step[dry]
    ends = np.flatnonzero((np.diff(throw) != 0) | (np.diff(step) != 1)) + 1
    flights = [flight for flight in np.split(dry, ends) if len(flight) >= _LEAST_PIECE]
    pieces = [piece for flight in flights for piece in np.array_split(flight, len(flight) // _LEAST_PIECE)]
    x, y = ([transitions.residual[piece, axis] / time_step for piece in pieces] for axis in (3, 4))
    falls = np.array([gravity - piece.mean() for piece in y])
    sd = np.array([np.median(transitions.residual_sd[piece, 4]) / time_step for piece in pieces])
    # In air a bar falls evenly and straight; what water does to one, where the waterline is wrong, is neither.
    least = _OF_FREE_FALL * np.abs(falls) + _SD_OF_GRAVITY * sd
    uneven = np.array([max(np.ptp(up), np.abs(aside).max()) for up, aside in zip(y, x, strict=True)])
    free = (uneven < least) & (falls > _SD_OF_GRAVITY * sd)
    usual = float(np.median(falls[free])) if free.any() else gravity
    off = free & (np.abs(falls - usual) > np.maximum(_PIECE_OFF * usual, _SD_OF_GRAVITY * sd))
    others = falls[off]  # those at another speed of the video are alike
    is_second_speed = len(others) > max(2, _LEAST_SHARE_OFF * free.sum())
    if is_second_speed and np.mean(np.abs(np.log(others / np.median(others))) < _PIECE_OFF) > _MOSTLY:
        k = int(np.argmax(off))
        raise TrackError(
            f"throw {labels[pieces[k][0]]}, and others: bars fall at {falls[k]:.2g} m/s² of "
            f"simulation in air, and at {usual:.2g} (median) elsewhere in the file: expected one speed of the video "
            f"throughout: export slow motion without its ends at normal speed, or cut them off, and use --slowdown; "
            f"where the speed is right, check that y is 0 at the waterline"
        )


def _fall_in_air(transitions: MeasuredTransitions, gravity: float, time_step: float) -> Fall:
    """Estimate the acceleration of bars whose corners are all above the water, from their residuals."""
    dry = _in_air(transitions)
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
