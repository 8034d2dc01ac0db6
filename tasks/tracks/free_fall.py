"""How bars fall in air, which tells whether the scale, the clock, the vertical axis and the waterline are right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.residual import MeasuredTransitions
from tasks.tracks.table import TrackError

_OF_FREE_FALL, _MORE_UP, _LEAST_UP = 0.1, 5, 0.02  # tolerance of free fall; how many more rows, and what share of all
_SD_OF_GRAVITY = 5.0  # deviations of the estimated fall
_GRAVITY_OFF = 0.15  # share of gravity by which the fall in air may differ
_LEAST_FALLING, _LEAST_SHARE_FALLING = 10, 0.05  # rows just below the surface, and share of them, that fall as in air
_MOST_GRAVITY_OFF = 1.5  # factor from which tracks are refused


@dataclass(frozen=True)
class Fall:
    """Acceleration of bars above the water."""

    n_rows: int
    acceleration: float  # upward [m/s²]; NaN if no bar is seen above the water
    sd: float


def check_falls(transitions: MeasuredTransitions, gravity: float, time_step: float) -> Fall:
    """Return the fall of bars in air. Raises TrackError if y grows downward, or the waterline, scale or clock is wrong.

    Bars that fall below the surface as in air tell a waterline that is too high, because drag and buoyancy both hold up
    a bar that sinks. One that is too high by less than a bar's length goes unnoticed.
    """
    a_x, a_y = transitions.residual[:, 3:5].T / time_step
    level = np.abs(a_x) < _OF_FREE_FALL * gravity
    up, down = (level & (np.abs(a_y - gravity + sign * gravity) < _OF_FREE_FALL * gravity) for sign in (-1, 1))
    if up.sum() > max(_MORE_UP * down.sum(), _LEAST_UP * len(up)):
        raise TrackError(
            f"throw {int(transitions.throw[np.argmax(up)])}, and others: bars fall freely upward: expected them to "
            f"fall down: check tracks.flip_y (does y grow downward, as pixels do?)"
        )
    _, y, _, _, vy, _ = transitions.state.T
    reach = np.hypot(transitions.length_scale, 1 / transitions.length_scale) / 2
    sinks = (y < -reach) & (y > -1.5 * reach) & (vy < 0)
    free = sinks & (np.hypot(a_x, a_y) < _OF_FREE_FALL * gravity)
    if free.sum() > max(_LEAST_FALLING, _LEAST_SHARE_FALLING * sinks.sum()):
        raise TrackError(
            f"throw {int(transitions.throw[np.argmax(free)])}, and others: bars fall freely below y = 0: expected the "
            f"water to hold them up: check that y is 0 at the waterline"
        )
    fall = _fall_in_air(transitions, gravity, time_step)
    share = -fall.acceleration / gravity if gravity else 1.0
    if falls_oddly(fall, gravity) and not 1 / _MOST_GRAVITY_OFF < share < _MOST_GRAVITY_OFF:
        raise TrackError(
            f"bars above the water fall at {-fall.acceleration:.3g} ± {fall.sd:.2g} m/s² of simulation, expected "
            f"{gravity:g}: check tracks.length_unit, tracks.metres_per_metre, the scale of the calibration, the unit "
            f"of time, the frame rate (slow motion is tracked with --slowdown), and that y is 0 at the waterline"
        )
    return fall


def _fall_in_air(transitions: MeasuredTransitions, gravity: float, time_step: float) -> Fall:
    """Estimate the acceleration of bars whose corners are all above the water, from their residuals."""
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
