import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from tasks.analysis.prediction import accuracy, aggregates, histograms, members_ranges, regress


def rng(seed=0):
    return np.random.default_rng(seed)


def one(predicted, true, **kwargs):
    return regress({"it": np.asarray(predicted, float)}, np.asarray(true, float), rng=rng(), **kwargs)[0]


def noisy(n, slope, noise, seed=1):
    draw = rng(seed)
    x = draw.normal(3.0, 2.0, n)
    return x, slope * x - 1.0 + draw.normal(0.0, noise, n)


def test_a_worked_example():
    found = one([0, 1, 2, 3], [1, 3, 2, 6])  # Sxx = 5, Sxy = 7, Syy = 14; means 1.5 and 3
    assert found.slope.value == pytest.approx(7 / 5)
    assert found.intercept.value == pytest.approx(3 - 1.5 * 7 / 5)
    assert found.r.value == pytest.approx(7 / math.sqrt(5 * 14))
    assert (found.n, found.n_left_out) == (4, 0)


def test_equals_scipy_far_from_the_origin():
    x, y = noisy(300, 0.7, 1.5)
    found, expected = one(x + 1e6, y - 1e6), stats.linregress(x + 1e6, y - 1e6)
    assert found.slope.value == pytest.approx(expected.slope, rel=1e-6)
    assert found.r.value == pytest.approx(expected.rvalue, rel=1e-6)
    assert found.intercept.value == pytest.approx(expected.intercept, rel=1e-6)


def test_an_exact_line_is_found():
    x = np.linspace(-2, 5, 30)
    found = one(x, 1.26 * x + 0.3)
    assert (found.slope.value, found.intercept.value, found.r.value) == pytest.approx((1.26, 0.3, 1.0))


def test_the_interval_of_a_slope_is_that_of_theory():
    """noise / (sx √n) = 1.5 / (2 · √400) is a slope's deviation; that of 2000 resamples is within 5 % of it."""
    x, y = noisy(400, 0.7, 1.5)
    found = one(x, y).slope
    deviation = (y - 0.7 * x + 1.0).std() / (x.std() * math.sqrt(400))
    assert found.high - found.low == pytest.approx(2 * 1.96 * deviation, rel=0.15)


def test_intervals_hold_slope_and_r():
    """95 % of 400 intervals, give or take four binomial deviations of 0.011."""
    true_r = 0.5 * 2 / math.hypot(0.5 * 2, 1.5)
    inside = np.zeros(2)
    for seed in range(400):
        found = one(*noisy(60, 0.5, 1.5, seed))
        inside += (found.slope.low <= 0.5 <= found.slope.high, found.r.low <= true_r <= found.r.high)
    assert (abs(inside / 400 - 0.95) < 0.044).all()


def test_designs_of_a_trial_count_as_one_when_told_so():
    """Ten copies of each design say no more than one: the interval is that of the trials."""
    x, y = noisy(30, 0.7, 1.5)
    copies = np.repeat(np.arange(30), 10)
    once, ten = one(x, y), one(x[copies], y[copies], trial=copies)
    naive = one(x[copies], y[copies])
    assert ten.slope.value == pytest.approx(once.slope.value)
    assert (ten.slope.low, ten.slope.high) == pytest.approx((once.slope.low, once.slope.high), rel=1e-9)
    assert naive.slope.high - naive.slope.low < 0.5 * (once.slope.high - once.slope.low)
    assert ten.n == 300


def test_diverged_designs_are_left_out_of_the_regressions_that_they_are_in():
    x, y = noisy(50, 0.7, 0.5)
    holed, holed_y = x.copy(), y.copy()
    holed[:3], holed_y[1:6] = (np.nan, -np.inf, np.nan), np.nan
    found = regress({"holed": holed, "whole": x}, holed_y, rng=rng())
    assert [(row.n, row.n_left_out) for row in found] == [(44, 6), (45, 5)]
    assert found[0].slope.value == pytest.approx(stats.linregress(x[6:], y[6:]).slope)


@pytest.mark.parametrize(
    ("predicted", "true", "reason"),
    [
        ([1.0, 2.0], [1.0, 2.0], "2 designs with a finite predicted and true displacement, expected 3 or more"),
        ([np.nan] * 9, [1.0] * 9, "0 designs with a finite predicted and true displacement, expected 3 or more"),
        ([], [], "0 designs with a finite predicted and true displacement, expected 3 or more"),
        ([2.0] * 9, range(9), "every design is predicted to go equally far"),
    ],
)
def test_what_cannot_be_regressed_says_why(predicted, true, reason):
    found = one(predicted, list(true))
    for figure in (found.slope, found.intercept, found.r):
        assert (figure.value, figure.low, figure.high, figure.reason) == (None, None, None, reason)


def test_equal_truths_have_a_slope_but_no_correlation():
    found = one(np.arange(9), [2.0] * 9)
    assert found.slope.value == 0.0 and found.intercept.value == 2.0
    assert found.r.value is None and found.r.reason == "every design truly goes equally far"


