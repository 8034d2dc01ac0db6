"""Comparisons of two groups of champions: the paper's Student's t test and alternatives with weaker assumptions.

Student's t assumes equal variances, which champions of different environments do not have. Welch's test does not, and
Mann-Whitney's does not assume normality either. Hedges' g and the ratio of the means give the size of an effect. Among
many tests, the smallest p-value is small by chance; Holm's correction allows for that. Its family is all contrasts of a
study, at every depth. All tests are two-sided.

These tests treat trials as independent, as the paper does. Where trials share throws and networks, the clustered test
and the intervals of estimates include the variance between replicates (:mod:`tasks.analysis.replicates`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
import scipy
from numpy.random import Generator

from tasks.analysis.replicates import (
    NestedSample,
    error_of,
    mean_of,
    nested,
    nested_sample,
    ratio_of_sums,
    sum_of_means,
    terms_of_ratio,
)
from tasks.analysis.scores import BEST, ScoredArm, Scores
from tasks.analysis.uncertainty import LEVEL, RESOLUTION, Estimate, bootstrap, finite, is_constant
from tasks.arrays import Float64, Floats, Int64

_MAX_EXACT = 20  # largest number of values in both groups for which Mann-Whitney's p is exact, unless values are tied


@dataclass(frozen=True)
class SignificanceTest:
    """A two-sided test. Missing figures are None; the reason explains why."""

    statistic: float | None
    p: float | None
    reason: str | None = None


@dataclass(frozen=True)
class Group:
    """A group of values. Values that are not finite are left out."""

    n: int
    n_left_out: int
    n_replicates: int
    mean: Estimate  # [m]
    sd: float | None  # sample deviation [m]; None for fewer than two values


@dataclass(frozen=True)
class Comparison:
    """Comparison of group a with group b, the reference."""

    a: Group
    b: Group
    student: SignificanceTest
    welch: SignificanceTest
    mann_whitney: SignificanceTest
    clustered: SignificanceTest  # the only one that knows of replicates
    hedges_g: Estimate  # (mean a - mean b) / pooled deviation, corrected for small samples
    ratio: Estimate  # mean a / mean b


def group(values: Floats, replicate: Int64 | None = None) -> Group:
    """Return the number, mean and deviation of the finite ones of (n_values,) values; by default of one replicate."""
    sample = nested_sample(values, np.zeros(len(values), np.int64) if replicate is None else replicate)
    n = len(sample.values)
    sd = float(sample.values.std(ddof=1)) if n > 1 else None
    return Group(n, len(values) - n, len(np.unique(sample.replicate)), mean_of(sample), sd)


def compare(a: Floats, b: Floats, *, replicates: tuple[Int64, Int64] | None = None, rng: Generator) -> Comparison:
    """Return all tests and effect sizes for two groups of values that are independent of each other.

    Args:
        a: (n_a,) values; values that are not finite are left out and counted.
        b: (n_b,) values of the reference.
        replicates: (n_a,) and (n_b,) replicate of each value; if left out, all values are independent.
        rng: source of randomness for the ratio's interval.
    """
    of_a, of_b = replicates or (np.zeros(len(a), np.int64), np.zeros(len(b), np.int64))
    samples = nested_sample(a, of_a), nested_sample(b, of_b)
    x, y = (sample.values for sample in samples)
    tied = "all values of both groups are equal" if _is_constant(np.concatenate((x, y))) else None
    return Comparison(
        a=group(a, of_a),
        b=group(b, of_b),
        student=student(x, y),
        welch=welch(x, y),
        mann_whitney=_test(_too_few(x, y) or tied, lambda: scipy.stats.mannwhitneyu(x, y, method=_method(x, y))),
        clustered=clustered(*samples),
        hedges_g=hedges_g(x, y),
        ratio=nested_ratio(*samples, rng=rng),
    )


def student(x: Float64, y: Float64) -> SignificanceTest:
    """Run the paper's test: whether the means of (n_x,) and (n_y,) finite values differ, given equal variances."""
    return _test(_no_spread(x, y), lambda: _t_test(x, y, equal_variances=True))


def welch(x: Float64, y: Float64) -> SignificanceTest:
    """Run Welch's test: whether the means of (n_x,) and (n_y,) finite values differ, whatever their variances."""
    return _test(_no_spread(x, y), lambda: _t_test(x, y, equal_variances=False))


