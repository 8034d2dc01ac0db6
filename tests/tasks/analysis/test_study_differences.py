"""Two studies compared: the numbers of each row, the family of tests, and trials that are in both."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tasks.analysis.comparison import clustered, difference, group, hedges_g, holm, nested_difference, welch
from tasks.analysis.equivalence import judge_equivalence
from tasks.analysis.paper import NEGLIGIBLE
from tasks.analysis.scores import Scores
from tasks.analysis.study_differences import compare_studies


def scores(rng, *, shift=0.0, n=6, depths=(1.0, 9.0), arms=("true_slush", "dry_land")) -> Scores:
    grid = [(arm, depth, trial) for arm in arms for depth in depths for trial in range(n)]
    evolved_in, depth, trial = (np.array(column) for column in zip(*grid, strict=True))
    values = rng.normal(10.0 + shift, 1.0, (3, len(grid)))
    values[2, 0] = np.nan  # one rollout diverged
    return Scores(evolved_in, depth, trial, *values)


@pytest.fixture
def pair():
    rng = np.random.default_rng(3)
    return scores(rng, shift=0.5), scores(
        rng, n=4, depths=(3.0, 9.0), arms=("true_slush", "residual_slush", "dry_land")
    )


def test_each_row_holds_the_numbers_of_the_analysis(pair):
    a, b = pair
    rows = compare_studies(a, b)
    expected = [("true_slush", "zero_shot"), ("true_slush", "adapted")]  # predicted is the same rollout as zero-shot
    expected += [("dry_land", name) for name in ("predicted", "zero_shot", "adapted")]
    assert [(row.evolved_in, row.quantity) for row in rows] == expected
    assert {row.depth for row in rows} == {9.0}  # the only depth in both
    bound = NEGLIGIBLE * b.values("true_slush", "zero_shot", 9.0).mean()
    for row in rows:
        x, y = (of.values(row.evolved_in, row.quantity, 9.0) for of in pair)
        x, y = x[np.isfinite(x)], y[np.isfinite(y)]
        assert (row.a, row.b) == (group(x), group(y))
        assert row.difference == difference(x, y, equal_variances=False)
        assert row.hedges_g == hedges_g(x, y) and row.clustered == welch(x, y) and row.bound == pytest.approx(bound)
        n = 2 * len(x) * len(y) / (len(x) + len(y))
        assert row.judgement == judge_equivalence(row.difference, row.bound, n=n, form="{:z.2f} m")
    assert [row.clustered_holm for row in rows] == holm([row.clustered.p for row in rows])


def test_replicates_widen_the_intervals_of_their_own_study(pair):
    a, b = pair
    replicated = replace(a, replicate=np.where(a.evolved_in == "dry_land", a.trial % 2, 0))
    rows = compare_studies(replicated, b)
    for row, plain in zip(rows, compare_studies(a, b), strict=True):
        samples = [of.sample(row.evolved_in, row.quantity, 9.0) for of in (replicated, b)]
        assert row.difference == nested_difference(*samples, equal_variances=False)
        assert row.clustered == clustered(*samples) and row.b.n_replicates == 1
        assert row.a.n_replicates == (2 if row.evolved_in == "dry_land" else 1)
        assert (row.evolved_in == "dry_land") or replace(row, clustered_holm=plain.clustered_holm) == plain
    assert [row.clustered_holm for row in rows] == holm([row.clustered.p for row in rows])


def test_the_interval_is_that_of_welchs_test():
    rng = np.random.default_rng(4)
    x, y = rng.normal(0.0, 1.0, 5), rng.normal(1.0, 4.0, 12)
    expected = stats.ttest_ind(x, y, equal_var=False).confidence_interval(0.95)
    found = difference(x, y, equal_variances=False)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))
    found, expected = difference(x, y), stats.ttest_ind(x, y).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))


@pytest.mark.parametrize(("shift", "verdict"), [(0.0, "agrees"), (5.0, "differs"), (-2.0, "cannot tell")])
def test_a_planted_difference_is_judged_by_its_size(shift, verdict):
    """Bounds are ± 2 m, and with 200 trials of deviation 1 m an interval reaches 0.2 m to either side."""
    rng = np.random.default_rng(5)
    rows = compare_studies(scores(rng, shift=shift, n=200), scores(rng, n=200))
    assert {row.judgement.verdict for row in rows} == {verdict}
    assert all((row.judgement.n_needed is not None) == (verdict == "cannot tell") for row in rows)


def test_trials_that_are_in_both_studies_are_not_tested(pair):
    a, _ = pair
    some = np.flatnonzero(a.trial < 4)
    subset = Scores(*(column[some] for column in vars(a).values()))
    for rows in (compare_studies(a, subset), compare_studies(a, a)):
        for row in rows:
            assert row.difference.value == row.a.mean.value - row.b.mean.value and row.difference.low is None
            assert row.clustered.p is row.clustered_holm is row.hedges_g.value is None
            assert row.judgement.verdict == "not comparable" and "same in both studies" in row.judgement.why


def test_a_trial_that_is_in_both_by_chance_leaves_the_test(pair):
    a, b = pair
    b.zero_shot[b.rows("dry_land", 9.0)[0]] = a.zero_shot[a.rows("dry_land", 9.0)[0]]
    assert all(row.clustered.p is not None for row in compare_studies(a, b))
    still = [Scores(of.evolved_in, of.depth, of.trial, *np.zeros((3, len(of.depth)))) for of in pair]
    assert {row.clustered.reason for row in compare_studies(*still)} == {
        "both groups are constant"
    }  # robots that lie still


def test_without_designs_of_true_slush_the_bound_is_of_the_same_arm():
    rng = np.random.default_rng(6)
    a, b = (scores(rng, arms=("dry_land",)) for _ in range(2))
    for row in compare_studies(a, b):
        assert row.bound == pytest.approx(NEGLIGIBLE * row.b.mean.value)
