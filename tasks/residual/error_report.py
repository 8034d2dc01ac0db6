"""Errors of a network by component and speed.

The first steps of fast throws contain most of the residuals' variance, so R² over all rows says little about a robot,
which moves slowly. At low speed, a small mean error is a thrust that does not exist, and evolution exploits it.
"""

import math
from dataclasses import dataclass

import numpy as np

from tasks.arrays import Floats
from tasks.residual.throws import STATE

BANDS = (
    ("all", 0.0, math.inf),
    ("< 0.5", 0.0, 0.5),
    ("0.5-2", 0.5, 2.0),
    ("2-10", 2.0, 10.0),
    ("> 10", 10.0, math.inf),
)
"""Name and range low <= |v| < high of each speed band [m/s]."""


@dataclass(frozen=True)
class ErrorRow:
    """Errors of one component of the residual in one speed band.

    Errors are predicted - true residuals of a step, in the component's unit [m, rad, m/s, rad/s]. Figures that do not
    exist (no rows, or a true residual without variance) are NaN.
    """

    component: str  # one of STATE
    band: str  # one of BANDS
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
