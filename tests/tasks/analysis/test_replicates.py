"""Trials nested in replicates: what the model is with one replicate, worked examples, and coverage of its intervals."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tasks.analysis.comparison import clustered, difference, nested_difference, nested_ratio, ratio, welch
from tasks.analysis.replicates import (
    NestedSample,
    components,
    error_of,
    from_replicates_means,
    linearised,
    mean_of,
    nested,
    nested_sample,
    of_means,
    ratio_of_sums,
    sum_of_means,
    terms_of_ratio,
)
from tasks.analysis.uncertainty import Estimate, mean

N_SAMPLES = 1000
NAN = float("nan")


def rng(seed=0):
    return np.random.default_rng(seed)


def sample(values, replicate=None):
    values = np.asarray(values, float)
    return nested_sample(values, np.zeros(len(values), int) if replicate is None else np.asarray(replicate))


def planted(draw, n_replicates, n=10, between=0.5, centre=0.0):
    """Values of variance 1 whose trials take turns over the replicates, as those of a study do."""
    replicate = np.arange(n) % n_replicates
    effect = draw.normal(0, math.sqrt(between), n_replicates)
    return NestedSample(centre + effect[replicate] + draw.normal(0, math.sqrt(1 - between), n), replicate)


@given(st.integers(0, 2**32), st.integers(2, 12), st.integers(2, 12), st.integers(0, 9))
def test_one_replicate_is_student_and_welch(seed, n_x, n_y, replicate):
    draw = rng(seed)
    values = draw.normal(5, 1, n_x), draw.normal(4, 2, n_y)
    x, y = (sample(of, np.full(len(of), replicate)) for of in values)
    assert mean_of(x) == mean(values[0])
    assert nested_difference(x, y) == difference(*values)
    assert nested_difference(x, y, equal_variances=False) == difference(*values, equal_variances=False)
    assert clustered(x, y) == welch(*values)
    assert nested_ratio(x, y, rng=rng(1)) == ratio(*values, rng=rng(1))
    # Not by another way alone: the model itself has no variance between replicates then.
    for one, plain in (
        (sum_of_means(x), mean(values[0])),
        (sum_of_means(x, y.scaled(-1)), difference(*values, equal_variances=False)),
    ):
        assert (one.value, one.low, one.high) == pytest.approx((plain.value, plain.low, plain.high))


def test_a_balanced_worked_example():
    """Means 2 and 6 of three trials each: MSB = 3 · (2² + 2²) / 1 = 24, MSW = (2 + 2) / 4 = 1, n0 = 3."""
    found = components(sample([1, 2, 3, 5, 6, 7], [0, 0, 0, 1, 1, 1]))
    assert (found.between, found.within, found.f, found.n_per_replicate) == pytest.approx((23 / 3, 1, 24, 3))
    assert (found.error.variance, found.error.freedom) == pytest.approx((24 / 6, 1))  # MSB / N with R - 1
    interval = mean_of(sample([1, 2, 3, 5, 6, 7], [0, 0, 0, 1, 1, 1]))
    assert interval.high - interval.value == pytest.approx(stats.t.ppf(0.975, 1) * 2)


def test_replicates_that_agree_are_pooled():
    """Both means are 2, so MSB = 0, and six independent trials have a variance of 4 / 5."""
    found = components(sample([1, 2, 3, 1, 2, 3], [0, 0, 0, 1, 1, 1]))
    assert (found.between, found.within) == pytest.approx((0, 0.8))
    assert (found.error.variance, found.error.freedom) == pytest.approx((0.8 / 6, 5))


def test_a_trial_in_each_replicate_is_students():
    values = rng(1).normal(0, 1, 6)
    found = components(sample(values, range(6)))
    assert found.error.variance == pytest.approx(values.var(ddof=1) / 6) and found.error.freedom == 5
    assert math.isnan(found.between) and math.isnan(found.within)  # nothing tells them apart


def test_unequal_replicates_have_the_variance_of_their_mean():
    """Sizes 5, 3 and 1: k = 35 / 9, and the variance of the mean is (k · 0.9 + 0.1) / 9.

    The variance between replicates is so large that truncation at 0 is rare. Four deviations of a mean square of two
    degrees of freedom, over 2,000 samples, are 4 / √2000 of it.
    """
    draw, replicate = rng(2), np.repeat([0, 1, 2], [5, 3, 1])
    found = []
    for _ in range(2000):
        effect = draw.normal(0, math.sqrt(0.9), 3)
        found.append(components(NestedSample(effect[replicate] + draw.normal(0, math.sqrt(0.1), 9), replicate)))
    kept = [of for of in found if of.between > 0]
    assert len(kept) > 1900
    close = {"rel": 4 / math.sqrt(2000)}
    assert np.mean([of.error.variance for of in found]) == pytest.approx((35 / 9 * 0.9 + 0.1) / 9, **close)
    assert np.mean([of.between for of in found]) == pytest.approx(0.9, **close)
    assert np.mean([of.within for of in kept]) == pytest.approx(0.1, **close)
    assert np.median([of.error.freedom for of in found]) == pytest.approx(2, abs=0.1)  # R - 1


def test_failed_trials_are_left_out_with_their_replicates():
    whole = nested_sample(np.array([1.0, NAN, 3.0, 4.0]), np.array([0, 1, 0, 1]))
    assert whole.values.tolist() == [1, 3, 4] and whole.replicate.tolist() == [0, 0, 1]
    assert not nested(nested_sample(np.array([1.0, NAN, 3.0]), np.array([0, 1, 0])))


def test_variances_add_and_degrees_of_freedom_are_welchs():
    x, y = sample([1, 2, 3, 5, 6, 7], [0, 0, 0, 1, 1, 1]), sample([1, 2, 3, 4])
    error, parts = error_of(x, y), (4.0, 5 / 3 / 4)  # of variances 5 / 3 and one replicate for y
    assert error.variance == pytest.approx(sum(parts))
    assert error.freedom == pytest.approx(sum(parts) ** 2 / (parts[0] ** 2 / 1 + parts[1] ** 2 / 3))
    found, t = clustered(x, y), 1.5 / math.sqrt(sum(parts))
    assert (found.statistic, found.p) == pytest.approx((t, 2 * stats.t.sf(t, error.freedom)))
    interval = nested_difference(x, y)
    assert interval.value == 1.5 and (interval.low < 0 < interval.high) == (found.p > 0.05)


def test_what_has_no_interval_says_why():
    one, none = sample([3.0]), sample([])
    assert sum_of_means(one, sample([1.0, 2.0], [0, 1])) == Estimate(
        4.5, reason="1 and 2 values, an interval needs 2 or more in each group"
    )
    assert sum_of_means(none, one).reason == "0 and 1 finite values, expected 1 or more in each group"
    still = sample([2.0, 2.0], [0, 1])
    assert sum_of_means(still) == Estimate(2.0, reason="no interval, since the values have no spread")
    assert clustered(still, still).reason == "both groups are constant"


def test_a_ratio_of_sums_has_the_interval_of_the_delta_method():
    """For x / y, var = (var x̄ + r² var ȳ) / ȳ²."""
    x, y = sample([1, 2, 3, 5, 6, 7], [0, 0, 0, 1, 1, 1]), sample([18, 20, 22, 20])
    found = ratio_of_sums(*terms_of_ratio(x, y), undefined="it is undefined")
    r, parts = 4 / 20, (4.0, 8 / 3 / 4)
    deviation = math.sqrt(parts[0] + r**2 * parts[1]) / 20
    freedom = (parts[0] + r**2 * parts[1]) ** 2 / (parts[0] ** 2 + (r**2 * parts[1]) ** 2 / 3)
    assert found.value == pytest.approx(r)
    assert found.high - r == r - found.low == pytest.approx(stats.t.ppf(0.975, freedom) * deviation)
    assert sum(of.values.mean() for of in linearised(*terms_of_ratio(x, y))) == pytest.approx(0)


@pytest.mark.parametrize(
    ("whole", "reason"),
    [([-1, -2], "it is undefined"), ([-4, 2, 3, 1], "no interval, since within that of the reference it is undefined")],
)
def test_a_ratio_to_what_may_be_nothing_has_no_interval(whole, reason):
    part = sample([1, 2, 3, 4], [0, 0, 1, 1])
    found = ratio_of_sums(*terms_of_ratio(part, sample(whole)), undefined="it is undefined")
    assert found.low is None and found.reason == reason and (found.value is None) == (reason == "it is undefined")


def test_departures_are_from_the_means_of_replicates():
    assert from_replicates_means(sample([1, 3, 10, 12, 5], [0, 0, 2, 2, 1])).tolist() == [-1, 1, -1, 1, 0]
    assert from_replicates_means(sample([])).tolist() == []


def inside(found, truth):
    return found.low <= truth <= found.high


def near(rates, nominal):
    """Whether the share of 1,000 flags lies within four binomial deviations of the rate that is stated."""
    return abs(np.mean(rates) - nominal) < 4 * math.sqrt(nominal * (1 - nominal) / N_SAMPLES)


STATED = json.loads((Path(__file__).parents[3] / "docs" / "results" / "intervals.json").read_text())["means"]
"""The rates of 20,000 samples, nominally 95 %, which docs/results.md shows."""


@pytest.mark.parametrize(
    ("n_replicates", "rate", "students"),
    [(1, 0.95, 0.95), *((row["n_replicates"], row["mean"], row["students"]) for row in STATED)],
)
def test_the_interval_of_a_mean_holds_it(n_replicates, rate, students):
    """With one replicate, nothing is planted between."""
    draw = rng(3)
    found = [planted(draw, n_replicates, between=0.5 * (n_replicates > 1)) for _ in range(N_SAMPLES)]
    assert near([inside(mean_of(of), 0) for of in found], rate)
    assert near([inside(mean(of.values), 0) for of in found], students)


@pytest.mark.parametrize(
    ("n_replicates", "of_difference", "of_ratio"),
    [(row["n_replicates"], row["difference"], row["share"]) for row in STATED],
)
def test_intervals_of_a_comparison_with_an_arm_without_replicates_hold_the_truth(n_replicates, of_difference, of_ratio):
    """As those of Residual Slush with True Slush: 9.1 and 13.6 m, ten trials of deviation 1 m each."""
    draw = rng(4)
    pairs = [(planted(draw, n_replicates, centre=9.1), sample(draw.normal(13.6, 1, 10))) for _ in range(N_SAMPLES)]
    assert near([inside(nested_difference(*pair, equal_variances=False), 9.1 - 13.6) for pair in pairs], of_difference)
    assert near([inside(nested_ratio(*pair, rng=draw), 9.1 / 13.6) for pair in pairs], of_ratio)


def identity(means):
    return means


@given(st.integers(0, 2**32), st.integers(2, 12), st.integers(1, 4))
def test_a_function_that_is_a_mean_has_the_interval_of_the_mean(seed, n, n_replicates):
    """Its pseudo-values are the values themselves."""
    values, replicate = rng(seed).normal(5, 1, (n, 2)), np.arange(n) % n_replicates
    found = of_means(identity, values, replicate, undefined="it is undefined")
    for one, column in zip(found, values.T, strict=True):
        expected = sum_of_means(NestedSample(column, replicate))
        assert (one.value, one.low, one.high) == pytest.approx((expected.value, expected.low, expected.high))


def test_a_ratio_has_nearly_the_same_interval_by_pseudo_values_as_by_the_delta_method():
    """Both linearise x / y; they differ by terms of 1 / n."""
    pairs, replicate = rng(5).normal((5, 20), (1, 2), (60, 2)), np.arange(60) % 3
    (found,) = of_means(lambda means: means[..., :1] / means[..., 1:], pairs, replicate, undefined="it is undefined")
    x, y = (NestedSample(column, replicate) for column in pairs.T)
    expected = ratio_of_sums((x, y), undefined="it is undefined")
    assert found.value == pytest.approx(expected.value)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), rel=2 / 60)


def test_functions_that_are_not_finite_say_why():
    """The logarithm of a mean of 0, and of one that is 0 without its last trial."""
    rows = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    nothing, without = of_means(np.log, rows, np.array([0, 1, 0]), undefined="it is undefined")
    assert nothing == Estimate.missing("it is undefined")
    assert without == Estimate(math.log(1 / 3), reason="no interval, since without one of the trials it is undefined")
