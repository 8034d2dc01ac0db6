"""The comparison with the paper: every number and statement, and the bounds of what agrees."""

import math

import numpy as np
import pytest
from scipy import stats
from scores_of import spread, study_of

from tasks.analysis.estimates import Sample, components, ratio
from tasks.analysis.paper import AGGREGATES, MEANS, RANGES, RATIOS, STATEMENTS
from tasks.analysis.registry import Assessed
from tasks.analysis.tables.paper import paper
from tasks.analysis.tables.regressions import accuracy

DEPTHS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 9.0)
N_STATEMENTS = sum(len(statement.depths) for statement in STATEMENTS)
JOINT = 1 - 0.05 / N_STATEMENTS  # level at which the first of the paper's t tests are judged
SAME = "Dry Land adapted against True Slush at 0.5 m [m]"
LESS = "Dry Land adapted against True Slush at 4 m [m]"
GREATER = "Residual Slush zero-shot against Dry Land adapted at 9 m [m]"


def like_the_paper(n=10, best=13.6, n_replicates=1, **changes):
    """A run whose means are the paper's, at every depth; changes replace (mean, sd) of an arm."""
    zero_shot, adapted = {}, {}
    for depth in DEPTHS:
        shallow = depth <= 0.5
        for arm, sd, z, a in (
            ("true_slush", 1.0, best, math.nan),
            ("dry_land", 1.0, best - 0.1 if shallow else -0.8, best - 0.1 if shallow else 4.8),
            ("residual_slush", 1.0, 0.67 * 13.6, 0.87 * 13.6 if depth > 3 else best - 0.3),
            ("single_member", 4.0, 4.0, 6.0),
        ):
            shift = 2.0 * (np.arange(n) % n_replicates) * (arm in ("residual_slush", "single_member"))
            zero_shot[arm, depth], adapted[arm, depth] = spread(z, sd, n) + shift, spread(a, sd, n) + shift
    for key, value in changes.get("zero_shot", {}).items():
        zero_shot[key] = spread(*value, n)
    for key, value in changes.get("adapted", {}).items():
        adapted[key] = spread(*value, n)
    return study_of(zero_shot, adapted=adapted, n_replicates=n_replicates)


def rows_of(study):
    return {row.what: row for row in paper(study)}


def test_a_run_like_the_papers_agrees_with_every_number_and_statement():
    rows = paper(like_the_paper())
    assert len(rows) == len({row.what for row in rows}) == len(MEANS) + len(RATIOS) + 1 + N_STATEMENTS
    assert {row.verdict for row in rows} == {"agrees"} and all(row.source and row.paper for row in rows)


def test_a_number_agrees_if_its_difference_from_the_papers_is_shown_to_be_negligible():
    """The bound is a fifth of 13.6 m, 2.72 m.

    The half width for n = 10 and a deviation of 1 is 2.262 / √10, times √2 for the paper's own ten trials: 1.01 m.
    """
    half = 2.262 / math.sqrt(10) * math.sqrt(2)
    for off, verdict in (
        (2.71 - half, "agrees"),
        (2.73 - half, "cannot tell"),
        (2.71 + half, "cannot tell"),
        (2.73 + half, "differs"),
    ):
        for best in (13.6 + off, 13.6 - off):
            row = rows_of(like_the_paper(best=best))["True Slush at 9 m [m]"]
            assert (row.verdict, row.paper) == (verdict, "13.6") and row.value.value == pytest.approx(best)
    assert row.decides.endswith("within ± 2.7")


def test_a_ratio_far_from_the_papers_differs():
    row = rows_of(like_the_paper(best=30.0))["Residual Slush zero-shot / True Slush at 9 m"]
    assert (row.verdict, row.paper) == ("differs", "67%") and row.this_run.startswith("30% (")


def test_intervals_include_the_variance_between_replicates_which_counts_in_full_for_the_paper():
    study = like_the_paper(n_replicates=2)
    row = rows_of(study)["Residual Slush zero-shot / True Slush at 9 m"]
    part, whole = (study.scores.sample((arm, "zero_shot"), 9.0) for arm in ("residual_slush", "true_slush"))
    assert row.value == ratio(part, whole, rng=np.random.default_rng(0))
    found, r = components(part), part.values.mean() / whole.values.mean()
    own, of_paper = found.error.variance + r**2 / 10, found.between + found.within / 10 + r**2 / 10
    half = math.sqrt(1 + of_paper / own) * (row.value.high - row.value.low) / 2
    low, high = (100 * (r - 0.67 + side * half) for side in (-1, 1))
    assert f"({low:z.0f}% to {high:z.0f}%)" in row.decides


