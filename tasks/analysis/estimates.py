"""Estimates with 95 % confidence intervals, of trials that may be nested in replicates.

Intervals of means and differences are Student's or Welch's, and those of ratios and regressions SciPy's BCa bootstrap
over whole trials, widened for small samples to the quantiles of Student's t (Hesterberg 2015).

A study with several replicates has as many independent data sets and ensembles, and each trial uses one of them. Trial
j of replicate i has the value y_ij = μ + a_i + e_ij: a_i is due to throws and training, e_ij to evolution. SciPy has no
interval of a mean for that, so the code is here. Of N trials in R replicates, n_i in each, MSB and MSW are the mean
squares between and within. By the method of moments (Searle, Casella & McCulloch 1992, ch. 3)

    σ_a² = (MSB - MSW) / n0,    σ_e² = MSW,    var ȳ = (k σ_a² + σ_e²) / N
    with k = Σ n_i² / N and n0 = (N - k) / (R - 1)

with Satterthwaite's degrees of freedom. Where MSB ≤ MSW, or with one replicate, trials count as independent. Variances
of independent groups add, with Welch's degrees of freedom. Ratios then have intervals by the delta method, and other
functions of means by jackknife pseudo-values, one of each trial (Efron & Tibshirani 1993, ch. 11).

Limit: of ten normal values, half of whose variance lies between replicates, 95 % intervals of the mean contain the
truth 89 % of the time with 2 replicates, 94 % with 3 and 95 % with 5; Student's, 71, 80 and 89 %.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.random import Generator

from tasks.arrays import Float64, Floats, Int64

LEVEL = 0.95  # confidence level of every interval; tests are at 1 - LEVEL
RESOLUTION = 1e-6  # smallest meaningful displacement [m]: positions are of single precision, 5e-7 m at 8 m
_N_RESAMPLES = 2000  # a 2.5 % tail then has 50 resamples, so its position is known to about 14 % of the tail
_MIN_VALUES = 3  # fewest values of a bootstrap interval


@dataclass(frozen=True)
class Estimate:
    """A figure with its interval; what can't be computed is None."""

    value: float | None
    low: float | None = None
    high: float | None = None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Both ends, if there is an interval."""
        return None if self.low is None or self.high is None else (self.low, self.high)


MISSING = Estimate(None)


@dataclass(frozen=True)
class Mean:
    """The mean of finite values with their sample deviation."""

    value: float | None
    sd: float | None = None  # None for fewer than two values
    n: int = 0


def mean_of(values: Floats) -> Mean:
    """Return the mean and deviation of the finite values."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if len(known) == 0:
        return Mean(None)
    return Mean(float(known.mean()), float(known.std(ddof=1)) if len(known) > 1 else None, len(known))


@dataclass(frozen=True, eq=False)
class Sample:
    """Finite values of the trials of a group, and the replicate of each trial."""

    values: Float64  # (n_trials,)
    replicate: Int64  # (n_trials,)

    def __len__(self) -> int:
        return len(self.values)


def sample_of(values: Floats, replicate: Int64) -> Sample:
    """Return the finite ones of (n_trials,) values with their (n_trials,) replicates."""
    known = np.isfinite(values)
    return Sample(np.asarray(values, dtype=np.float64)[known], replicate[known])


# -- the hierarchy of replicates -------------------------------------------------------------------------------------


class Components(NamedTuple):
    """The variances of a group of two or more trials; where replicates can't tell them apart, one of them is 0."""

    between: float  # σ_a²
    within: float  # σ_e²
    of_mean: float  # squared standard error of the mean over all trials
    freedom: float  # its degrees of freedom


def within_replicates(sample: Sample) -> tuple[float, int]:
    """Return the variance of trials around the mean of their replicate, and its degrees of freedom."""
    _, group, sizes = np.unique(sample.replicate, return_inverse=True, return_counts=True)
    departures = sample.values - (np.bincount(group, sample.values) / np.maximum(sizes, 1))[group]
    freedom = len(sample) - len(sizes)
    return float(departures @ departures) / max(freedom, 1), freedom


def components(sample: Sample) -> Components:
    """Split the variance of a group of two or more trials, and return the error of its mean."""
    y, n = sample.values, len(sample)
    _, group, sizes = np.unique(sample.replicate, return_inverse=True, return_counts=True)
    n_replicates, pooled = len(sizes), float(y.var(ddof=1))
    independent = Components(0.0, pooled, pooled / n, n - 1)
    if n_replicates == 1:
        return independent
    if n_replicates == n:  # perhaps all variance is between replicates
        return independent._replace(between=pooled, within=0.0)
    msw, freedom_within = within_replicates(sample)
    msb = float(sizes @ (np.bincount(group, y) / sizes - y.mean()) ** 2) / (n_replicates - 1)
    if msb <= msw:
        return independent
    k = float(sizes @ sizes) / n
    n0 = (n - k) / (n_replicates - 1)
    parts = msb * k / n0, msw * (1 - k / n0)  # their sum is N var ȳ; the second is 0 in balanced groups
    freedom = sum(parts) ** 2 / (parts[0] ** 2 / (n_replicates - 1) + parts[1] ** 2 / freedom_within)
    return Components((msb - msw) / n0, msw, sum(parts) / n, freedom)


