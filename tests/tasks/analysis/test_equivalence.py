import math

import numpy as np
import pytest
from scipy import stats

from tasks.analysis.comparison import difference
from tasks.analysis.equivalence import judge_direction, judge_equivalence
from tasks.analysis.uncertainty import Estimate

METRES = "{:z.1f} m"


def effect(value, half):
    return Estimate(value, value - half, value + half)


@pytest.mark.parametrize(
    ("value", "half", "verdict"),
    [
        (0.5, 0.4, "agrees"),
        (-0.5, 0.4, "agrees"),
        (0.5, 0.6, "cannot tell"),
        (2.0, 0.9, "differs"),
        (-2.0, 0.9, "differs"),
        (1.5, 0.6, "cannot tell"),
        (0.0, 3.0, "cannot tell"),
    ],
)
def test_an_effect_is_negligible_or_not_by_its_whole_interval(value, half, verdict):
    judged = judge_equivalence(effect(value, half), 1.0, n=10, form=METRES)
    assert judged.verdict == verdict and METRES.format(value) in judged.why and "± 1.0 m" in judged.why


@pytest.mark.parametrize(
    ("value", "half", "claim", "verdict"),
    [
        (2.0, 0.5, "greater", "agrees"),
        (2.0, 0.5, "less", "differs"),
        (-2.0, 0.5, "less", "agrees"),
        (0.2, 0.2, "greater", "differs"),
        (0.2, 0.9, "greater", "cannot tell"),
        (-2.0, 0.5, "greater", "differs"),
    ],
)
def test_a_direction_is_that_of_the_whole_interval(value, half, claim, verdict):
    """An effect that is shown to be negligible has none."""
    assert judge_direction(effect(value, half), claim, 1.0, n=10, form=METRES).verdict == verdict


def test_the_number_of_trials_that_would_tell():
    """The interval is to shrink from 2 to 1, which takes four times as many trials."""
    assert "(needs about 40 trials)" in judge_equivalence(effect(0.0, 2.0), 1.0, n=10, form=METRES).why
    assert "(needs about 40 trials)" in judge_direction(effect(1.0, 2.0), "less", 0.5, n=10, form=METRES).why
    assert "needs more than 1,000 trials" in judge_equivalence(effect(0.999, 2.0), 1.0, n=10, form=METRES).why


def test_a_sample_that_can_not_grow_limits_what_more_trials_show():
    """Half the variance of 10 and 10 trials is left however many trials are added: 1 / √2 of the half width."""
    close = judge_equivalence(effect(0.0, 1.4), 1.0, n=10, n_other=10, form=METRES)
    assert close.verdict == "cannot tell" and "(needs about 491 trials)" in close.why  # 1 / ((1 / 1.4)² 0.2 - 0.1)
    never = judge_equivalence(effect(0.0, 1.5), 1.0, n=10, n_other=10, form=METRES)
    assert "no number of trials is enough: the paper's own are too few" in never.why


def test_what_has_no_interval_is_not_comparable():
    missing = Estimate.missing("no finite value")
    assert judge_equivalence(missing, 1.0, n=0, form=METRES).why == "no finite value"
    assert judge_direction(missing, "less", 1.0, n=0, form=METRES).verdict == "not comparable"


N_STUDIES, N, BOUND = 1000, 10, 1.5


def verdicts(true_difference, judge):
    """Judge simulated studies of two groups of ten trials with deviations of 1 m."""
    rng = np.random.default_rng(22)
    groups = ((rng.normal(true_difference, 1, N), rng.normal(0, 1, N)) for _ in range(N_STUDIES))
    found = [judge(difference(x, y)).verdict for x, y in groups]
    return {verdict: found.count(verdict) / N_STUDIES for verdict in ("agrees", "differs", "cannot tell")}


def same(found):
    return judge_equivalence(found, BOUND, n=N, form=METRES)


def greater(found):
    return judge_direction(found, "greater", 0.5, n=N, form=METRES)


DEVIATIONS = 4 * math.sqrt(0.25 / N_STUDIES)  # four binomial deviations of a rate, at most
HALF = stats.t.ppf(0.975, 2 * N - 2) * math.sqrt(2 / N)  # half width for deviations of exactly 1


def test_a_planted_equivalence_is_found_and_a_planted_difference_never_taken_for_one():
    """The power at no difference is P(|d| + half < bound), about P(|z| < (bound - half) / √(2 / n)) = 0.78."""
    power = 1 - 2 * stats.norm.sf((BOUND - HALF) / math.sqrt(2 / N))
    found = verdicts(0.0, same)
    assert abs(found["agrees"] - power) < DEVIATIONS and found["differs"] == 0
    at_the_bound = verdicts(BOUND, same)
    assert at_the_bound["agrees"] < 0.025 + DEVIATIONS / 3 and at_the_bound["differs"] < 0.025 + DEVIATIONS / 3
    beyond = verdicts(2 * BOUND, same)
    assert (
        beyond["agrees"] == 0 and abs(beyond["differs"] - stats.norm.sf((HALF - BOUND) / math.sqrt(2 / N))) < DEVIATIONS
    )


@pytest.mark.parametrize(("side", "at_most"), [(1, 0.04), (-1, 0.025)])
def test_a_bound_that_is_estimated_is_passed_a_little_more_often(side, at_most):
    """*E* travels 7.5 ± 1 m, and the bound is a fifth of its mean, 1.5 m if that is exact."""
    rng = np.random.default_rng(23)
    n_agree = 0
    for _ in range(N_STUDIES):
        x, best = rng.normal(7.5 + side * BOUND, 1, N), rng.normal(7.5, 1, N)
        judged = judge_equivalence(difference(x, best), 0.2 * best.mean(), n=N, form=METRES)
        n_agree += judged.verdict == "agrees"
    assert n_agree / N_STUDIES < at_most + DEVIATIONS / 3


def test_a_planted_direction_is_found_as_often_as_the_t_test_finds_it():
    """The interval excludes 0 exactly where p < 0.05, so the rates are those of the t test."""
    noncentrality = 1.5 / math.sqrt(2 / N)
    power = stats.nct.sf(stats.t.ppf(0.975, 2 * N - 2), 2 * N - 2, noncentrality)
    assert abs(verdicts(1.5, greater)["agrees"] - power) < DEVIATIONS
    none = verdicts(0.0, greater)
    assert abs(none["agrees"] - 0.025) < DEVIATIONS / 3 and none["differs"] < 0.025 + DEVIATIONS / 3
    assert verdicts(-1.5, greater)["differs"] > power - DEVIATIONS