def test_shapes_that_do_not_match_are_refused():
    with pytest.raises(ValueError, match=r"true has shape \(4,\), expected that of each predictor, \(3,\)"):
        one([1, 2, 3], [1, 2, 3, 4])


def test_aggregates_of_a_worked_example():
    """Members say 0, 2, 4, 10: mean 4, deviation √14; a quarter of four members is the one that says 0."""
    found = {name: row[0] for name, row in aggregates(np.array([[10.0], [2.0], [0.0], [4.0]])).items()}
    assert found["mean"] == 4.0
    assert found["mean - 1 sd"] == pytest.approx(4 - math.sqrt(14))
    assert found["mean - 0.5 sd"] == pytest.approx(4 - math.sqrt(14) / 2)
    assert (found["min"], found["median"], found["quantile 0.25"], found["CVaR 0.25"]) == (0.0, 3.0, 1.5, 0.0)


def test_cvar_takes_a_member_in_part():
    """A quarter of six members is the lowest and half of the next: (1 + 2 / 2) / 1.5."""
    found = aggregates(np.array([[6.0], [5.0], [4.0], [3.0], [2.0], [1.0]]))
    assert found["CVaR 0.25"][0] == pytest.approx(2 / 1.5)


def test_a_design_that_diverged_for_one_member_has_no_aggregate():
    for name, row in aggregates(np.array([[1.0, 1.0], [np.nan, 2.0]])).items():
        assert not np.isfinite(row[0]) and np.isfinite(row[1]), name


def test_accuracy_has_a_row_for_every_member_and_aggregate():
    draw = rng(2)
    true = draw.normal(5, 3, 200)
    predicted = 0.5 * true + draw.normal(0, 2, (8, 200))
    rows = {row.name: row for row in accuracy(predicted, true, rng=rng())}
    assert list(rows) == [f"member {k}" for k in range(8)] + list(aggregates(predicted))
    # Averaging over 8 members leaves an eighth of the noise's variance: R² = 2.25 / (2.25 + 4/8), not 2.25 / 6.25.
    assert rows["member 0"].r.value == pytest.approx(0.6, abs=4 * (1 - 0.36) / math.sqrt(200))
    assert rows["mean"].r.value == pytest.approx(math.sqrt(2.25 / 2.75), abs=4 * (1 - 0.82) / math.sqrt(200))


def test_no_members_give_no_rows():
    assert accuracy(np.empty((0, 5)), np.arange(5.0), rng=rng()) == ()


def test_histograms_count_every_design_once():
    draw = rng(3)
    x, y = draw.normal(size=(2, 5000))
    x[0], y[1], x[2] = np.nan, np.inf, 1e6  # two that diverged, and one beyond the square
    found = histograms({"a": x, "b": y}, y, n_bins=20)
    assert found.counts.shape == (2, 20, 20) and found.edges.shape == (21,) and found.reason is None
    assert (found.counts.sum(axis=(1, 2)) + found.n_outside == 5000).all()
    assert 3 <= found.n_outside[0] <= 3 + 5000 * 4 * 0.002
    assert (found.counts[1] == np.diag(np.diag(found.counts[1]))).all()  # y against itself lies on the diagonal


def test_histograms_are_predicted_by_true():
    found = histograms({"a": np.array([0.0, 0.0, 0.0])}, np.array([0.0, 1.0, 1.0]), n_bins=2)
    assert found.counts.tolist() == [[[1, 2], [0, 0]]]


def test_histograms_of_nothing_say_why():
    found = histograms({"a": np.full(4, np.nan)}, np.arange(4.0))
    assert found.counts.shape == (1, 0, 0) and found.n_outside.tolist() == [4]
    assert found.reason == "no design with a finite predicted and true displacement"


def test_a_histogram_of_one_value_has_one_full_bin():
    found = histograms({"a": np.full(4, 2.0)}, np.full(4, 2.0), n_bins=5)
    assert found.counts.max() == 4


def test_the_ends_of_a_range_are_the_members_that_are_there():
    """Three members so far apart that the order is the same in every resample: each end's interval is that member's."""
    draw = rng(8)
    true = draw.normal(3.0, 2.0, 60)
    trial = np.repeat(np.arange(20), 3)
    predicted = np.stack([true + draw.normal(0, noise, 60) for noise in (6.0, 0.1, 1.5)])
    found = members_ranges(predicted, true, rng=rng(), trial=trial)["r"]
    assert found.n == 3
    for end, row in ((found.lowest, 0), (found.highest, 1), (found.median, 2)):
        alone = regress({"it": predicted[row]}, true, rng=rng(), trial=trial)[0].r
        assert (end.value, end.low, end.high) == pytest.approx((alone.value, alone.low, alone.high), rel=1e-9)


