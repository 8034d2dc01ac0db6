"""How wrong a network is, per component and by speed.

The first steps of fast throws hold most of the residuals' variance, so R² over all rows says little about a robot,
which lives at low speed. There a small mean error is a thrust that does not exist, and evolution finds it. Hence the
bands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tasks.arrays import Floats
from tasks.residual.observation import STATE

BANDS = (
    ("all", 0.0, math.inf),
    ("< 0.5", 0.0, 0.5),
    ("0.5-2", 0.5, 2.0),
    ("2-10", 2.0, 10.0),
    ("> 10", 10.0, math.inf),
)
"""Name, and the range low <= |v| < high of each band of speeds [m/s]."""

LOW_SPEED = "< 0.5"
"""The band that an evolved swimmer mostly lives in."""


@dataclass(frozen=True)
class ErrorRow:
    """One line of the table: a component of the residual, in a band of speeds.

    Errors are predicted minus true, a step, in the component's unit (m, rad, m/s, rad/s). A figure that does not exist
    (no rows, or a true residual without variance) is NaN.
    """

    component: str
    """Of STATE."""
    band: str
    """Of BANDS [m/s]."""
    n_rows: int
    """Transitions in the band."""
    rmse: float
    """Root of the mean squared error."""
    bias: float
    """Mean error."""
    relative_error: float
    """rmse over the root of the mean squared true residual: predicting 0 scores 1."""
    r2: float
    """Share of the variance explained: predicting the mean scores 0."""


def error_rows(predicted: Floats, true: Floats, speed: Floats) -> tuple[ErrorRow, ...]:
    """Compare (n_rows, 6) residuals; ``speed`` is (n_rows,) |v| at the start of the step [m/s]."""
    # Sums in float64: a bias is a small difference of many values.
    error = predicted.astype(np.float64) - true.astype(np.float64)
    true = true.astype(np.float64)
    rows = []
    for band, low, high in BANDS:
        inside = (low <= speed) & (speed < high)
        for i, component in enumerate(STATE):
            rows.append(_error_row(component, band, error[inside, i], true[inside, i]))
    return tuple(rows)


def _error_row(component: str, band: str, error: Floats, true: Floats) -> ErrorRow:
    n = len(error)
    if n == 0:
        return ErrorRow(component, band, 0, math.nan, math.nan, math.nan, math.nan)
    mse = float(np.mean(error**2))
    mean_square = float(np.mean(true**2))
    variance = float(np.var(true))
    return ErrorRow(
        component=component,
        band=band,
        n_rows=n,
        rmse=math.sqrt(mse),
        bias=float(np.mean(error)),
        relative_error=math.sqrt(mse / mean_square) if mean_square > 0 else math.nan,
        r2=1 - mse / variance if variance > 0 else math.nan,
    )