def difference(x: Float64, y: Float64, *, equal_variances: bool = True, level: float = LEVEL) -> Estimate:
    """Estimate the difference of two means with the interval of Student's or Welch's t test.

    The interval contains 0 exactly where that test's p is above 1 - level.

    Args:
        x: (n_x,) finite values.
        y: (n_y,) finite values.
        equal_variances: True for Student's interval, False for Welch's.
        level: confidence level of the interval.

    Returns:
        Mean of x minus mean of y.
    """
    if min(len(x), len(y)) == 0:
        return Estimate.missing(f"{len(x)} and {len(y)} finite values, expected 1 or more in both groups")
    value, reason = float(x.mean() - y.mean()), _no_spread(x, y)
    if reason is not None:
        return Estimate(value, reason=reason)
    if equal_variances:
        freedom = float(len(x) + len(y) - 2)
        error = _pooled_deviation(x, y) * math.sqrt(1 / len(x) + 1 / len(y))
    else:  # Welch 1947
        parts = [v.var(ddof=1) / len(v) for v in (x, y)]
        freedom = sum(parts) ** 2 / sum(part**2 / (len(v) - 1) for part, v in zip(parts, (x, y), strict=True))
        error = math.sqrt(sum(parts))
    half = float(scipy.stats.t.ppf((1 + level) / 2, freedom)) * error
    return Estimate(value, value - half, value + half)


def clustered(x: NestedSample, y: NestedSample) -> SignificanceTest:
    """Run Welch's test with errors that include the variance between replicates; with one replicate it is Welch's."""
    if not nested(x, y):
        return welch(x.values, y.values)
    reason = _no_spread(x.values, y.values)
    if reason is not None:
        return SignificanceTest(None, None, reason)
    error = error_of(x, y)
    t = float(x.values.mean() - y.values.mean()) / math.sqrt(error.variance)
    return SignificanceTest(t, float(2 * scipy.stats.t.sf(abs(t), error.freedom)))


def nested_difference(
    x: NestedSample, y: NestedSample, *, equal_variances: bool = True, level: float = LEVEL
) -> Estimate:
    """Estimate the difference of two means, with the interval of the clustered test.

    Args:
        x: a group.
        y: the group that is subtracted.
        equal_variances: whether the interval is Student's if no group has several replicates; otherwise Welch's.
        level: confidence level of the interval.

    Returns:
        Mean of x minus mean of y.
    """
    if nested(x, y):
        return sum_of_means(x, y.scaled(-1), level=level)
    return difference(x.values, y.values, equal_variances=equal_variances, level=level)


def _pooled_deviation(x: Float64, y: Float64) -> float:
    n_x, n_y = len(x), len(y)
    return math.sqrt(((n_x - 1) * x.var(ddof=1) + (n_y - 1) * y.var(ddof=1)) / (n_x + n_y - 2))


def _t_test(x: Float64, y: Float64, *, equal_variances: bool) -> Any:
    # Deviations of constant groups are set to exactly 0; scipy would warn of lost precision.
    described = ((v.mean(), 0.0 if _is_constant(v) else v.std(ddof=1), len(v)) for v in (x, y))
    return scipy.stats.ttest_ind_from_stats(*chain.from_iterable(described), equal_var=equal_variances)


def _too_few(x: Float64, y: Float64) -> str | None:
    if min(len(x), len(y)) >= 2:
        return None
    return f"{len(x)} and {len(y)} values, expected 2 or more in both groups"


def _no_spread(x: Float64, y: Float64) -> str | None:
    """Return why the means of two groups can't be tested, or None if they can."""
    return _too_few(x, y) or ("both groups are constant" if _is_constant(x) and _is_constant(y) else None)


def _is_constant(displacement: Float64) -> bool:
    return is_constant(displacement, resolution=RESOLUTION)


def _method(x: Float64, y: Float64) -> str:
    tied = len(np.unique(np.concatenate((x, y)))) < len(x) + len(y)
    return "exact" if len(x) + len(y) <= _MAX_EXACT and not tied else "asymptotic"


def _test(reason: str | None, run: Callable[[], Any]) -> SignificanceTest:
    if reason is not None:
        return SignificanceTest(None, None, reason)
    done = run()
    return SignificanceTest(float(done.statistic), float(done.pvalue))


def hedges_g(x: Float64, y: Float64) -> Estimate:
    """Estimate the standardised difference of the means of (n_x,) and (n_y,) finite values, for large samples.

    Hedges & Olkin 1985, Statistical Methods for Meta-Analysis, ch. 5: J = Γ(m/2) / (√(m/2) Γ((m - 1)/2)) with
    m = n_x + n_y - 2, and var g = (n_x + n_y) / (n_x n_y) + g² / (2 (n_x + n_y)).
    """
    reason = _no_spread(x, y)
    if reason is not None:
        return Estimate.missing(reason)
    n_x, n_y = len(x), len(y)
    m = n_x + n_y - 2
    J = math.exp(scipy.special.gammaln(m / 2) - scipy.special.gammaln((m - 1) / 2)) / math.sqrt(m / 2)
    g = J * float(x.mean() - y.mean()) / _pooled_deviation(x, y)
    half = float(scipy.stats.norm.ppf((1 + LEVEL) / 2)) * math.sqrt(
        (n_x + n_y) / (n_x * n_y) + g * g / (2 * (n_x + n_y))
    )
    return Estimate(g, g - half, g + half)


