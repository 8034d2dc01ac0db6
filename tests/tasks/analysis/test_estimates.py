"""Estimates: worked examples, what has no interval, and how often intervals hold the truth."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tasks.analysis.estimates import (
    MISSING,
    Estimate,
    Mean,
    Sample,
    between,
    bootstrap,
    error_of_mean,
    linearised,
    mean_of,
    of_means,
    ratio,
    sample_of,
    sum_of_means,
    within_replicates,
)

NAN = float("nan")


def rng(seed=0):
    return np.random.default_rng(seed)


def sample(values, replicate=None):
    values = np.asarray(values, float)
    return sample_of(values, np.zeros(len(values), int) if replicate is None else np.asarray(replicate))


def test_means_and_deviations_are_of_finite_values():
    assert mean_of(np.array([1.0, 3.0, NAN, -np.inf])) == Mean(2.0, pytest.approx(math.sqrt(2)), 2)
    assert mean_of(np.array([7.0])) == Mean(7.0, None, 1) and mean_of(np.array([NAN])) == Mean(None)


@pytest.mark.parametrize(
    ("values", "replicate", "variance", "freedom"),
    [
        # Means 2 and 6, whose deviation is 2 √2: 8 / 2.
        ([1, 2, 3, 5, 6, 7], [0, 0, 0, 1, 1, 1], 4, 1),
        # Replicates of 1 and 3 trials, whose departures from the mean of 3 add to -2 and 2: 2 (4 + 4) / 4².
        ([1, 2, 4, 5], [0, 1, 1, 1], 1, 1),
        # Trials are independent if each has a replicate of its own, or all have the same.
        ([1, 2, 3, 4], [0, 1, 2, 3], 5 / 3 / 4, 3),
        ([1, 2, 3, 4], [7, 7, 7, 7], 5 / 3 / 4, 3),
    ],
)
def test_errors_of_means_of_worked_examples(values, replicate, variance, freedom):
    nested = sample(values, replicate)
    interval = sum_of_means(nested)
    assert error_of_mean(nested) == (pytest.approx(variance), freedom)
    half = stats.t.ppf(0.975, freedom) * math.sqrt(variance)
    assert interval.high - interval.value == interval.value - interval.low == pytest.approx(half)


def test_failed_trials_are_left_out_with_their_replicates():
    whole = sample([1.0, NAN, 3.0, 4.0], [0, 1, 0, 1])
    assert whole.values.tolist() == [1, 3, 4] and whole.replicate.tolist() == [0, 0, 1]
    assert within_replicates(sample([1, 3, 10, 12, 5], [0, 0, 2, 2, 1])) == (2.0, 2)  # ± 1 twice, in three replicates


@pytest.mark.parametrize(("values", "expected"), [([], MISSING), ([3.0], Estimate(3.0)), ([2.0, 2.0], Estimate(2.0))])
def test_what_has_no_interval(values, expected):
    assert sum_of_means(sample(values, range(len(values)))) == expected


def test_a_ratio_of_nested_means_has_the_interval_of_the_delta_method():
    """For x / y, var = (var x̄ + r² var ȳ) / ȳ²."""
    x, y = sample([1, 2, 3, 5, 6, 7], [0, 0, 0, 1, 1, 1]), sample([18, 20, 22, 20])
    found, r, parts = ratio(x, y, rng=rng()), 4 / 20, (4.0, 8 / 3 / 4)
    deviation = math.sqrt(parts[0] + r**2 * parts[1]) / 20
    freedom = (parts[0] + r**2 * parts[1]) ** 2 / (parts[0] ** 2 + (r**2 * parts[1]) ** 2 / 3)
    assert found.value == pytest.approx(r)
    assert found.high - r == r - found.low == pytest.approx(stats.t.ppf(0.975, freedom) * deviation)
    assert sum(of.values.mean() for of in linearised(x, y)) == pytest.approx(0)


@pytest.mark.parametrize("replicate", [[0, 0, 0, 0], [0, 0, 1, 1]])
def test_a_ratio_to_what_may_be_nothing_has_no_interval(replicate):
    part = sample([1, 2, 3, 4], replicate)
    assert ratio(part, sample([-1.0, -2.0, -3.0]), rng=rng()) == MISSING
    shaky = ratio(part, sample([-4.0, 2.0, 3.0, 1.0]), rng=rng())
    assert shaky.value == pytest.approx(5.0) and shaky.interval is None


# -- the bootstrap ---------------------------------------------------------------------------------------------------


def of(sample, statistic=lambda means: means):
    return bootstrap(statistic, np.asarray(sample, float).reshape(len(sample), -1), rng=rng())


def test_rows_are_resampled_whole():
    """y = 2x + 1 in every row, and so in every resample."""
    x = rng(6).normal(size=20)
    (found,) = of(np.stack((x, 2 * x + 1), axis=1), statistic=lambda m: (m[..., 1] - 2 * m[..., 0])[..., None])
    assert found.value == pytest.approx(1.0) and found.interval == pytest.approx((1.0, 1.0))


def test_few_equal_or_undefined_values_have_no_interval():
    assert of([1.0, 2.0]) == (Estimate(1.5),) and of([3.0] * 10) == (Estimate(3.0),)
    assert of([-1.0, -2.0, -3.0], statistic=np.sqrt) == (MISSING,)
    (shaky,) = of([-4.0, 2.0, 3.0, 1.0], statistic=np.sqrt)  # a mean of 0.5 that is often below zero in resamples
    assert shaky.value == pytest.approx(math.sqrt(0.5)) and shaky.interval is None


# -- pseudo-values ---------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32), st.integers(2, 12), st.integers(1, 4))
def test_a_function_that_is_a_mean_has_the_interval_of_the_mean(seed, n, n_replicates):
    """Its pseudo-values are the values themselves."""
    values, replicate = rng(seed).normal(5, 1, (n, 2)), np.arange(n) % n_replicates
    for found, column in zip(of_means(lambda means: means, values, replicate), values.T, strict=True):
        expected = sum_of_means(Sample(column, replicate))
        assert (found.value, found.low, found.high) == pytest.approx((expected.value, expected.low, expected.high))


def test_functions_that_are_not_finite_have_no_value_or_no_interval():
    """The logarithm of a mean of 0, and of one that is 0 without its last trial."""
    rows = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    assert of_means(np.log, rows, np.array([0, 1, 0])) == (MISSING, Estimate(math.log(1 / 3)))


@pytest.mark.parametrize(("n_replicates", "between"), [(1, 0.0), (2, 0.0), (2, 0.5), (5, 0.0), (5, 0.5)])
def test_the_interval_of_a_nested_mean_holds_it_as_often_as_it_says(n_replicates, between):
    """Ten values of variance 1 whose trials take turns over the replicates, as those of a study do."""
    draw, replicate, holds = rng(3), np.arange(10) % n_replicates, []
    for _ in range(1000):
        effect = draw.normal(0, math.sqrt(between), n_replicates)
        found = sum_of_means(Sample(effect[replicate] + draw.normal(0, math.sqrt(1 - between), 10), replicate))
        holds.append(found.low <= 0 <= found.high)
    assert abs(np.mean(holds) - 0.95) < 4 * math.sqrt(0.95 * 0.05 / 1000)  # binomial deviations


@pytest.mark.parametrize(
    ("ends", "written"), [(("−3\u00a0%", "9\u00a0%"), "−3 to 9\u00a0%"), (("9.3", "13.5"), "9.3 to 13.5"), ((), "")]
)
def test_an_interval_has_its_unit_once(ends, written):
    assert between(*ends) == written
