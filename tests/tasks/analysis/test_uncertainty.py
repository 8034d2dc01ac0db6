import math

import numpy as np
import pytest
from scipy import stats

from tasks.analysis.uncertainty import Estimate, _acceleration, _bca, bootstrap, is_constant, mean


def rng(seed=0):
    return np.random.default_rng(seed)


def itself(means):
    return means


def of(*samples, statistic=itself, seed=0):
    columns = [np.asarray(sample, float).reshape(len(sample), -1) for sample in samples]
    return bootstrap(statistic, *columns, rng=rng(seed), undefined="it is undefined")


def test_a_mean_has_student_s_interval():
    found = mean(np.array([1.0, 2.0, 3.0, np.nan]))  # deviation 1, and t of 97.5 % with 2 degrees of freedom is 4.303
    assert found.value == 2.0 and found.reason is None
    assert found.high - 2.0 == pytest.approx(4.303 / math.sqrt(3), abs=1e-3)
    assert 2.0 - found.low == pytest.approx(4.303 / math.sqrt(3), abs=1e-3)


def test_a_mean_without_values_says_so():
    assert mean(np.array([np.nan, -np.inf])) == Estimate(None, reason="no finite value")
    assert mean(np.array([7.0])) == Estimate(7.0, reason="1 value, an interval needs 2 or more")


def test_large_samples_have_scipy_s_bca_interval():
    """At 2000 resamples the 2.5 % quantile of a skewed statistic is known to about 0.1 deviations, with either."""
    x = rng(1).exponential(1.0, 400)
    (found,) = of(x)
    expected = stats.bootstrap((x,), np.mean, n_resamples=2000, rng=rng(2)).confidence_interval
    deviation = x.std() / math.sqrt(400)
    assert found.low == pytest.approx(expected.low, abs=0.2 * deviation)
    assert found.high == pytest.approx(expected.high, abs=0.2 * deviation)
    assert found.high - found.value > 1.03 * (found.value - found.low)  # as the data are skewed


def test_the_acceleration_of_a_mean_is_its_skewness():
    """Efron & Tibshirani's (14.15): Σ (x - x̄)³ / (6 (Σ (x - x̄)²)^1.5), for a mean."""
    x = rng(9).exponential(1.0, (12, 1))
    d = x - x.mean()
    (found,) = _acceleration(itself, (x,), [x.mean(axis=0)])
    assert found == pytest.approx(np.sum(d**3) / (6 * np.sum(d**2) ** 1.5))
    assert found > 0.05


def test_ends_move_with_the_acceleration():
    """Normal resamples around the value have no bias; (14.10) then puts the ends at ± z / (1 ∓ a z)."""
    normal = stats.norm.ppf((np.arange(200_000) + 0.5) / 200_000)
    found = _bca(0.0, normal, 0.1, 1.96, "it is undefined")
    assert (found.low, found.high) == pytest.approx((-1.96 / (1 + 0.196), 1.96 / (1 - 0.196)), abs=1e-3)


def test_two_samples_have_scipy_s_acceleration():
    x, y = rng(3).exponential(1.0, 300), rng(4).normal(3.0, 1.0, 200)

    def ratio(x, y, axis=-1):
        return x.mean(axis) / y.mean(axis)

    (found,) = of(x, y, statistic=lambda x, y: x / y)
    expected = stats.bootstrap((x, y), ratio, n_resamples=2000, rng=rng(2)).confidence_interval
    deviation = x.std() / math.sqrt(300) / 3.0
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=0.2 * deviation)


@pytest.mark.parametrize(("n", "held"), [(5, 0.92), (10, 0.943), (20, 0.95)])
def test_intervals_hold_the_truth_as_often_as_the_docstring_says(n, held):
    """The count is binomial: with 600 samples its deviation is at most 0.011; four of these are allowed."""
    draw, n_samples = rng(5), 600
    inside = 0
    for i in range(n_samples):
        (found,) = of(draw.normal(5.0, 1.0, n), seed=i)
        inside += found.low is not None and found.low <= 5.0 <= found.high
    assert abs(inside / n_samples - held) < 4 * math.sqrt(held * (1 - held) / n_samples)


def test_rows_are_drawn_whole():
    """y = 2x + 1 in every row, and so in every resample."""
    x = rng(6).normal(size=20)
    (found,) = of(np.stack((x, 2 * x + 1), axis=1), statistic=lambda m: (m[..., 1] - 2 * m[..., 0])[..., None])
    assert found.value == pytest.approx(1.0)
    assert found.reason == "no interval, since the values have no spread"


def test_long_samples_are_drawn_in_parts(monkeypatch):
    whole = of(rng(7).normal(size=50))
    monkeypatch.setattr("tasks.analysis.uncertainty._MAX_MATRIX", 50 * 7)
    assert of(rng(7).normal(size=50)) == whole


def test_the_same_generator_gives_the_same_figures():
    x = rng(8).normal(size=12)
    assert of(x, seed=1) == of(x, seed=1) != of(x, seed=2)


def test_few_values_have_no_interval():
    assert of([1.0, 2.0]) == (Estimate(1.5, reason="2 values, an interval needs 3 or more"),)


def test_equal_values_have_no_interval():
    assert of([3.0] * 10) == (Estimate(3.0, reason="no interval, since the values have no spread"),)


def test_an_undefined_figure_says_why():
    def root(means):
        return np.sqrt(means)

    assert of([-1.0, -2.0, -3.0], statistic=root) == (Estimate(None, reason="it is undefined"),)
    assert of([-1.0, -2.0], statistic=root) == (Estimate(None, reason="it is undefined"),)
    (shaky,) = of([-4.0, 2.0, 3.0, 1.0], statistic=root)  # a mean of 0.5 that is often below zero in resamples
    assert shaky.value == pytest.approx(math.sqrt(0.5)) and shaky.low is None
    assert shaky.reason.startswith("no interval, since in ") and shaky.reason.endswith("it is undefined")


def test_rounding_is_no_spread():
    assert is_constant(np.array([0.1 + 0.2, 0.3])) and is_constant(np.zeros(3)) and is_constant(np.zeros(0))
    assert not is_constant(np.array([1.0, 1.0 + 1e-9]))