def ratio(part: Floats, whole: Floats, *, rng: Generator) -> Estimate:
    """Return the ratio of two means, such as that of Dry Land's champions to True Slush's.

    Args:
        part: (n_part,) values.
        whole: (n_whole,) values of the reference, independent of the part.
        rng: source of randomness for the interval.
    """
    x, y = finite(part), finite(whole)
    if len(x) == 0 or len(y) == 0:
        return Estimate.missing(f"{len(x)} and {len(y)} finite values, expected 1 or more in both groups")
    return bootstrap(_ratio, x[:, None], y[:, None], rng=rng, undefined=_BACKWARDS)[0]


def _ratio(part: Float64, whole: Float64) -> Float64:
    return np.where(whole > RESOLUTION, part / whole, np.nan)


_BACKWARDS = "the reference goes nowhere, or backwards"


def nested_ratio(part: NestedSample, whole: NestedSample, *, rng: Generator) -> Estimate:
    """Return the ratio of two means, whose interval includes the variance between replicates.

    Args:
        part: a group.
        whole: the reference, independent of the part.
        rng: source of randomness for the interval if no group has several replicates.
    """
    if nested(part, whole):
        return ratio_of_sums(*terms_of_ratio(part, whole), undefined=_BACKWARDS)
    return ratio(part.values, whole.values, rng=rng)


def holm(p: Sequence[float | None]) -> list[float | None]:
    """Correct p-values for multiple comparisons (Holm 1979); None stays None and does not count."""
    known = [i for i, value in enumerate(p) if value is not None]
    corrected: list[float | None] = [None] * len(p)
    largest = 0.0
    for rank, i in enumerate(sorted(known, key=lambda i: (p[i], i))):
        largest = max(largest, min((len(known) - rank) * (p[i] or 0.0), 1.0))
        corrected[i] = largest
    return corrected


PAPERS_CONTRASTS: tuple[tuple[ScoredArm, ScoredArm], ...] = (
    (("dry_land", "zero_shot"), BEST),
    (("dry_land", "adapted"), BEST),
    (("residual_slush", "zero_shot"), BEST),
    (("residual_slush", "adapted"), BEST),
    (("single_member", "zero_shot"), BEST),
    (("single_member", "adapted"), BEST),
    (("residual_slush", "zero_shot"), ("dry_land", "zero_shot")),
    (("residual_slush", "zero_shot"), ("dry_land", "adapted")),
    (("residual_slush", "adapted"), ("dry_land", "adapted")),
    (("residual_slush", "zero_shot"), ("single_member", "zero_shot")),
    (("residual_slush", "adapted"), ("single_member", "adapted")),
)
"""Pairs compared at every depth: each arm with the best possible, and the arms that the paper contrasts."""

CONTRASTS: tuple[tuple[ScoredArm, ScoredArm], ...] = (
    *PAPERS_CONTRASTS,
    (("designed_throws", "zero_shot"), BEST),
    (("designed_throws", "adapted"), BEST),
    (("designed_throws", "zero_shot"), ("residual_slush", "zero_shot")),
    (("designed_throws", "adapted"), ("residual_slush", "adapted")),
    (("designed_throws", "zero_shot"), ("designed_single_member", "zero_shot")),
    (("designed_throws", "adapted"), ("designed_single_member", "adapted")),
    (("randomised_slush", "zero_shot"), BEST),
    (("randomised_slush", "adapted"), BEST),
    (("residual_slush", "zero_shot"), ("randomised_slush", "zero_shot")),
    (("residual_slush", "adapted"), ("randomised_slush", "adapted")),
)
"""All pairs: those, and those of arms that a study may have beside the paper's."""


@dataclass(frozen=True)
class Contrast:
    """One comparison of a sweep."""

    a: ScoredArm
    b: ScoredArm
    depth: float  # [m]
    comparison: Comparison = field(metadata={"prefix": False})
    student_holm: float | None  # p of Student's t, corrected over all contrasts and depths; the next likewise
    welch_holm: float | None
    mann_whitney_holm: float | None
    clustered_holm: float | None


def sweep(scores: Scores, *, rng: Generator) -> tuple[Contrast, ...]:
    """Make every contrast at every depth where both arms have trials; Holm's family is all of them."""
    made = [
        (a, b, depth, _compare_arms(scores, a, b, depth, rng))
        for a, b in CONTRASTS
        for depth in scores.depths()
        if all(np.isfinite(scores.values(*arm, depth)).any() for arm in (a, b))
    ]
    tests = ("student", "welch", "mann_whitney", "clustered")
    corrected = [holm([getattr(comparison, test).p for *_, comparison in made]) for test in tests]
    return tuple(Contrast(*row, *p) for row, *p in zip(made, *corrected, strict=True))


def _compare_arms(scores: Scores, a: ScoredArm, b: ScoredArm, depth: float, rng: Generator) -> Comparison:
    x, y = (scores.values(*arm, depth) for arm in (a, b))
    of_x, of_y = (scores.replicate[scores.rows(evolved_in, depth)] for evolved_in, _ in (a, b))
    return compare(x, y, replicates=(of_x, of_y), rng=rng)
