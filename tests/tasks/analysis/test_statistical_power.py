import numpy as np
import pytest
from scipy import stats

from tasks.analysis.comparison import clustered
from tasks.analysis.replicates import NestedSample
from tasks.analysis.statistical_power import effective_deviation, n_nested_trials_for, n_trials_for, power_of


@pytest.mark.parametrize(("effect", "power", "n"), [(0.2, 0.8, 394), (0.5, 0.8, 64), (0.8, 0.8, 26), (0.5, 0.9, 86)])
def test_cohens_table(effect, power, n):
    """Cohen 1988, Statistical Power Analysis, table 2.4.1 (two-sided, 5 %), which rounds 394 to 393."""
    assert n_trials_for(effect * 3.0, 3.0, power=power) == n


def test_the_power_is_the_share_of_simulated_studies_that_show_the_difference():
    """2,000 studies: four binomial deviations are at most 0.045."""
    rng = np.random.default_rng(5)
    x, y = rng.normal(2.0, 1.5, (2000, 8)), rng.normal(0.0, 1.5, (2000, 8))
    shown = (stats.ttest_ind(x, y, axis=1).pvalue < 0.05).mean()
    assert abs(shown - power_of(2.0, 1.5, 8)) < 0.045


@pytest.mark.parametrize("difference", [0.05, 1.0, 20.0])
def test_one_trial_less_has_too_little_power(difference):
    n = n_trials_for(difference, 1.0)
    assert power_of(difference, 1.0, n) >= 0.8 and (n == 2 or power_of(difference, 1.0, n - 1) < 0.8)
    assert n == n_trials_for(-difference, 1.0)


def test_extremes():
    assert n_trials_for(1e-6, 1.0) is None and n_trials_for(1.0, 0.0) == 2
    for wrong in ({"difference": 0.0}, {"power": 1.0}, {"level": 0.0}):
        with pytest.raises(ValueError, match="expected a difference other than 0"):
            n_trials_for(**{"difference": 1.0, "sd": 1.0} | wrong)


def nested(values, replicate):
    return NestedSample(np.asarray(values, float), np.asarray(replicate))


@pytest.mark.parametrize(("effect", "n"), [(0.5, 64), (0.8, 26)])
def test_replicates_that_differ_count_as_one_value_each(effect, n):
    """Means 2 and 6 of three trials each deviate by √8; Cohen's table then gives the number of replicates.

    The mean of the six has a variance of 8 / 2 = 4, as that of six independent values with a deviation of √(6 · 4).
    """
    sample = nested([1, 2, 3, 5, 6, 7], [0, 0, 0, 1, 1, 1])
    assert effective_deviation(sample) == pytest.approx(np.sqrt(24))
    assert n_nested_trials_for(effect * np.sqrt(8), sample) == 3 * n


@pytest.mark.parametrize("replicate", [[0] * 6, [0, 1, 2, 3, 4, 5], [0, 1, 0, 1, 0, 1]])
def test_trials_of_one_replicate_of_their_own_or_of_replicates_that_agree_are_independent(replicate):
    values = np.array([1.0, 1.0, 2.0, 2.0, 6.0, 6.0])  # both means of the last grouping are 3
    assert effective_deviation(nested(values, replicate)) == pytest.approx(values.std(ddof=1))
    assert n_nested_trials_for(1.0, nested(values, replicate)) == n_trials_for(1.0, values.std(ddof=1))


def test_the_power_is_the_share_of_replicated_studies_whose_clustered_test_shows_the_difference():
    """1,000 studies of nine replicates of four trials, variances of 1 between replicates and within.

    Four binomial deviations are 0.05. Means of replicates deviate by √(1 + 1/4), and so do those of this sample.
    """
    rng, replicate, apart = np.random.default_rng(3), np.repeat(np.arange(9), 4), 1.5
    n = 0
    for _ in range(1000):
        x, y = (nested(rng.normal(0, 1, 9)[replicate] + rng.normal(0, 1, 36), replicate) for _ in range(2))
        n += clustered(nested(x.values + apart, replicate), y).p < 0.05
    centres = np.array([1, -1]) * np.sqrt(1.25 / 2)
    sample = nested((centres[:, None] + [-0.1, -0.1, 0.1, 0.1]).ravel(), np.repeat([0, 1], 4))
    shown = power_of(apart, np.sqrt(1.25), 9)
    assert abs(n / 1000 - shown) < 0.05
    assert n_nested_trials_for(apart, sample, power=shown - 1e-6) == 36


def test_too_many_nested_trials():
    sample = nested([1, 2, 3, 5, 6, 7], [0, 0, 0, 1, 1, 1])
    assert n_trials_for(0.05, np.sqrt(8)) < 100_000 < 3 * n_trials_for(0.05, np.sqrt(8))
    assert n_nested_trials_for(0.05, sample) is None
