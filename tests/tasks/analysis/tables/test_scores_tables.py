"""Tables that are made of scores alone: transfer and variance."""

import math

import numpy as np
import pytest
from scipy import stats
from scores_of import study_of, trials_of

from tasks.analysis.estimates import MISSING, Mean
from tasks.analysis.scores import BEST, ScoredTrial, arm_name, arms, sample
from tasks.analysis.tables.transfer import papers_mean, transfer, transfer_rows
from tasks.analysis.tables.variance import variance

NAN = float("nan")
E = ("true_slush", 9.0)


def test_a_row_of_the_transfer_table():
    zero_shot = {E: [9.0, 11.0], ("residual_slush", 9.0): [4.0, 8.0], ("residual_slush", 1.0): [3.0, NAN]}
    rows = transfer(study_of(zero_shot, adapted={E: [14.0, 16.0], ("residual_slush", 9.0): [7.0, 8.0]}))
    assert [(row.environment, row.depth, row.n) for row in rows] == [
        ("true_slush", 9.0, 2),
        ("residual_slush", 9.0, 2),
        ("residual_slush", 1.0, 2),
    ]
    best, residual, shallow = rows
    assert residual.zero_shot == Mean(6.0, pytest.approx(math.sqrt(8)), 2)
    assert (residual.zero_shot_share, residual.adapted_share) == pytest.approx((0.6, 0.75))
    assert (residual.adapted_share_of_adapted, best.adapted_share) == pytest.approx((0.5, 1.5))
    assert (best.paper_zero_shot, residual.paper_adapted) == pytest.approx((13.6, 0.87 * 13.6))
    assert shallow.zero_shot == Mean(3.0, None, 1) and shallow.zero_shot_share is None is shallow.paper_zero_shot


def test_sigma_and_fitness_are_of_ensembles_alone():
    trials = [
        ScoredTrial("residual_slush", 9.0, 0, 0, fitness=3.0, predicted=5.0, predicted_sd=2.0, status="ok"),
        ScoredTrial("dry_land", 9.0, 0, 0, fitness=7.0, predicted=7.0, status="ok"),
    ]
    land, residual = transfer_rows(trials)
    assert (residual.sigma, residual.fitness, residual.predicted.value) == (2.0, 3.0, 5.0)
    assert (land.sigma, land.fitness, land.predicted.value) == (None, None, 7.0)


def test_arms_are_listed_the_deepest_first_and_trials_by_number_with_their_replicates():
    table = trials_of({("dry_land", 1.0): [0], ("true_slush", 1.0): [0], ("dry_land", 9.0): [0]})
    assert arms(table) == [("dry_land", 9.0), ("true_slush", 1.0), ("dry_land", 1.0)]
    trials = [ScoredTrial("residual_slush", 9.0, k, k % 2 + 5, zero_shot=z) for k, z in ((2, 2.0), (0, 0.0), (1, NAN))]
    found = sample(trials, ("residual_slush", "zero_shot"), 9.0)
    assert (found.values.tolist(), found.replicate.tolist()) == ([0.0, 2.0], [5, 5])
    assert (arm_name(BEST), arm_name(("dry_land", "adapted"))) == ("True Slush", "Dry Land adapted")


def test_the_papers_means_are_at_its_depth_alone():
    assert papers_mean("residual_slush", "zero_shot", 9.0) == pytest.approx(0.67 * 13.6)
    assert papers_mean("residual_slush", "zero_shot", 3.0) is None is papers_mean("single_member", "adapted", 9.0)


def test_variance_of_a_worked_example():
    """MSB = 24 and MSW = 1 of three trials in each of two replicates."""
    values = np.empty(6)
    values[0::2], values[1::2] = [1, 2, 3], [5, 6, 7]
    (row,) = variance(study_of({("residual_slush", 9.0): values}, n_replicates=2))
    assert (row.quantity, row.n, row.n_replicates) == ("zero_shot", 6, 2)
    assert (row.sd_between, row.sd_within) == pytest.approx((math.sqrt(23 / 3), 1))
    f = [24 / stats.f.ppf(tail, 1, 4) for tail in (0.975, 0.025)]
    assert row.share_between.value == pytest.approx(23 / 26)
    assert row.share_between.interval == pytest.approx(tuple((of - 1) / (of + 2) for of in f))


@pytest.mark.parametrize(("values", "n_replicates"), [([1, 2, 3], 1), ([1, 2, 3], 3), ([2, 2, 2, 2], 2)])
def test_what_replicates_can_not_tell_apart_has_no_share(values, n_replicates):
    (row,) = variance(study_of({("residual_slush", 9.0): values}, n_replicates=n_replicates))
    assert row.share_between == MISSING
    assert (row.sd_between is None) == (n_replicates in (1, 3)) and (row.sd_within is None) == (n_replicates == 3)


def test_the_interval_of_the_share_holds_it():
    """95 % of 1,000 intervals of three replicates of four trials, give or take four binomial deviations."""
    draw, inside, replicate = np.random.default_rng(1), 0, np.arange(12) % 3
    for _ in range(1000):
        effect = draw.normal(0, math.sqrt(0.3), 3)
        values = effect[replicate] + draw.normal(0, math.sqrt(0.7), 12)
        (row,) = variance(study_of({("residual_slush", 9.0): values}, n_replicates=3))
        inside += row.share_between.low <= 0.3 <= row.share_between.high
    assert abs(inside / 1000 - 0.95) < 4 * 0.007
