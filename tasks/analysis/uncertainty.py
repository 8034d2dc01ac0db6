"""Estimates with confidence intervals, or with the reason why they are missing.

Every figure of the analysis is a smooth function of means: a ratio of two means, a share of a gap, a regression (of the
means of x, y, x², y², xy). So one bootstrap of means serves them all. Its intervals are BCa (Efron & Tibshirani 1993,
An Introduction to the Bootstrap, ch. 14; the acceleration of several samples as in scipy), widened for small samples to
the quantiles of Student's t (Hesterberg 2015, "What Teachers Should Know About the Bootstrap").

Limit: for the mean of normal values, the intervals contain the truth 75 % of the time with 3 values, 92 % with 5, 94 %
with 10 and 95 % with 20; for exponential values 87 % with 5 and 92 % with 10. A single mean gets Student's t interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.random import Generator

from tasks.arrays import Float64, Floats

LEVEL = 0.95  # confidence level of every interval
_N_RESAMPLES = 2000  # A 2.5 % tail then has 50 resamples, so its position is known to about 14 % of the tail
_MIN_VALUES = 3  # fewest values in a sample for a bootstrap interval
RESOLUTION = 1e-6  # smallest meaningful displacement [m]: positions are of single precision, 5e-7 m at 8 m
_MAX_MATRIX = 4_000_000  # largest number of elements in a matrix of resamples by values: 32 MB


@dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % interval. Missing numbers are None, never NaN."""

    value: float | None
    low: float | None = None
    high: float | None = None
    reason: str | None = None  # why the value or its interval is missing; None if both exist

    @staticmethod
    def missing(reason: str) -> Estimate:
        """Return an estimate without a value."""
        return Estimate(None, reason=reason)


def finite(values: Floats) -> Float64:
    """Return the finite values as float64."""
    wide = np.asarray(values, dtype=np.float64)
    return wide[np.isfinite(wide)]


def is_constant(values: Floats, *, resolution: float = 0.0) -> bool:
    """Return whether values differ by no more than rounding errors or a resolution."""
    return len(values) == 0 or bool(np.ptp(values) <= max(1e-12 * np.abs(values).max(), resolution))


def mean(values: Floats) -> Estimate:
    """Estimate the mean of the finite values with Student's t interval."""
    known = finite(values)
    n = len(known)
    if n == 0:
        return Estimate.missing("no finite value")
    value = float(known.mean())
    if n == 1:
        return Estimate(value, reason="1 value, an interval needs 2 or more")
    half = float(scipy.stats.t.ppf((1 + LEVEL) / 2, n - 1)) * float(known.std(ddof=1)) / math.sqrt(n)
    return Estimate(value, value - half, value + half)


def bootstrap(
    statistic: Callable[..., Float64], *samples: Float64, rng: Generator, undefined: str
) -> tuple[Estimate, ...]:
    """Return estimates of n_figures functions of means, with BCa intervals from the same resamples.

    Args:
        statistic: maps each sample's (..., n_columns) means to (..., n_figures); NaN where a figure is undefined.
        *samples: (n_values, n_columns) each; rows are resampled whole, and samples independently of each other.
        rng: source of randomness.
        undefined: reason to give for a figure that is NaN.
    """
    with np.errstate(all="ignore"):
        means = [sample.mean(axis=0) for sample in samples]
        values = statistic(*means)
        n_fewest = min(len(sample) for sample in samples)
        if n_fewest < _MIN_VALUES:
            few = f"{n_fewest} value{'s' * (n_fewest != 1)}, an interval needs {_MIN_VALUES} or more"
            return tuple(
                Estimate(float(v), reason=few) if np.isfinite(v) else Estimate.missing(undefined) for v in values
            )
        resampled = statistic(*(_resampled_means(sample, rng) for sample in samples))
        acceleration = _acceleration(statistic, samples, means)
    # The resamples' deviation is √((n - 1) / n) of the sample's; Student's t allows for its uncertainty.
    z = math.sqrt(n_fewest / (n_fewest - 1)) * float(scipy.stats.t.ppf((1 + LEVEL) / 2, n_fewest - 1))
    return tuple(
        _bca(float(v), resampled[:, i], float(acceleration[i]), z, undefined)
        if np.isfinite(v)
        else Estimate.missing(undefined)
        for i, v in enumerate(values)
    )


def _resampled_means(sample: Float64, rng: Generator) -> Float64:
    """Resample the rows with replacement and return (_N_RESAMPLES, n_columns) means."""
    n = len(sample)
    at_once = max(_MAX_MATRIX // n, 1)
    means = []
    for first in range(0, _N_RESAMPLES, at_once):
        n_drawn = min(at_once, _N_RESAMPLES - first)
        drawn = rng.integers(0, n, (n_drawn, n)) + n * np.arange(n_drawn)[:, None]
        counts = np.bincount(drawn.ravel(), minlength=n_drawn * n).reshape(n_drawn, n)
        means.append(counts.astype(np.float64) @ sample / n)
    return np.concatenate(means)


def _acceleration(statistic: Callable[..., Float64], samples: tuple[Float64, ...], means: list[Float64]) -> Float64:
    """Estimate the skewness of each figure by leaving out one value at a time."""
    cubes = squares = np.float64(0)
    for i, sample in enumerate(samples):
        n = len(sample)
        without = (n * means[i] - sample) / (n - 1)
        left_out = statistic(*(without if j == i else mean[None] for j, mean in enumerate(means)))
        known = np.isfinite(left_out)
        centre = np.where(known, left_out, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        influence = np.where(known, (n - 1) * (centre - left_out) / n, 0.0)
        cubes = cubes + (influence**3).sum(axis=0)
        squares = squares + (influence**2).sum(axis=0)
    return np.asarray(np.where(squares > 0, cubes / (6 * squares**1.5), 0.0), dtype=np.float64)


def _bca(value: float, resampled: Float64, acceleration: float, z: float, undefined: str) -> Estimate:
    """Correct the percentiles of the resamples at ± z deviations for bias and skewness."""
    known = np.sort(resampled[np.isfinite(resampled)])
    lost = 1 - len(known) / len(resampled)
    if lost > (1 - LEVEL) / 2:
        return Estimate(value, reason=f"no interval, since in {lost:.0%} of the resamples: {undefined}")
    if is_constant(known):
        return Estimate(value, reason="no interval, since the values have no spread")
    below = (np.searchsorted(known, value, "left") + np.searchsorted(known, value, "right")) / 2 / len(known)
    if not 0 < below < 1:
        return Estimate(value, reason="no interval, since every resample lies on one side of the value")
    z0 = scipy.stats.norm.ppf(below)
    ends = z0 + np.array((-z, z))
    low, high = np.quantile(known, scipy.stats.norm.cdf(z0 + ends / (1 - acceleration * ends)))
    return Estimate(value, float(low), float(high))