def test_the_deviation_over_trials_is_that_within_replicates():
    draw, replicate = np.random.default_rng(1), np.arange(12) % 3
    single, ensemble = draw.normal(0, [[4.0], [1.0]], (2, 12)) + 50.0 * replicate
    values = {("single_member", 9.0): single, ("residual_slush", 9.0): ensemble}
    row = rows_of(study_of(values, n_replicates=3))["deviation over trials, single member / ensemble, zero-shot at 9 m"]
    within = [math.sqrt(components(Sample(of, replicate)).within) for of in (single, ensemble)]
    assert row.value.value == pytest.approx(within[0] / within[1]) and row.value.value > 2


def test_what_was_not_measured_has_no_row():
    assert paper(study_of({("true_slush", 1.0): [3.0, 4.0]})) == []
    one = rows_of(like_the_paper(n=1))
    assert one["True Slush at 9 m [m]"].verdict == "cannot tell" and SAME not in one


@pytest.mark.parametrize(
    ("n", "dry_land", "verdict"),
    [
        (10, (13.5, 1.0), "agrees"),  # bound 2.72 m, half width 3.61 √(2 / 10) = 1.61 m at most: t(18) at JOINT
        (10, (11.5, 1.0), "cannot tell"),  # p = 0.0002: a difference, but perhaps a negligible one
        (10, (8.0, 1.0), "differs"),
        (4, (13.5, 3.0), "cannot tell"),  # p = 0.9 shows nothing
        (4, (3.0, 1.0), "differs"),
    ],
)
def test_a_statement_of_no_difference(n, dry_land, verdict):
    row = rows_of(like_the_paper(n, adapted={("dry_land", 0.5): dry_land}))[SAME]
    assert row.verdict == verdict and row.paper == "no difference (p > 0.01)"


@pytest.mark.parametrize(
    ("n", "dry_land", "verdict"),
    [
        (10, (4.8, 1.0), "agrees"),
        (10, (12.0, 1.0), "agrees"),  # p = 0.002, which is enough for the last of them
        (10, (14.0, 1.0), "differs"),  # no more than negligibly less, or greater
        (4, (12.0, 1.0), "cannot tell"),
        (4, (20.0, 1.0), "differs"),
    ],
)
def test_a_statement_of_a_difference(n, dry_land, verdict):
    row = rows_of(like_the_paper(n, adapted={("dry_land", 4.0): dry_land}))[LESS]
    assert row.verdict == verdict and row.paper == "less (p < 0.0001)"


def test_a_statement_in_the_other_direction_differs():
    assert rows_of(like_the_paper(zero_shot={("residual_slush", 9.0): (-5.0, 1.0)}))[GREATER].verdict == "differs"


def test_a_t_test_has_the_interval_that_judges_it_and_students_p():
    """-8.8 m, and ± t(18) · 1 · √(2 / 10) of deviations of 1 and ten trials each, at the joint level."""
    row = rows_of(like_the_paper())[LESS]
    half = stats.t.ppf((1 + JOINT) / 2, 18) * math.sqrt(2 / 10)
    found = row.value
    assert (found.low, found.value, found.high) == pytest.approx((-8.8 - half, -8.8, -8.8 + half))
    assert row.decides.startswith("difference -8.8 (-10.4 to -7.2) at 99.8%") and row.p < 1e-4


def test_a_statement_is_judged_the_easier_the_more_others_are_decided():
    """p = 0.0096 is below 0.05 once the others are decided, and above 0.05 / n while n of them are not."""
    alone = {("dry_land", 4.0): (12.3, 1.0)}
    assert rows_of(like_the_paper(adapted=alone))[LESS].verdict == "agrees"
    vague = {(arm, d): (4.0, 9.0) for d in (1.0, 1.5, 2.0, 2.5, 3.0) for arm in ("true_slush", "residual_slush")}
    assert rows_of(like_the_paper(zero_shot=vague, adapted={**vague, **alone}))[LESS].verdict == "cannot tell"


def test_figures_of_the_networks_are_compared_at_the_papers_depth():
    draw = np.random.default_rng(2)
    true = draw.normal(5, 3, 200)
    trial = [f"true_slush/{k}" for k in np.arange(200) % 20]
    assessed = Assessed(0.5 * true + draw.normal(0, 2, (8, 200)), true, trial, np.zeros(200, int), {})
    study = study_of({})
    study.throw_groups, study.deviation, study.assessed = ("throws",), "population", lambda group: assessed
    rows = rows_of(study)
    assert len(rows) == len(RANGES) + len(AGGREGATES)
    found = accuracy(assessed, "throws", "population", np.random.default_rng(0))
    lowest, median, highest = found.ranges["r"]
    row = rows["Pearson's R of the members, at 9 m"]
    assert row.value == median and row.this_run == f"{lowest.value:.2f} to {highest.value:.2f}"
    assert row.verdict == ("agrees" if median.low >= 0.24 and median.high <= 0.68 else "cannot tell")
    study.assessed_depth = 3.0
    assert paper(study) == []
