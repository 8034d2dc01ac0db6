"""Prediction accuracy: regressions on members and aggregates, their intervals, and ranges over members."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from tasks.analysis.estimates import MISSING
from tasks.analysis.registry import ANALYSES
from tasks.analysis.study import Assessed
from tasks.analysis.tables.regressions import accuracy, predictors_of, regressions


def assess(predicted, true, trial=None, replicate=None):
    predicted, true = np.atleast_2d(np.asarray(predicted, float)), np.asarray(true, float)
    trial = [str(k) for k in (np.arange(len(true)) if trial is None else trial)]
    replicate = np.zeros(len(true), int) if replicate is None else replicate
    return accuracy(Assessed(predicted, true, trial, replicate), "residual_slush", np.random.default_rng(0))


def one(predicted, true, **options):
    return assess(predicted, true, **options)[0]


def noisy(n, slope, noise):
    draw = np.random.default_rng(1)
    x = draw.normal(3.0, 2.0, n)
    return x, slope * x - 1.0 + draw.normal(0.0, noise, n)


def test_predictions_are_calibrated_if_designs_get_to_within_two_deviations():
    """Members are 1 to either side of μ, so σ = 1; designs are off by 0, 1, 2, 3 and 9, and one diverged."""
    mean = np.array([5.0, 6.0, 7.0, 8.0, 9.0, 4.0])
    found = assess([mean - 1, mean + 1], mean + np.array([0, 1, -2, 3, -9, np.nan]))
    assert [row.within for row in found] == [None, None, 3 / 5, None]


def test_equals_scipy_far_from_the_origin():
    x, y = noisy(300, 0.7, 1.5)
    found, expected = one(x + 1e6, y - 1e6), stats.linregress(x + 1e6, y - 1e6)
    figures = (found.slope.value, found.r.value, found.intercept.value)
    assert figures == pytest.approx((expected.slope, expected.rvalue, expected.intercept), rel=1e-6)


def test_the_interval_of_a_slope_is_that_of_theory():
    """noise / (sx √n) = 1.5 / (2 · √400) is a slope's deviation; that of 2000 resamples is within 5 % of it."""
    x, y = noisy(400, 0.7, 1.5)
    found = one(x, y).slope
    deviation = (y - 0.7 * x + 1.0).std() / (x.std() * math.sqrt(400))
    assert found.high - found.low == pytest.approx(2 * 1.96 * deviation, rel=0.15)


def test_designs_of_a_trial_count_as_one():
    """Ten copies of each design say no more than one: the interval is that of the trials."""
    x, y = noisy(30, 0.7, 1.5)
    copies = np.repeat(np.arange(30), 10)
    numbers = np.array([f"{k:02d}" for k in range(30)])
    once, ten = one(x, y, trial=numbers), one(x[copies], y[copies], trial=numbers[copies])
    naive = one(x[copies], y[copies])
    assert (ten.slope.low, ten.slope.high) == pytest.approx((once.slope.low, once.slope.high), rel=1e-9)
    assert naive.slope.high - naive.slope.low < 0.5 * (once.slope.high - once.slope.low)


def test_diverged_designs_are_left_out():
    x, y = noisy(50, 0.7, 0.5)
    x[:3], y[1:6] = (np.nan, -np.inf, np.nan), np.nan
    assert one(x, y).slope.value == pytest.approx(stats.linregress(x[6:], y[6:]).slope)


@pytest.mark.parametrize("predicted", [[1.0, 2.0], [np.nan] * 9, [2.0] * 9])
def test_what_cannot_be_regressed_is_missing(predicted):
    found = one(predicted, range(len(predicted)))
    assert found.slope == found.intercept == found.r == MISSING


def test_equal_truths_have_a_slope_but_no_correlation():
    found = one(np.arange(9), [2.0] * 9)
    assert found.slope.value == 0.0 and found.intercept.value == 2.0 and found.r == MISSING


def test_aggregates_of_a_worked_example():
    """Members say 0, 2, 4, 10: mean 4, deviation √14."""
    found = predictors_of(np.array([[10.0], [2.0], [0.0], [4.0]]))
    assert list(found) == ["member 0", "member 1", "member 2", "member 3", "mean", "mean - 1 sd"]
    assert found["mean"][0] == 4.0 and found["mean - 1 sd"][0] == pytest.approx(4 - math.sqrt(14))


def test_with_replicates_the_intervals_include_the_variance_between_them():
    """Networks that exaggerate by a factor of their replicate: the slope's pseudo-values are nested."""
    draw = np.random.default_rng(3)
    trial, true = np.repeat(np.arange(12), 20), draw.normal(5, 3, 240)
    replicate = trial % 3
    predicted = true * np.array([1.0, 1.3, 1.7])[replicate] + draw.normal(0, 0.5, 240)
    nested, plain = one(predicted, true, trial=trial, replicate=replicate), one(predicted, true, trial=trial)
    assert nested.slope.value == pytest.approx(plain.slope.value)
    assert nested.slope.high - nested.slope.low > 1.5 * (plain.slope.high - plain.slope.low)
    assert -1 < nested.r.low < nested.r.value < nested.r.high < 1


def test_every_ensemble_is_assessed_and_the_main_one_gives_the_metrics():
    x, y = noisy(60, 0.5, 1.0)
    assessed = Assessed(np.stack((x, x + 0.1)), y, [str(k) for k in range(60)], np.zeros(60, int))
    study = SimpleNamespace(
        settings=SimpleNamespace(data_sets=("residual_slush", "designed_throws", "none")),
        assessed=lambda group: None if group == "none" else assessed,
        rng=lambda *identity: np.random.default_rng(0),
    )
    rows = regressions(study)
    assert [row.learned_from for row in rows] == ["residual_slush"] * 4 + ["designed_throws"] * 4
    metrics = ANALYSES["regressions"].metrics(rows)
    assert metrics["accuracy.r.mean"] == rows[2].r.value and "accuracy.slope.mean_less_1_sd" in metrics
