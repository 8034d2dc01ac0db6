from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pipeline.report.data import (
    TrialMean,
    TrialResult,
    arm,
    deepest_scored,
    depths,
    environments,
    paper_mean,
    ratio,
    trial_mean,
)
from pipeline.report.moving import environment_css
from tasks.world import ENVIRONMENTS


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_the_page_has_every_environments_colours_for_light_and_dark(name):
    css, kind, variable = environment_css(), ENVIRONMENTS[name], f"--{name.replace('_', '-')}"
    light, dark = css.split("@media")
    assert f"{variable}: {kind.color};" in light and f"{variable}-adapted: {kind.adapted_color};" in light
    assert f"{variable}: {kind.dark_color};" in dark and f"{variable}-adapted: {kind.dark_adapted_color};" in dark
    assert f".{name} {{ background: var({variable}); }}" in css


def test_mean_of_two_trials_by_hand(study):
    found = trial_mean(arm(study.trials, "dry_land", 9.0), "zero_shot")
    # −2 and 0: mean −1; deviations ∓1, so the sample variance is (1 + 1) / (2 − 1) = 2.
    assert found == TrialMean(mean=-1.0, sd=pytest.approx(math.sqrt(2)), values=(-2.0, 0.0))


def test_a_single_trial_has_no_deviation(study):
    assert trial_mean(arm(study.trials, "single_member", 9.0), "zero_shot").sd is None


def test_diverged_and_unscored_trials_do_not_count():
    trials = [
        TrialResult("dry_land", 1.0, 0, predicted=-np.inf, zero_shot=np.nan),
        TrialResult("dry_land", 1.0, 1, predicted=5.0, zero_shot=None),
        TrialResult("dry_land", 1.0, 2, predicted=7.0, zero_shot=2.0),
    ]
    assert trial_mean(trials, "predicted").values == (5.0, 7.0)
    assert trial_mean(trials, "zero_shot").values == (2.0,)
    assert trial_mean(trials, "adapted") is None


def test_trials_are_chosen_and_ordered(study):
    shuffled = list(reversed(study.trials))
    assert [t.trial for t in arm(shuffled, "residual_slush", 9.0)] == [0, 1]
    assert depths(shuffled) == [1.0, 9.0]
    assert environments(shuffled) == ["true_slush", "dry_land", "residual_slush", "single_member"]


def test_the_deepest_depth_is_one_where_a_champion_was_scored(study):
    unscored = [replace(t, zero_shot=None) if t.depth == 9.0 else t for t in study.trials]
    assert deepest_scored(study.trials) == 9.0
    assert deepest_scored(unscored) == 1.0
    assert deepest_scored([]) is None


@pytest.mark.parametrize("whole", [0.0, -1.0])
def test_no_share_of_what_went_nowhere(whole):
    assert ratio(TrialMean(3.0, None, (3.0,)), TrialMean(whole, None, (whole,))) is None


def test_share_by_hand():
    assert ratio(TrialMean(9.0, None, (9.0,)), TrialMean(12.0, None, (12.0,))) == 0.75


@pytest.mark.parametrize(
    ("environment", "measure", "mean"),
    [
        ("true_slush", "predicted", 13.6),
        ("true_slush", "zero_shot", 13.6),
        ("true_slush", "adapted", None),
        ("dry_land", "zero_shot", -0.8),
        ("dry_land", "adapted", 4.8),
        ("residual_slush", "zero_shot", 0.67 * 13.6),
        ("residual_slush", "adapted", 0.87 * 13.6),
        ("residual_slush", "predicted", None),
        ("single_member", "zero_shot", None),
    ],
)
def test_the_papers_means_at_nine_metres(environment, measure, mean):
    assert paper_mean(environment, measure, 9.0) == mean
    assert paper_mean(environment, measure, 4.0) is None
