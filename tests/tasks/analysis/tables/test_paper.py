"""The comparison with the paper: every number and statement, and the bounds of what agrees."""

import math

import numpy as np
import pytest
from scipy import stats
from scores_of import spread, study_of

from tasks.analysis.estimates import Sample, error_of_mean, ratio, within_replicates
from tasks.analysis.paper import AGGREGATES, MEANS, RATIOS, STATEMENTS
from tasks.analysis.scores import sample
from tasks.analysis.study import Assessed
from tasks.analysis.tables.paper import paper
from tasks.analysis.tables.regressions import accuracy

DEPTHS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 9.0)
N_STATEMENTS = sum(len(statement.depths) for statement in STATEMENTS)
SAME = "Dry Land adapted against True Slush at 0.5 m [m]"
LESS = "Dry Land adapted against True Slush at 4 m [m]"


def like_the_paper(n=10, best=13.6, n_replicates=1, changed=()):
    """A run whose means are the paper's, at every depth, but for those of adapted arms that are changed."""
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
    return study_of(zero_shot, adapted=adapted | dict(changed), n_replicates=n_replicates)


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
    part, whole = (sample(study.trials, (arm, "zero_shot"), 9.0) for arm in ("residual_slush", "true_slush"))
    assert row.value == ratio(part, whole, rng=np.random.default_rng(0))
    (own, _), (within, _), r = error_of_mean(part), within_replicates(part), part.values.mean() / whole.values.mean()
    own, of_paper = own + r**2 / 10, 2 * own - within / 5 + within / 10 + r**2 / 10  # σ_a² + σ_e² / 5 is twice our own
    half = math.sqrt(1 + of_paper / own) * (row.value.high - row.value.low) / 2
    low, high = (100 * (r - 0.67 + side * half) for side in (-1, 1))
    assert f"({low:z.0f} to {high:z.0f}%)" in row.decides


def test_what_was_not_measured_has_no_row():
    assert paper(study_of({("true_slush", 1.0): [3.0, 4.0]})) == []
    one = rows_of(like_the_paper(n=1))
    assert one["True Slush at 9 m [m]"].verdict == "cannot tell" and SAME not in one


@pytest.mark.parametrize(
    ("what", "n", "dry_land", "verdict"),
    [
        (SAME, 10, (13.5, 1.0), "agrees"),  # bound 2.72 m, half width 2.1 √(2 / 10) = 0.94 m: t(18)
        (SAME, 10, (11.5, 1.0), "cannot tell"),  # p = 0.0002: a difference, but perhaps a negligible one
        (SAME, 10, (8.0, 1.0), "differs"),
        (SAME, 4, (13.5, 3.0), "cannot tell"),  # p = 0.9 shows nothing
        (LESS, 10, (4.8, 1.0), "agrees"),
        (LESS, 10, (12.0, 1.0), "agrees"),  # p = 0.002, times the seven statements of no difference and itself
        (LESS, 10, (14.0, 1.0), "differs"),  # no more than negligibly less, or greater
        (LESS, 4, (12.0, 2.0), "cannot tell"),
        (LESS, 4, (20.0, 1.0), "differs"),  # greater
    ],
)
def test_a_statement_about_a_t_test(what, n, dry_land, verdict):
    depth = 0.5 if what == SAME else 4.0
    row = rows_of(like_the_paper(n, changed={("dry_land", depth): spread(*dry_land, n)}))[what]
    assert (row.verdict, row.paper) == (verdict, "no difference (p > 0.01)" if what == SAME else "less (p < 0.0001)")


def test_a_t_test_is_welchs_with_its_interval_corrected_over_all_statements():
    """-8.8 m, and ± t(18) · 1 · √(2 / 10) of deviations of 1 and ten trials each."""
    row = rows_of(like_the_paper())[LESS]
    half = stats.t.ppf(0.975, 18) * math.sqrt(2 / 10)
    assert (row.value.low, row.value.value, row.value.high) == pytest.approx((-8.8 - half, -8.8, -8.8 + half))
    one = 2 * stats.t.sf(8.8 / math.sqrt(2 / 10), 18)
    arms = {("true_slush", 4.0): spread(13.6, 1, 10), ("dry_land", 4.0): spread(0, 1, 10)}
    (alone,) = paper(study_of(arms, adapted={("dry_land", 4.0): spread(4.8, 1, 10)}))
    assert alone.p == pytest.approx(one) and alone.value == row.value and 2 * one < row.p < 1e-4


def test_the_deviation_over_trials_is_that_within_replicates_with_the_interval_of_the_f_test():
    draw, replicate = np.random.default_rng(1), np.arange(12) % 3
    single, ensemble = draw.normal(0, [[4.0], [1.0]], (2, 12)) + 50.0 * replicate
    values = {("single_member", 9.0): single, ("residual_slush", 9.0): ensemble}
    row = rows_of(study_of(values, n_replicates=3))["deviation over trials, single member / ensemble, zero-shot at 9 m"]
    x, y = (within_replicates(Sample(of, replicate))[0] for of in (single, ensemble))
    ends = tuple(math.sqrt(x / y / stats.f.ppf(tail, 9, 9)) for tail in (0.975, 0.025))
    assert row.value.value == pytest.approx(math.sqrt(x / y)) and row.value.interval == pytest.approx(ends)
    assert row.verdict == "agrees"


def test_figures_of_the_networks_are_compared_at_the_papers_depth():
    draw = np.random.default_rng(2)
    true = draw.normal(5, 3, 200)
    trial = [f"true_slush/{k}" for k in np.arange(200) % 20]
    assessed = Assessed(0.5 * true + draw.normal(0, 2, (8, 200)), true, trial, np.zeros(200, int))
    study = study_of({})
    study.settings.data_sets, study.assessed = ("residual_slush",), lambda group: assessed
    rows = rows_of(study)
    assert len(rows) == len(AGGREGATES)
    found = {row.name: row for row in accuracy(assessed, "residual_slush", np.random.default_rng(0))}
    row = rows["Pearson's R of the members' mean, at 9 m"]
    off, wider = found["mean"].r.value - 0.77, math.sqrt(2)  # twenty trials, as in the paper
    low, high = (off + wider * (end - found["mean"].r.value) for end in found["mean"].r.interval)
    assert row.value == found["mean"].r and row.decides == f"Δ {off:z.2f} ({low:z.2f} to {high:z.2f}), within ± 0.15"
    study.settings.assessed_depth = 3.0
    assert paper(study) == []
