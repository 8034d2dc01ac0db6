"""Estimates with 95 % confidence intervals, of trials that may be nested in replicates.

Intervals of means and differences are Student's or Welch's, and those of ratios and regressions SciPy's BCa bootstrap
over whole trials, widened for small samples to the quantiles of Student's t (Hesterberg 2015).

A study with several replicates has as many independent data sets and ensembles, and each trial uses one of them, so the
replicates are what is independent, whatever their trials look like. With s_i the sum of the n_i trials' departures from
the mean of all N, the error of that mean in R replicates (Liang & Zeger 1986, with their small-sample factor) is

    var ȳ = R / (R - 1) · Σ s_i² / N²

with R - 1 degrees of freedom: for equal n_i, Student's t of the replicates' means. With one replicate the trials are
independent, and the interval is of robots evolved in these networks. Variances of independent groups add, with Welch's
degrees of freedom. Ratios then have intervals by the delta method, and other functions of means by jackknife
pseudo-values, one of each trial (Efron & Tibshirani 1993, ch. 11).
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

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


def between(*ends: str) -> str:
    """Join the written ends of an interval, if there are any; of percentages only the last has the unit."""
    return re.sub(r"\s?%(?= to )", "", " to ".join(ends))


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


def _by_replicate(sample: Sample) -> tuple[Int64, Int64]:
    """Return each trial's group and the groups' sizes: a group is a replicate, or a trial if there is only one."""
    _, group, sizes = np.unique(sample.replicate, return_inverse=True, return_counts=True)
    return (group, sizes) if len(sizes) > 1 else (np.arange(len(sample)), np.ones(len(sample), np.int64))


def within_replicates(sample: Sample) -> tuple[float, int]:
    """Return the variance of trials around the mean of their replicate, and its degrees of freedom."""
    _, group, sizes = np.unique(sample.replicate, return_inverse=True, return_counts=True)
    departures = sample.values - (np.bincount(group, sample.values) / np.maximum(sizes, 1))[group]
    freedom = len(sample) - len(sizes)
    return float(departures @ departures) / max(freedom, 1), freedom


def error_of_mean(sample: Sample) -> tuple[float, int]:
    """Return the squared standard error of the mean of two or more trials, and its degrees of freedom."""
    group, sizes = _by_replicate(sample)
    departures, freedom = np.bincount(group, sample.values - sample.values.mean()), len(sizes) - 1
    return float(departures @ departures) * len(sizes) / freedom / len(sample) ** 2, freedom


def error_of(*samples: Sample) -> tuple[float, float]:
    """Return the squared standard error of the sum of the means of independent groups, and its degrees of freedom.

    The groups have two or more trials and are not all constant.
    """
    parts = [error_of_mean(sample) for sample in samples]
    variance = sum(of_mean for of_mean, _ in parts)
    return variance, variance**2 / sum(of_mean**2 / freedom for of_mean, freedom in parts)


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