def test_members_without_a_regression_are_left_out_of_their_range():
    x, y = noisy(30, 0.7, 0.5)
    predicted = np.stack([x, np.full(30, 2.0), np.where(np.arange(30) < 2, x, np.nan)])
    found = members_ranges(predicted, y, rng=rng())["slope"]
    assert found.n == 1 and found.lowest == found.median == found.highest
    assert found.lowest.value == pytest.approx(stats.linregress(x, y).slope)
    none = members_ranges(predicted[1:], y, rng=rng())["r"]
    assert (none.n, none.lowest.value, none.lowest.reason) == (0, None, "no member has a regression")
    flat = members_ranges(predicted, np.ones(30), rng=rng())
    assert flat["r"].median.value is None and flat["slope"].median.value == 0.0


@settings(max_examples=20)
@given(st.integers(0, 2**32), st.integers(3, 9), st.integers(0, 9))
def test_one_replicate_has_the_intervals_of_resampled_trials(seed, n_trials, replicate):
    draw = rng(seed)
    trial = np.repeat(np.arange(n_trials), 4)
    true = draw.normal(3.0, 2.0, len(trial))
    predicted = true + draw.normal(0.0, 1.0, (2, len(trial)))
    of = {"trial": trial, "replicate": np.full(len(trial), replicate)}
    assert accuracy(predicted, true, rng=rng(), **of) == accuracy(predicted, true, rng=rng(), trial=trial)
    assert members_ranges(predicted, true, rng=rng(), **of) == members_ranges(predicted, true, rng=rng(), trial=trial)


N_STUDIES = 1000
GAIN = 0.2
"""Deviation over replicates of the factor by which networks exaggerate."""


def planted(draw, n_replicates, n_trials=20, n=30):
    """Truth, predictions, trial and replicate of 30 designs of each of 20 trials, ten of each of two environments.

    Truths have variance 1, of which 0.3 between trials. Predictions are g times the truth plus an error of variance
    0.5, of which 0.2 between trials; g has mean 1 over replicates.
    """
    trial = np.repeat(np.arange(n_trials), n)
    replicate = trial % (n_trials // 2) % n_replicates
    true, error = (
        draw.normal(0, math.sqrt(between), n_trials)[trial] + draw.normal(0, math.sqrt(within), len(trial))
        for between, within in ((0.3, 0.7), (0.2, 0.3))
    )
    return true, draw.normal(1, GAIN, n_replicates)[replicate] * true + error, trial, replicate


def holds(found, truths):
    return [figure.low <= truth <= figure.high for figure, truth in zip((found.r, found.slope), truths, strict=True)]


STATED = json.loads((Path(__file__).parents[3] / "docs" / "results" / "intervals.json").read_text())["accuracy"]
"""The rates of 10,000 samples, nominally 95 %, and of 3,000 where trials are resampled, which docs/results.md shows."""


def near(rates, stated):
    """Whether the shares of flags lie within four binomial deviations of the rates that are stated."""
    return all(
        abs(rate - of) < 4 * math.sqrt(of * (1 - of) / len(rates))
        for rate, of in zip(np.mean(rates, axis=0), stated, strict=True)
    )


@pytest.mark.parametrize("row", STATED, ids=lambda row: f"{row['n_replicates']} replicates")
def test_intervals_of_several_replicates_hold_r_and_slope(row):
    """Over all replicates, predictions have variance 1 + GAIN² + 0.5 and covariance 1 with the truth."""
    draw, variance = rng(6), 1 + GAIN**2 + 0.5
    truths = (1 / math.sqrt(variance), 1 / variance)
    nested, of_trials = [], []
    for k in range(N_STUDIES):
        true, predicted, trial, replicate = planted(draw, row["n_replicates"])
        nested.append(holds(one(predicted, true, trial=trial, replicate=replicate), truths))
        if k % 5 == 0:  # they take long
            of_trials.append(holds(one(predicted, true, trial=trial), truths))
    assert near(nested, (row["r"], row["slope"])) and near(of_trials, (row["r_of_trials"], row["slope_of_trials"]))


def test_an_exact_line_has_no_interval_with_several_replicates():
    x, trial = np.arange(24.0), np.repeat(np.arange(6), 4)
    found = one(x, 2 * x, trial=trial, replicate=trial % 2)
    assert (found.slope.value, found.r.value, found.n_replicates) == pytest.approx((2, 1, 2))
    assert found.r.low is None and found.r.reason == "no interval, since the values have no spread"


def test_ends_of_a_range_include_the_variance_between_replicates():
    """Members so far apart that the order never changes: each end is that member, as with one replicate."""
    draw = rng(9)
    true, _, trial, replicate = planted(draw, 2)
    predicted = np.stack([true + draw.normal(0, noise, len(true)) for noise in (6.0, 0.1, 1.5)])
    of = {"trial": trial, "replicate": replicate}
    found = members_ranges(predicted, true, rng=rng(), **of)
    for end, row in (("lowest", 0), ("highest", 1), ("median", 2)):
        assert getattr(found["r"], end) == one(predicted[row], true, **of).r
