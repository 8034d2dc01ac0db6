"""Scores, and the transfer table that is made of them."""

import math

import pytest
from scores_of import study_of, trials_of

from tasks.analysis.estimates import Estimate, Mean
from tasks.analysis.scores import ScoredTrial, arm_name, arms, sample
from tasks.analysis.tables.transfer import papers_mean, transfer, transfer_rows

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
    assert (residual.zero_shot_share.value, residual.adapted_share.value) == pytest.approx((0.6, 0.75))
    assert best.zero_shot_share == Estimate(1.0)
    assert best.adapted_share.value == pytest.approx(1.5)
    assert (best.paper_zero_shot, residual.paper_adapted) == pytest.approx((13.6, 0.87 * 13.6))
    assert shallow.zero_shot == Mean(3.0, None, 1) and shallow.zero_shot_share.value is None is shallow.paper_zero_shot


def test_shares_have_the_interval_of_a_ratio_of_means():
    five = [8.0, 9.0, 10.0, 11.0, 12.0]
    best, land = transfer(study_of({E: five, ("dry_land", 9.0): [value / 2 for value in five]}))
    assert land.zero_shot_share.value == 0.5 and best.zero_shot_share.interval is None
    # The mean of five has a standard error of √(2.5 / 5) / 10 = 7 %, a ratio of two 10 %; Student's t is 2.8 and less.
    low, high = land.zero_shot_share.interval
    assert 0.5 * (1 - 2.8 * 0.1) < low < 0.5 * (1 - 1.5 * 0.1) and 0.5 * (1 + 1.5 * 0.1) < high < 0.5 * (1 + 4 * 0.1)


def test_sigma_and_fitness_are_of_ensembles_alone():
    trials = [
        ScoredTrial("residual_slush", 9.0, 0, 0, fitness=3.0, predicted=5.0, predicted_sd=2.0, status="ok"),
        ScoredTrial("dry_land", 9.0, 0, 0, fitness=7.0, predicted=7.0, status="ok"),
    ]
    land, residual = transfer_rows(trials, "true_slush")
    assert (residual.sigma, residual.fitness, residual.predicted.value) == (2.0, 3.0, 5.0)
    assert (land.sigma, land.fitness, land.predicted.value) == (None, None, 7.0)


def test_arms_are_listed_the_deepest_first_and_trials_by_number_with_their_replicates():
    table = trials_of({("dry_land", 1.0): [0], ("true_slush", 1.0): [0], ("dry_land", 9.0): [0]})
    assert arms(table) == [("dry_land", 9.0), ("true_slush", 1.0), ("dry_land", 1.0)]
    trials = [ScoredTrial("residual_slush", 9.0, k, k % 2 + 5, zero_shot=z) for k, z in ((2, 2.0), (0, 0.0), (1, NAN))]
    found = sample(trials, ("residual_slush", "zero_shot"), 9.0)
    assert (found.values.tolist(), found.replicate.tolist()) == ([0.0, 2.0], [5, 5])
    assert arm_name(("dry_land", "adapted")) == "Dry Land adapted"


def test_the_papers_means_are_at_its_depth_alone():
    assert papers_mean("residual_slush", "zero_shot", 9.0) == pytest.approx(0.67 * 13.6)
    assert papers_mean("residual_slush", "zero_shot", 3.0) is None is papers_mean("single_member", "adapted", 9.0)
