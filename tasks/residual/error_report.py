"""Errors of a network by component and speed.

The first steps of fast throws contain most of the residuals' variance, so R² over all rows says little about a robot,
which moves slowly. At low speed, a small mean error is a thrust that does not exist, and evolution exploits it.
"""

import math
from dataclasses import dataclass

import numpy as np

from tasks.arrays import Floats
from tasks.residual.throws import STATE, Transitions
from tasks.simulation.free_links import FreeLinks
from tasks.world import Medium, Physics

BANDS = (
    ("all", 0.0, math.inf),
    ("< 0.5", 0.0, 0.5),
    ("0.5-2", 0.5, 2.0),
    ("2-10", 2.0, 10.0),
    ("> 10", 10.0, math.inf),
)
"""Name and range low <= |v| < high of each speed band [m/s]."""
WHOLE_THROWS = "whole throws"  # in place of a band


@dataclass(frozen=True)
class ErrorRow:
    """Errors of one component of the residual in one speed band.

    Errors are predicted - true residuals of a step, in the component's unit [m, rad, m/s, rad/s]. Figures that do not
    exist (no rows, or a true residual without variance) are NaN.
    """

    component: str  # one of STATE, or "pose" of whole throws
    band: str  # one of BANDS, or WHOLE_THROWS
    n_rows: int  # transitions in the band
    rmse: float
    bias: float  # mean error
    relative_error: float  # rmse divided by the root mean square of the true residual; predicting 0 scores 1
    r2: float  # share of the variance explained; predicting the mean scores 0


def error_rows(predicted: Floats, true: Floats, speed: Floats) -> tuple[ErrorRow, ...]:
    """Return the errors of predicted residuals by speed band and component.

    Args:
        predicted: (n_rows, 6) predicted residuals in the order of STATE, or (n_rows, 3) of the velocities alone.
        true: (n_rows, 6) or (n_rows, 3) true residuals.
        speed: (n_rows,) |v| at the start of the step [m/s].
    """
    true = true.astype(np.float64)  # because a bias is a small difference of large sums
    error = predicted.astype(np.float64) - true
    within = {band: (low <= speed) & (speed < high) for band, low, high in BANDS}
    return tuple(
        _error_row(component, band, error[inside, i], true[inside, i])
        for band, inside in within.items()
        for i, component in enumerate(STATE[-true.shape[1] :])
    )


def whole_throws(medium: Medium, throws: Transitions, physics: Physics) -> ErrorRow:
    """Roll throws out from their first states, and return the errors of their poses where they end.

    Errors of x, y and angle are shares of the way: a bar that stays put scores 1. A throw begins anew where steps are
    left out.
    """
    begins = np.flatnonzero((np.diff(throws.throw, prepend=-1) != 0) | (np.diff(throws.step, prepend=-1) != 1))
    n_steps = np.diff(begins, append=len(throws))
    links, now = FreeLinks(throws.length_scale[begins], physics), throws.state[begins]
    start, end, seen = now[:, :3], now[:, :3].copy(), throws.next_in_target[begins + n_steps - 1, :3]
    for step in range(1, n_steps.max(initial=0) + 1):
        now = links.step(now, medium)
        end[n_steps == step] = now[n_steps == step, :3]
    error, way = (end - seen).astype(np.float64), (seen - start).astype(np.float64)
    unit = np.sqrt(np.mean(way**2, axis=0))
    return _error_row("pose", WHOLE_THROWS, error / unit, way / unit)


def _error_row(component: str, band: str, error: Floats, true: Floats) -> ErrorRow:
    n = len(error)
    if n == 0:
        return ErrorRow(component, band, 0, math.nan, math.nan, math.nan, math.nan)
    mse, mean_square, variance = float(np.mean(error**2)), float(np.mean(true**2)), float(np.var(true))
    return ErrorRow(
        component=component,
        band=band,
        n_rows=n,
        rmse=math.sqrt(mse),
        bias=float(np.mean(error)),
        relative_error=math.sqrt(mse / mean_square) if mean_square > 0 else math.nan,
        r2=1 - mse / variance if variance > 0 else math.nan,
    )
