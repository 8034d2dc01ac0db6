"""The one comparison: its test, its interval, its verdict, and the correction over all rows."""

import math

import numpy as np
import pytest
from scipy import stats
from scores_of import spread, trials_of

from tasks.analysis.comparison import compare, difference, holm, judge, written_arm
from tasks.analysis.estimates import Estimate, Sample, error_of, mean_of

E, DRY = ("true_slush", "zero_shot"), ("dry_land", "zero_shot")


def sample(values, replicate=0):
    return Sample(np.asarray(values, float), np.broadcast_to(replicate, len(values)))


def test_the_interval_holds_0_where_scipys_test_finds_nothing():
    draw, significant = np.random.default_rng(6), []
    for shift in np.linspace(0, 3, 50):
        a, b = draw.normal(shift, 1, 8), draw.normal(0, 2, 5)
        gap, p = difference(sample(a), sample(b))
        assert p == pytest.approx(stats.ttest_ind(a, b, equal_var=False).pvalue, rel=1e-11)
        significant.append(p < 0.05)
        assert (gap.low > 0 or gap.high < 0) == significant[-1]
    assert 0 < sum(significant) < len(significant)


def test_nested_trials_have_errors_with_the_variance_between_replicates():
    x, y = sample([1, 2, 3, 5, 6, 7], [0, 0, 0, 1, 1, 1]), sample([1, 2, 3, 4])
    gap, p = difference(x, y)
    variance, freedom = error_of(x, y)
    assert p == pytest.approx(2 * stats.t.sf(1.5 / math.sqrt(variance), freedom))
    assert gap.value == 1.5 and (gap.low < 0 < gap.high) == (p > 0.05)


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        ([], [1.0], Estimate(None)),
        ([3.0], [1.0, 2.0], Estimate(1.5)),
        ([2.0] * 3, [1.0] * 3, Estimate(1.0)),
        ([1.0, 5.0], [1.0, 5.0], Estimate(0.0, 0.0, 0.0)),  # the very same trials
    ],
)
def test_what_has_no_test(x, y, expected):
    assert difference(sample(x), sample(y)) == (expected, None)


@pytest.mark.parametrize(
    ("ends", "verdict"),
    [
        ((-1, 1), "agrees"),
        ((-3, 1), "cannot tell"),
        ((2.1, 9), "differs"),
        ((-9, -2.1), "differs"),
        ((-9, 9), "cannot tell"),
        ((), "cannot tell"),
    ],
)
def test_verdicts_are_of_the_whole_interval(ends, verdict):
    assert judge(Estimate(0.0, *ends), -2, 2) == verdict


def test_holm_of_a_worked_example():
    """For four p-values: 0.01 · 4, 0.02 · 3, 0.03 · 2 (both 0.06), 0.9 · 1."""
    assert holm([0.03, None, 0.01, 0.9, 0.02]) == pytest.approx([0.06, None, 0.04, 0.9, 0.06])
    assert holm([0.6, 0.7]) == [1.0, 1.0] and holm([None]) == [None] and holm([]) == []


ARMS = {("true_slush", 9.0): spread(10, 1, 5), ("dry_land", 9.0): spread(2, 1, 5), ("dry_land", 1.0): spread(4, 1, 5)}


def test_arms_of_a_study_are_compared_where_both_have_champions():
    table = trials_of(ARMS)
    (row,) = compare(table, table, [(DRY, E)], E[0])
    assert (row.depth, row.a, row.b) == (9.0, "dry_land/zero_shot", "true_slush/zero_shot")
    assert (row.of_a, row.of_b) == (mean_of(ARMS["dry_land", 9.0]), mean_of(ARMS["true_slush", 9.0]))
    assert row.difference.value == pytest.approx(-8) and row.bound == pytest.approx(2)  # a fifth of E
    assert row.verdict == "differs" and row.p_holm == row.p < 0.05


def test_studies_are_compared_at_every_common_depth_and_corrected_together():
    a = trials_of({arm: values + 0.1 for arm, values in ARMS.items()})
    rows = compare(a, trials_of(ARMS), [(E, E), (DRY, DRY)], E[0])
    assert [(row.depth, row.a) for row in rows] == [
        (9.0, "true_slush/zero_shot"),
        (9.0, "dry_land/zero_shot"),
        (1.0, "dry_land/zero_shot"),
    ]
    assert [row.p_holm for row in rows] == holm([row.p for row in rows])
    assert [row.bound for row in rows] == pytest.approx([2, 2, 0.8])  # without E, a fifth of B's own mean


def test_arms_of_the_same_trials_are_identical_and_come_last():
    of_b = {**ARMS, ("dry_land", 9.0): ARMS["dry_land", 9.0] + 0.1}
    rows = compare(trials_of(ARMS), trials_of(of_b), [(E, E), (DRY, DRY)], E[0])
    assert [(row.depth, row.a.split("/")[0], row.verdict, row.p is None) for row in rows] == [
        (9.0, "dry_land", "agrees", False),
        (9.0, "true_slush", "identical", True),
        (1.0, "dry_land", "identical", True),
    ]


def test_a_difference_of_many_needs_a_corrected_p():
    values = {("true_slush", 9.0): spread(10, 1, 5), ("dry_land", 9.0): spread(6.5, 0.58, 5)}
    (alone,) = compare(trials_of(values), trials_of(values), [(DRY, E)], E[0])
    among = compare(trials_of(values), trials_of(values), [(DRY, E)] * 400, E[0])
    assert among[0].p_holm == pytest.approx(400 * alone.p) and 400 * alone.p > 0.05
    assert (alone.verdict, among[0].verdict) == ("differs", "cannot tell")


@pytest.mark.parametrize(("moved", "verdict"), [(3.0, "differs"), (1.0, "agrees"), (-1.0, "agrees"), (-3.0, "differs")])
def test_a_fifth_of_what_the_target_s_robots_travel_is_negligible(moved, verdict):
    of_b = {("true_slush", 9.0): spread(10, 0.01, 5)}
    (row,) = compare(trials_of({("true_slush", 9.0): of_b["true_slush", 9.0] + moved}), trials_of(of_b), [(E, E)], E[0])
    assert row.verdict == verdict


def test_an_arm_is_written_as_readers_know_it():
    assert written_arm("residual_slush/adapted") == "Residual Slush adapted" and written_arm("B") == "B"