def error_of(*samples: Sample) -> tuple[float, float]:
    """Return the squared standard error of the sum of the means of independent groups, and its degrees of freedom.

    The groups have two or more trials and are not all constant.
    """
    parts = [components(sample) for sample in samples]
    variance = sum(part.of_mean for part in parts)
    return variance, variance**2 / sum(part.of_mean**2 / part.freedom for part in parts)


def sum_of_means(*samples: Sample) -> Estimate:
    """Estimate the sum of the means of independent groups; one that is subtracted has negative values."""
    if min(len(sample) for sample in samples) == 0:
        return MISSING
    value = float(sum(sample.values.mean() for sample in samples))
    constant = max(np.ptp(sample.values) for sample in samples) <= RESOLUTION
    if constant or min(len(sample) for sample in samples) == 1:
        return Estimate(value)
    variance, freedom = error_of(*samples)
    half = float(scipy.stats.t.ppf((1 + LEVEL) / 2, freedom)) * math.sqrt(variance)
    return Estimate(value, value - half, value + half)


# -- ratios and other functions of means -----------------------------------------------------------------------------


def ratio(part: Sample, whole: Sample, *, rng: Generator) -> Estimate:
    """Estimate the ratio of two means of independent groups; missing where the reference goes nowhere or backwards.

    The interval is by the bootstrap, and by the delta method if a group has several replicates. A group is 1 of itself.
    """
    if min(len(part), len(whole)) == 0 or whole.values.mean() <= RESOLUTION:
        return MISSING
    if np.array_equal(part.values, whole.values):
        return Estimate(1.0)
    if all(len(np.unique(group.replicate)) < 2 for group in (part, whole)):
        return bootstrap(_ratio, part.values[:, None], whole.values[:, None], rng=rng)[0]
    value = float(part.values.mean() / whole.values.mean())
    reference = sum_of_means(whole)
    if reference.low is None or reference.low <= 0:
        return Estimate(value)
    ends = sum_of_means(*linearised(part, whole)).interval
    return Estimate(value, *(() if ends is None else (value + end for end in ends)))


def linearised(part: Sample, whole: Sample) -> tuple[Sample, Sample]:
    """Return values of both groups whose sum of means has the error of the ratio of their means, and is 0."""
    below = float(whole.values.mean())
    over = float(part.values.mean()) / below
    return replace(part, values=part.values / below - over), replace(whole, values=over - over * whole.values / below)


def _ratio(part: Float64, whole: Float64) -> Float64:
    return np.where(whole > RESOLUTION, part / whole, np.nan)


def bootstrap(statistic: Callable[..., Float64], *samples: Float64, rng: Generator) -> tuple[Estimate, ...]:
    """Return estimates of n_figures functions of means, with BCa intervals from the same resamples.

    Args:
        statistic: maps each sample's (..., n_columns) means to (..., n_figures); NaN where a figure is undefined.
        *samples: (n_values, n_columns) each; rows are resampled whole, and samples independently of each other.
        rng: source of randomness.
    """

    def of_rows(*rows: Int64, axis: int) -> Float64:  # noqa: ARG001 (SciPy's contract; it is the last)
        means = (sample[chosen].mean(axis=-2) for sample, chosen in zip(samples, rows, strict=True))
        return np.moveaxis(statistic(*means), -1, 0)

    n = min(len(sample) for sample in samples)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", scipy.stats.DegenerateDataWarning)  # there is no interval then
        values = statistic(*(sample.mean(axis=0) for sample in samples))
        low = high = np.full(len(values), np.nan)
        if n >= _MIN_VALUES:
            # The resamples' deviation is √((n - 1) / n) of the sample's; Student's t allows for its uncertainty.
            z = math.sqrt(n / (n - 1)) * float(scipy.stats.t.ppf((1 + LEVEL) / 2, n - 1))
            resampled = scipy.stats.bootstrap(
                tuple(np.arange(len(sample)) for sample in samples),
                of_rows,
                n_resamples=_N_RESAMPLES,
                vectorized=True,
                axis=0,
                confidence_level=2 * float(scipy.stats.norm.cdf(z)) - 1,
                method="BCa",
                rng=rng,
            )
            low, high = resampled.confidence_interval
    return tuple(_known(*figure) for figure in zip(values, low, high, strict=True))


def of_means(statistic: Callable[[Float64], Float64], rows: Float64, replicate: Int64) -> tuple[Estimate, ...]:
    """Estimate functions of the means of nested trials' rows, by pseudo-values: for a mean, as its interval is.

    Args:
        statistic: maps (..., n_columns) means to (..., n_figures); NaN where a figure is undefined.
        rows: (n_trials, n_columns).
        replicate: (n_trials,) replicate of each trial.
    """
    n, means = len(rows), rows.mean(axis=0)
    with np.errstate(all="ignore"):
        values = statistic(means)
        pseudo = n * values - (n - 1) * statistic((n * means - rows) / (n - 1))
    estimates = []
    for value, column in zip(values, pseudo.T, strict=True):
        around = sum_of_means(Sample(column - column.mean(), replicate)) if np.isfinite(column).all() else MISSING
        estimates.append(_known(value, *(value + end for end in around.interval or (math.nan, math.nan))))
    return tuple(estimates)


def _known(value: float, low: float, high: float) -> Estimate:
    if not math.isfinite(value):
        return MISSING
    return Estimate(float(value), float(low), float(high)) if low < high else Estimate(float(value))
