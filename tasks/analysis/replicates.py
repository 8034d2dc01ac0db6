"""Trials nested in replicates: variances, and intervals of means where trials share throws and networks.

A study with several replicates has as many independent data sets and ensembles, and each trial uses one of them. Trial
j of replicate i has the value y_ij = μ + a_i + e_ij. The replicate's part a_i is due to throws and training, which
change together, so that their variances can't be told apart. The trial's part e_ij is due to evolution, and to training
too where each trial has a network of its own.

Of N trials in R replicates, n_i in each, the mean squares between and within replicates are MSB and MSW. The variances
of the two parts, by the method of moments (Searle, Casella & McCulloch 1992, Variance Components, ch. 3), and that of
the mean ȳ over all trials are

    σ_a² = (MSB - MSW) / n0,    σ_e² = MSW,    var ȳ = (k σ_a² + σ_e²) / N
    with k = Σ n_i² / N and n0 = (N - k) / (R - 1)

and var ȳ has Satterthwaite's degrees of freedom. In a balanced group that is MSB / N with R - 1 degrees, as REML gives.
Where MSB ≤ MSW, or with one replicate, σ_a² is 0 and trials count as independent: Student's t with N - 1 degrees.

The variances of independent groups add, with Welch's degrees of freedom; ratios have intervals by the delta method.
Arms that share throws or networks count as independent, which makes their comparison cautious. Other functions of
means, such as those of a regression, are treated as means of their jackknife pseudo-values (Efron & Tibshirani 1993, An
Introduction to the Bootstrap, ch. 11), one of each trial.

Limit: of ten normal values, half of whose variance lies between replicates, 95 % intervals of the mean contain the
truth 89 % of the time with 2 replicates, 94 % with 3 and 95 % with 5; Student's, 71, 80 and 89 %. With 2, the median
interval is eight times as wide as Student's, and yet 30 % of the samples show no variance between replicates and pass
for independent; with 3 and 5, it is three times and 1.5 times as wide.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from tasks.analysis.uncertainty import LEVEL, RESOLUTION, Estimate, is_constant, mean
from tasks.arrays import Float64, Floats, Int64


@dataclass(frozen=True, eq=False)
class NestedSample:
    """Finite values of the trials of a group, and the replicate of each trial."""

    values: Float64  # (n_trials,)
    replicate: Int64  # (n_trials,)

    def scaled(self, factor: float) -> "NestedSample":
        """Return the same trials with their values multiplied by a factor."""
        return replace(self, values=factor * self.values)


def nested_sample(values: Floats, replicate: Int64) -> NestedSample:
    """Return the finite ones of (n_trials,) values with their (n_trials,) replicates."""
    known = np.isfinite(values)
    return NestedSample(np.asarray(values, dtype=np.float64)[known], replicate[known])


@dataclass(frozen=True)
class MeanError:
    """The error of a mean, or of a sum of means of independent groups."""

    variance: float  # squared standard error
    freedom: float  # degrees of freedom


@dataclass(frozen=True)
class Components:
    """The variances of a group of two or more trials; NaN where replicates can't tell them apart."""

    n_replicates: int
    n_per_replicate: float  # n0 of this module's page
    between: float  # variance between replicates, σ_a²
    within: float  # variance within replicates, σ_e²
    f: float  # MSB / MSW
    error: MeanError  # of the mean over all trials

    def of_one_replicate(self, n: int) -> float:
        """Return the variance of the mean of n trials of a single replicate, as far as it is known."""
        if math.isnan(self.within):  # perhaps all variance is between replicates
            return self.error.variance * self.n_replicates
        return (0.0 if math.isnan(self.between) else self.between) + self.within / n


def nested(*samples: NestedSample) -> bool:
    """Return whether any sample has trials of several replicates."""
    return any(len(np.unique(sample.replicate)) > 1 for sample in samples)


def from_replicates_means(sample: NestedSample) -> Float64:
    """Return the difference of each value from the mean of its replicate: (n_trials,)."""
    _, own, sizes = np.unique(sample.replicate, return_inverse=True, return_counts=True)
    return sample.values - (np.bincount(own, sample.values) / np.maximum(sizes, 1))[own]


def components(sample: NestedSample) -> Components:
    """Split the variance of a group of two or more trials, and return the error of its mean."""
    y, n = sample.values, len(sample.values)
    _, own, sizes = np.unique(sample.replicate, return_inverse=True, return_counts=True)
    n_replicates, pooled = len(sizes), float(y.var(ddof=1))
    independent = MeanError(pooled / n, n - 1)
    if n_replicates == 1:
        return Components(1, n, math.nan, pooled, math.nan, independent)
    if n_replicates == n:
        return Components(n, 1, math.nan, math.nan, math.nan, independent)
    means = np.bincount(own, y) / sizes
    msb = float(sizes @ (means - y.mean()) ** 2) / (n_replicates - 1)
    msw = float(((y - means[own]) ** 2).sum()) / (n - n_replicates)
    k = float(sizes @ sizes) / n
    n0 = (n - k) / (n_replicates - 1)
    f = msb / msw if msw > 0 else math.inf
    if msb <= msw:
        return Components(n_replicates, n0, 0.0, pooled, f, independent)
    parts = msb * k / n0, msw * (1 - k / n0)  # their sum is N var ȳ; the second is 0 in balanced groups
    freedom = sum(parts) ** 2 / (parts[0] ** 2 / (n_replicates - 1) + parts[1] ** 2 / (n - n_replicates))
    return Components(n_replicates, n0, (msb - msw) / n0, msw, f, MeanError(sum(parts) / n, freedom))


