import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tasks.analysis.comparison import (
    CONTRASTS,
    clustered,
    compare,
    difference,
    hedges_g,
    holm,
    nested_ratio,
    ratio,
    student,
    sweep,
)
from tasks.analysis.replicates import mean_of, nested
from tasks.analysis.scores import Scores


def rng(seed=0):
    return np.random.default_rng(seed)


def compared(a, b):
    return compare(np.asarray(a, float), np.asarray(b, float), rng=rng())


def test_a_worked_example():
    """Means 2 and 5, variances 1 and 1: t = -3 / √(2/3), with 4 degrees of freedom."""
    found = compared([1, 2, 3], [4, 5, 6])
    t = -3 / math.sqrt(2 / 3)
    assert found.student.statistic == pytest.approx(t)
    assert found.student.p == pytest.approx(2 * stats.t.sf(-t, 4))
    assert found.welch.p == pytest.approx(found.student.p)  # equal variances and sizes
    assert found.mann_whitney.statistic == 0.0
    assert found.mann_whitney.p == pytest.approx(2 / 20)  # the most extreme of 20 orders, at either end
    J = 1 - 3 / (4 * 4 - 1)  # Hedges' approximation of his correction
    assert found.hedges_g.value == pytest.approx(-3 * J, rel=0.01)
    assert found.ratio.value == pytest.approx(2 / 5)
    assert (found.a.n, found.b.n, found.a.sd, found.b.mean.value) == (3, 3, 1.0, 5.0)


def test_tests_are_scipy_s():
    a, b = rng(1).normal(4, 1, 10), rng(2).normal(5, 3, 12)
    found = compared(a, b)
    assert found.student.p == pytest.approx(stats.ttest_ind(a, b).pvalue)
    assert found.welch.p == pytest.approx(stats.ttest_ind(a, b, equal_var=False).pvalue)
    assert found.mann_whitney.p == stats.mannwhitneyu(a, b, method="asymptotic").pvalue
    assert compared(a, b[:10]).mann_whitney.p == stats.mannwhitneyu(a, b[:10], method="exact").pvalue


def test_the_interval_of_a_difference_is_scipy_s_and_holds_0_where_student_finds_none():
    draw, significant = rng(6), []
    for shift in np.linspace(0, 3, 50):
        a, b = draw.normal(shift, 1, 8), draw.normal(0, 2, 5)
        found, interval = difference(a, b), stats.ttest_ind(a, b).confidence_interval(0.95)
        assert (found.value, found.low, found.high) == pytest.approx((a.mean() - b.mean(), *interval))
        significant.append(student(a, b).p < 0.05)
        assert (found.low > 0 or found.high < 0) == significant[-1]
    assert 0 < sum(significant) < len(significant)


def test_a_difference_without_an_interval_says_why():
    few = difference(np.array([3.0]), np.array([1.0, 2.0]))
    assert (few.value, few.low, few.reason) == (1.5, None, "1 and 2 values, expected 2 or more in both groups")
    assert difference(np.full(3, 2.0), np.full(3, 1.0)).reason == "both groups are constant"
    assert difference(np.empty(0), np.ones(3)).value is None


def test_what_diverged_is_left_out_and_counted():
    found = compared([1, 2, 3, np.nan, -np.inf], [4, 5, 6])
    assert (found.a.n, found.a.n_left_out) == (3, 2)
    assert found.student == compared([1, 2, 3], [4, 5, 6]).student


@pytest.mark.parametrize(("a", "b"), [([1.0], [1.0, 2.0]), ([], [1.0, 2.0]), ([np.nan, 1.0], [1.0, 2.0])])
def test_too_few_values_say_so(a, b):
    found = compared(a, b)
    n = int(np.isfinite(a).sum())
    for missing in (found.student, found.welch, found.mann_whitney):
        assert missing.p is None and missing.reason == f"{n} and 2 values, expected 2 or more in both groups"
    assert found.hedges_g.value is None and found.hedges_g.reason == found.student.reason
    assert (found.ratio.value is None) == (n == 0) and found.ratio.reason
    assert found.a.sd is None


def test_constant_groups_have_no_t_but_an_order():
    found = compared([1.0] * 4, [2.0] * 4)
    assert found.student.p is None and found.student.reason == "both groups are constant" == found.hedges_g.reason
    assert found.welch.p is None and found.mann_whitney.p is not None
    assert found.ratio.value == 0.5 and found.ratio.low is None


