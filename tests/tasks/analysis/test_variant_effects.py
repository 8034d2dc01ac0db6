"""Sensitivity: the tests of each variant, the family of their correction, and the number of trials."""

import numpy as np
import pytest
from scipy import stats

from tasks.analysis.comparison import group, holm
from tasks.analysis.paper import NEGLIGIBLE
from tasks.analysis.statistical_power import power_of
from tasks.analysis.variant_effects import effects, negligible, trials_to_show


def test_each_variant_is_compared_by_the_papers_test_with_its_interval():
    rng = np.random.default_rng(5)
    base = rng.normal(10.0, 1.0, 12)
    variants = [np.append(rng.normal(mean, 1.0, 12), np.nan) for mean in (10.0, 9.0, 5.0)]
    found = effects([(variant, base) for variant in variants])
    for effect, variant in zip(found, variants, strict=True):
        expected = stats.ttest_ind(variant[:-1], base)
        interval = expected.confidence_interval(0.95)
        assert effect.student.p == pytest.approx(expected.pvalue)
        assert (effect.difference.low, effect.difference.high) == pytest.approx((interval.low, interval.high))
        assert (effect.variant, effect.base) == (group(variant), group(base)) and effect.variant.n_left_out == 1
        assert effect.bound == pytest.approx(NEGLIGIBLE * base.mean())
    assert [effect.student_holm for effect in found] == holm([effect.student.p for effect in found])
    assert [effect.judgement.verdict for effect in found] == ["agrees", "cannot tell", "differs"]


def test_a_variant_without_champions_is_not_comparable():
    (effect,) = effects([(np.array([np.nan, np.nan]), np.array([1.0, 2.0]))])
    assert effect.judgement.verdict == "not comparable" and effect.student.p is None


@pytest.mark.parametrize("n_variants", [1, 13])
def test_the_trials_show_what_is_just_not_negligible(n_variants):
    base = np.array([8.0, 12.0, 10.0, np.nan])  # mean 10, deviation 2
    assert negligible(base) == 2.0
    n = trials_to_show(base, n_variants=n_variants, power=0.8)
    level = 0.05 / n_variants
    assert power_of(2.0, 2.0, n, level=level) >= 0.8 > power_of(2.0, 2.0, n - 1, level=level)