def error_of(*samples: NestedSample) -> MeanError:
    """Return the error of the sum of the means of independent groups of two or more trials, not all constant."""
    errors = [components(sample).error for sample in samples]
    variance = sum(error.variance for error in errors)
    return MeanError(variance, variance**2 / sum(error.variance**2 / error.freedom for error in errors))


def mean_of(sample: NestedSample) -> Estimate:
    """Estimate the mean of a group; with one replicate, that is Student's interval."""
    return sum_of_means(sample) if nested(sample) else mean(sample.values)


def sum_of_means(*samples: NestedSample, level: float = LEVEL) -> Estimate:
    """Estimate the sum of the means of independent groups; a difference is the sum with a group scaled by -1.

    Args:
        *samples: the groups.
        level: confidence level of the interval.
    """
    sizes = [len(sample.values) for sample in samples]
    if min(sizes) == 0:
        return Estimate.missing(f"{_listed(sizes)} finite values, expected 1 or more in each group")
    value = float(sum(sample.values.mean() for sample in samples))
    if min(sizes) == 1:
        return Estimate(value, reason=f"{_listed(sizes)} values, an interval needs 2 or more in each group")
    if all(is_constant(sample.values, resolution=RESOLUTION) for sample in samples):
        return Estimate(value, reason="no interval, since the values have no spread")
    error = error_of(*samples)
    half = float(scipy.stats.t.ppf((1 + level) / 2, error.freedom)) * math.sqrt(error.variance)
    return Estimate(value, value - half, value + half)


def _listed(sizes: Sequence[int]) -> str:
    return " and ".join(map(str, sizes))


def ratio_of_sums(*groups: tuple[NestedSample, NestedSample], undefined: str) -> Estimate:
    """Estimate the ratio of two sums of means by the delta method.

    Args:
        *groups: independent groups; of each, what its trials add to the sum above the line and to the one below it.
        undefined: reason to give where the sum below the line is not above 0.
    """
    above, below = zip(*groups, strict=True)
    whole = sum_of_means(*below)
    if whole.value is None:
        return whole
    if whole.value <= RESOLUTION:
        return Estimate.missing(undefined)
    value = float(sum(sample.values.mean() for sample in above)) / whole.value
    if whole.low is not None and whole.low <= 0:
        return Estimate(value, reason=f"no interval, since within that of the reference {undefined}")
    error = sum_of_means(*linearised(*groups))
    if error.low is None or error.high is None:
        return Estimate(value, reason=error.reason)
    return Estimate(value, value + error.low, value + error.high)


def of_means(
    statistic: Callable[[Float64], Float64], rows: Float64, replicate: Int64, *, undefined: str
) -> tuple[Estimate, ...]:
    """Estimate n_figures functions of the means of trials' rows, by pseudo-values: for a mean, as :func:`mean_of` does.

    Args:
        statistic: maps (..., n_columns) means to (..., n_figures); not finite where a figure is undefined.
        rows: (n_trials, n_columns).
        replicate: (n_trials,) replicate of each trial.
        undefined: reason to give for a figure that is not finite.

    Returns:
        The n_figures estimates.
    """
    n, means = len(rows), rows.mean(axis=0)
    with np.errstate(all="ignore"):
        values = statistic(means)
        without_each = statistic((n * means - rows) / (n - 1))
        pseudo = n * values - (n - 1) * without_each
    return tuple(
        _of_pseudo_values(float(value), NestedSample(own, replicate), undefined)
        for value, own in zip(values, pseudo.T, strict=True)
    )


def _of_pseudo_values(value: float, sample: NestedSample, undefined: str) -> Estimate:
    if not math.isfinite(value):
        return Estimate.missing(undefined)
    if not np.isfinite(sample.values).all():
        return Estimate(value, reason=f"no interval, since without one of the trials {undefined}")
    error = sum_of_means(replace(sample, values=sample.values - sample.values.mean()))
    if error.low is None or error.high is None:
        return Estimate(value, reason=error.reason)
    return Estimate(value, value + error.low, value + error.high)


def terms_of_ratio(part: NestedSample, whole: NestedSample) -> tuple[tuple[NestedSample, NestedSample], ...]:
    """Return what each of two groups adds above and below the line of part / whole."""
    return (part, part.scaled(0)), (whole.scaled(0), whole)


def linearised(*groups: tuple[NestedSample, NestedSample]) -> list[NestedSample]:
    """Return for each group of a ratio the values whose sum of means has the ratio's error, and is 0."""
    ratio, below = (float(sum(group[i].values.mean() for group in groups)) for i in (0, 1))
    ratio /= below
    return [replace(over, values=(over.values - ratio * under.values) / below) for over, under in groups]