def test_equal_groups():
    same = compared([2.0] * 4, [2.0] * 5)
    assert same.mann_whitney.p is None and same.mann_whitney.reason == "all values of both groups are equal"
    twice = compared([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    assert twice.student.p == 1.0 and twice.mann_whitney.p == 1.0 and twice.hedges_g.value == 0.0


def test_one_constant_group_is_no_obstacle():
    found = compared([2.0] * 5, [1.0, 1.5, 2.5, 1.2, 0.7])
    assert None not in (found.student.p, found.welch.p, found.mann_whitney.p, found.hedges_g.value)


def test_the_interval_of_an_effect_size_holds_it():
    """95 % of 1000 intervals of a true effect of 1, give or take four deviations of 0.007; the formula errs by 1 %."""
    draw, inside = rng(3), 0
    for _ in range(1000):
        found = hedges_g(draw.normal(1, 1, 10), draw.normal(0, 1, 10))
        inside += found.low <= 1 <= found.high
    assert abs(inside / 1000 - 0.95) < 4 * 0.007 + 0.01


def test_hedges_g_is_unbiased():
    """Over 2000 pairs of 5, the mean g is the true effect 1 within four deviations of the mean, 4 · 0.7 / √2000."""
    draw = rng(4)
    g = [hedges_g(draw.normal(1, 1, 5), draw.normal(0, 1, 5)).value for _ in range(2000)]
    assert np.mean(g) == pytest.approx(1.0, abs=4 * np.std(g) / math.sqrt(2000))
    assert np.std(g) < 0.85


def test_the_interval_of_a_ratio_holds_it():
    """About 95 % of 300 intervals with 10 trials a side, give or take four deviations of 0.0126."""
    draw, inside = rng(5), 0
    for seed in range(300):
        found = ratio(draw.normal(9.1, 2, 10), draw.normal(13.6, 2, 10), rng=rng(seed))
        inside += found.low <= 9.1 / 13.6 <= found.high
    assert abs(inside / 300 - 0.95) < 4 * 0.0126


def test_no_ratio_to_what_goes_nowhere():
    for whole in ([-1.0, -2.0, -3.0], [0.0, 0.0, 0.0]):
        found = ratio(np.array([1.0, 2.0, 3.0]), np.array(whole), rng=rng())
        assert found.value is None and found.reason == "the reference goes nowhere, or backwards"
    shaky = ratio(np.array([1.0, 2.0, 3.0]), np.array([-4.0, 2.0, 3.0, 1.0]), rng=rng())
    assert shaky.value == pytest.approx(4.0) and shaky.low is None and "goes nowhere" in shaky.reason


def test_holm_of_a_worked_example():
    """For four p-values: 0.01 · 4, 0.02 · 3, 0.03 · 2 (both 0.06), 0.9 · 1."""
    assert holm([0.03, None, 0.01, 0.9, 0.02]) == pytest.approx([0.06, None, 0.04, 0.9, 0.06])
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([None, None]) == [None, None] and holm([]) == []
    assert holm([0.0, 0.5]) == [0.0, 0.5]


LEVELS = {"true_slush": 13, "dry_land": 5, "residual_slush": 11, "single_member": 4, "randomised_slush": 9}


def scores(n=4):
    """Two depths; only the second has single members and randomised slush."""
    draw = rng(6)
    rows = [
        (arm, depth, trial, draw.normal(level, 1))
        for depth in (0.5, 9.0)
        for arm, level in LEVELS.items()
        for trial in range(n)
        if depth == 9.0 or arm not in ("single_member", "randomised_slush")
    ]
    evolved_in, depth, trial, z = (np.array(column) for column in zip(*rows, strict=True))
    return Scores(evolved_in, depth, trial, predicted=z + 1, zero_shot=z, adapted=z + 0.5)


def test_a_sweep_compares_what_there_is():
    found = sweep(scores(), rng=rng())
    # No design evolved with designed throws. The four contrasts with single members and the four with randomised slush
    # are at 9 m alone.
    n_designed = sum("designed_throws" in (a[0], b[0]) for a, b in CONTRASTS)
    assert n_designed == 6 and len(found) == 2 * (len(CONTRASTS) - n_designed) - 8
    for contrast in found:
        table = scores()
        assert contrast.comparison.student.p == pytest.approx(
            stats.ttest_ind(table.values(*contrast.a, contrast.depth), table.values(*contrast.b, contrast.depth)).pvalue
        )


def test_the_family_of_a_correction_is_every_contrast_at_every_depth():
    found = sweep(scores(), rng=rng())
    assert [c.student_holm for c in found] == holm([c.comparison.student.p for c in found])
    assert [c.welch_holm for c in found] == holm([c.comparison.welch.p for c in found])
    assert [c.mann_whitney_holm for c in found] == holm([c.comparison.mann_whitney.p for c in found])


def test_a_sweep_knows_of_replicates_in_the_clustered_test_and_in_intervals_alone():
    table = scores(n=6)
    networks = np.isin(table.evolved_in, ["residual_slush", "single_member"])
    replicated = replace(table, replicate=np.where(networks, table.trial % 2, 0))
    for plain, found in zip(sweep(table, rng=rng()), sweep(replicated, rng=rng()), strict=True):
        of_plain, of_found = plain.comparison, found.comparison
        assert (of_plain.student, of_plain.hedges_g) == (of_found.student, of_found.hedges_g)
        assert of_plain.clustered == of_plain.welch == of_found.welch
        arms = [found.a[0], found.b[0]]
        assert [of_found.a.n_replicates, of_found.b.n_replicates] == [
            2 if arm in ("residual_slush", "single_member") else 1 for arm in arms
        ]
        samples = [replicated.sample(*arm, found.depth) for arm in (found.a, found.b)]
        assert of_found.clustered == clustered(*samples) and of_found.a.mean == mean_of(samples[0])
        if not nested(*samples):
            assert replace(of_found, ratio=of_plain.ratio) == of_plain  # other resamples
        else:
            assert of_found.ratio == nested_ratio(*samples, rng=rng())
    assert [c.clustered_holm for c in sweep(replicated, rng=rng())] == holm(
        [c.comparison.clustered.p for c in sweep(replicated, rng=rng())]
    )


def test_a_sweep_with_one_trial_says_why():
    for contrast in sweep(scores(n=1), rng=rng()):
        assert contrast.student_holm is None and "1 and 1 values" in contrast.comparison.student.reason


def test_a_sweep_of_nothing_is_empty():
    none = np.empty(0)
    assert sweep(Scores(none.astype(str), none, none.astype(int), none, none, none), rng=rng()) == ()
