import numpy as np
import pytest
from scipy import stats

from tasks.analysis.statistical_power import n_trials_for, power_of


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
