"""The variance between and within replicates, by arm: its share, the interval of the share, and what is unknown."""

import math

import numpy as np
import pytest
from scipy import stats

from tasks.analysis.scores import Scores
from tasks.analysis.variance_split import variances

NAN = float("nan")


def scores(values, replicate, arm="residual_slush"):
    """One arm at 9 m, whose champions have only been simulated in True Slush."""
    n = len(values)
    unknown = np.full(n, NAN)
    return Scores(
        np.array([arm] * n),
        np.full(n, 9.0),
        np.arange(n),
        predicted=unknown,
        zero_shot=np.asarray(values, float),
        adapted=unknown,
        replicate=np.asarray(replicate),
    )


def test_a_worked_example():
    """As in test_replicates: MSB = 24 and MSW = 1 of three trials in each of two replicates."""
    (row,) = variances(scores([1, 2, 3, 5, 6, 7], [0, 0, 0, 1, 1, 1]))
    assert (row.evolved_in, row.depth, row.quantity, row.n, row.n_replicates) == (
        "residual_slush",
        9.0,
        "zero_shot",
        6,
        2,
    )
    assert (row.between, row.within) == pytest.approx((23 / 3, 1))
    assert (row.sd_between, row.sd_within) == pytest.approx((math.sqrt(23 / 3), 1))
    f = [24 / stats.f.ppf(tail, 1, 4) for tail in (0.975, 0.025)]
    share = row.share_between
    assert share.value == pytest.approx(23 / 26)
    assert (share.low, share.high) == pytest.approx(tuple((of - 1) / (of + 2) for of in f))


def test_what_replicates_can_not_tell_apart_is_missing():
    (one,) = variances(scores([1, 2, 3], [0, 0, 0], arm="dry_land"))
    assert one.between is None and one.within == pytest.approx(1)
    assert one.share_between.reason == "1 replicate, expected 2 or more"
    (single,) = variances(scores([1, 2, NAN, 3], [0, 1, 1, 2]))
    assert single.n_replicates == single.n == 3 and single.within is None
    assert single.share_between.reason == "every replicate has a single trial, expected several"
    (still,) = variances(scores([2, 2, 2, 2], [0, 0, 1, 1]))
    assert still.share_between.reason == "the values have no spread"
    assert variances(scores([1, NAN], [0, 1])) == ()


def test_replicates_that_agree_have_no_share():
    (row,) = variances(scores([1, 2, 3, 1, 2, 4], [0, 0, 0, 1, 1, 1]))
    assert row.between == 0 == row.share_between.value == row.share_between.low < row.share_between.high


def test_the_interval_of_the_share_holds_it():
    """95 % of 1,000 intervals of three replicates of four trials, give or take four binomial deviations."""
    draw, inside, replicate = np.random.default_rng(1), 0, np.repeat([0, 1, 2], 4)
    for _ in range(1000):
        effect = draw.normal(0, math.sqrt(0.3), 3)
        (row,) = variances(scores(effect[replicate] + draw.normal(0, math.sqrt(0.7), 12), replicate))
        inside += row.share_between.low <= 0.3 <= row.share_between.high
    assert abs(inside / 1000 - 0.95) < 4 * 0.007
