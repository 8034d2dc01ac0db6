import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tasks.analysis.against_paper import against_paper, with_tank_tests
from tasks.analysis.comparison import nested_difference, nested_ratio
from tasks.analysis.paper import (
    AGGREGATES,
    CROSSES_THE_TANK,
    MEANS,
    PHYSICAL,
    RANGES,
    RATIOS,
    STATEMENTS,
    STAYS_ON_DRY_LAND,
)
from tasks.analysis.prediction import MembersRange, Regression
from tasks.analysis.replicates import NestedSample, components
from tasks.analysis.scores import Scores
from tasks.analysis.tank import TankTrials
from tasks.analysis.uncertainty import Estimate

NAN = float("nan")
DEPTHS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 9.0)


def rng(seed=0):
    return np.random.default_rng(seed)


def spread(mean, sd, n):
    """n values with exactly this mean and sample deviation."""
    values = np.arange(n) - (n - 1) / 2
    return mean + sd * values / values.std(ddof=1) if n > 1 else np.array([mean])


def like_the_paper(n=10, best=13.6):
    """A run whose means are the paper's, at every depth."""
    rows = []
    for depth in DEPTHS:
        shallow = depth <= 0.5
        for arm, sd, zero_shot, adapted in (
            ("true_slush", 1.0, best, NAN),
            ("dry_land", 1.0, best - 0.1 if shallow else -0.8, best - 0.1 if shallow else 4.8),
            ("residual_slush", 1.0, 0.67 * 13.6, 0.87 * 13.6 if depth > 3 else best - 0.3),
            ("single_member", 4.0, 4.0, 6.0),
        ):
            for trial, (z, a) in enumerate(zip(spread(zero_shot, sd, n), spread(adapted, sd, n), strict=True)):
                rows.append((arm, depth, trial, z, a))
    evolved_in, depth, trial, z, a = (np.array(column) for column in zip(*rows, strict=True))
    return Scores(evolved_in, depth, trial, np.full(len(z), NAN), z, a)


MEMBERS_R = tuple(np.linspace(0.24, 0.68, 8))


def accuracy(mean_r=0.77, members_r=MEMBERS_R, n=2376, n_trials=20):
    def regression(name, r, slope):
        width = 0.02
        return Regression(
            name,
            n,
            0,
            n_trials,
            slope=Estimate(slope, slope - width, slope + width),
            intercept=Estimate(0.0, -width, width),
            r=Estimate(r, r - width, r + width),
        )

    members = [regression(f"member {k}", r, r + 0.05) for k, r in enumerate(members_r)]
    return (*members, regression("mean", mean_r, 1.26), regression("mean - 1 sd", 0.6, 0.99))


def ranges(members_r=MEMBERS_R):
    """Ranges over the members of accuracy()."""

    def of(figures):
        ends = (min(figures), float(np.median(figures)), max(figures))
        return MembersRange(len(figures), *(Estimate(value, value - 0.02, value + 0.02) for value in ends))

    return {"r": of(members_r), "slope": of([r + 0.05 for r in members_r])}


def rows_of(scores, predictions=(), members=None):
    return {row.what: row for row in against_paper(scores, predictions, members or {}, rng=rng())}


def nothing():
    none = np.empty(0)
    return Scores(none.astype(str), none, none.astype(int), none, none, none)


def test_every_number_and_statement_of_the_paper_has_a_row():
    rows = against_paper(like_the_paper(), accuracy(), ranges(), rng=rng())
    n_statements = sum(len(statement.depths) for statement in STATEMENTS)
    assert len(rows) == len(MEANS) + len(RATIOS) + 1 + len(RANGES) + len(AGGREGATES) + n_statements + len(PHYSICAL)
    assert len({row.what for row in rows}) == len(rows)
    assert all(row.source and row.why and row.paper for row in rows)


def test_a_run_like_the_paper_s_agrees():
    for row in against_paper(like_the_paper(), accuracy(), ranges(), rng=rng()):
        expected = "not comparable" if "built robot" in row.what else "agrees"
        assert row.verdict == expected, row


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
            assert (row.verdict, row.paper) == (verdict, "13.6") and row.value == pytest.approx(best)
    assert "lies outside ± 2.7" in row.why


def test_a_ratio_far_from_the_paper_s_differs():
    row = rows_of(like_the_paper(best=30.0))["Residual Slush zero-shot / True Slush at 9 m"]
    assert (row.verdict, row.paper, row.this_run) == ("differs", "67%", "30%")


def replicated(scores, n_replicates=2):
    """The same scores; those of networks are of trials that take turns over the replicates, which differ by 2 m."""
    networks = np.isin(scores.evolved_in, ["residual_slush", "single_member"])
    replicate = np.where(networks, scores.trial % n_replicates, 0)
    shift = np.where(networks, 2.0 * replicate, 0)
    return replace(scores, zero_shot=scores.zero_shot + shift, adapted=scores.adapted + shift, replicate=replicate)


def test_intervals_include_the_variance_between_replicates():
    scores = replicated(like_the_paper())
    found, plain = rows_of(scores), rows_of(replace(scores, replicate=np.zeros(len(scores.trial), int)))
    samples = [scores.sample(*arm, 9.0) for arm in (("residual_slush", "zero_shot"), ("true_slush", "zero_shot"))]
    shallower = [scores.sample(*arm, 3.0) for arm in (("residual_slush", "adapted"), ("true_slush", "zero_shot"))]
    level = 1 - 0.05 / n_undecided(found)
    expected = {
        "Residual Slush zero-shot / True Slush at 9 m": nested_ratio(*samples, rng=rng()),
        "Student's t at 3 m: Residual Slush adapted against True Slush": nested_difference(*shallower, level=level),
    }
    for what, estimate in expected.items():
        row = found[what]
        assert (row.value, row.low, row.high) == (estimate.value, estimate.low, estimate.high)
        assert row.high - row.low > 2 * (plain[what].high - plain[what].low) and row.p == plain[what].p
    for what in ("True Slush at 9 m [m]", "Dry Land adapted at 9 m [m]", STATED["less"]):
        assert found[what] == plain[what]  # neither depends on a replicate


def test_the_papers_own_number_has_the_variance_of_one_replicate():
    """The interval of the difference is wider by √(1 + (σ_a² + σ_e² / 10) / var), which the reason gives."""
    scores = replicated(like_the_paper(), 5)
    part, whole = (scores.sample(arm, "zero_shot", 9.0) for arm in ("residual_slush", "true_slush"))
    of, row = components(part), rows_of(scores)["Residual Slush zero-shot / True Slush at 9 m"]
    mean_of_whole, r = whole.values.mean(), part.values.mean() / whole.values.mean()
    own = of.error.variance + r**2 / 10  # deviations of True Slush are 1 m
    papers = of.between + of.within / 10 + r**2 / 10
    wider = math.sqrt(1 + papers / own)
    assert wider > math.sqrt(2)
    half = wider * (row.high - row.low) / 2
    low, high = (100 * (r - 0.67 + side * half) for side in (-1, 1))
    assert f"({low:z.0f}% to {high:z.0f}%)" in row.why and mean_of_whole == pytest.approx(13.6)


def test_the_papers_accuracy_has_at_most_as_much_variance_as_one_of_the_replicates():
    """The mean of two has half of it, from as many trials as the paper: the interval is wider by √(1 + 2)."""
    rows = [replace(row, n_replicates=2) for row in accuracy(mean_r=0.87)]
    why = rows_of(like_the_paper(), rows)["Pearson's R of the members' mean, at 9 m"].why
    low, high = (0.87 - 0.77 + side * math.sqrt(3) * 0.02 for side in (-1, 1))
    assert f"({low:.2f} to {high:.2f})" in why


def test_the_deviation_over_trials_is_that_within_replicates():
    what = "deviation over trials, single member / ensemble, zero-shot at 9 m"
    draw = rng(1)
    values = draw.normal(0, [[4.0], [1.0]], (2, 12)) + 50.0 * (np.arange(12) % 3)
    arms = np.repeat(["single_member", "residual_slush"], 12)
    scores = Scores(arms, np.full(24, 9.0), np.tile(np.arange(12), 2), *np.tile(values.ravel(), (3, 1)))
    row = rows_of(replace(scores, replicate=scores.trial % 3))[what]
    within = [math.sqrt(components(NestedSample(of, np.arange(12) % 3)).within) for of in values]
    assert row.value == pytest.approx(within[0] / within[1]) and row.value > 2
    assert rows_of(scores)[what].value == pytest.approx(1, abs=0.1)  # 50 m between replicates drown it


def test_too_few_trials_are_not_comparable():
    rows = rows_of(like_the_paper(n=1), accuracy())
    assert rows["True Slush at 9 m [m]"].verdict == "not comparable"
    assert rows["True Slush at 9 m [m]"].why == "1 value, an interval needs 2 or more"
    assert rows["True Slush at 9 m [m]"].this_run == "13.6"
    statement = rows["Student's t at 0.5 m: Dry Land adapted against True Slush"]
    assert (statement.verdict, statement.why) == ("not comparable", "1 and 1 values, expected 2 or more in both groups")


def test_nothing_measured_is_not_comparable_and_says_why():
    for row in against_paper(nothing(), (), {}, rng=rng()):
        assert row.verdict == "not comparable" and row.why and row.this_run == "-", row


def n_undecided(rows):
    return sum(row.verdict == "cannot tell" for what, row in rows.items() if what.startswith("Student"))


JOINT = 1 - 0.05 / 25  # level at which the first of the paper's 25 t tests are judged
STATED = {
    "same": "Student's t at 0.5 m: Dry Land adapted against True Slush",
    "less": "Student's t at 4 m: Dry Land adapted against True Slush",
    "greater": "Student's t at 9 m: Residual Slush zero-shot against Dry Land adapted",
}


def with_arm(scores, arm, depth, **values):
    """Replace an arm's scores at a depth."""
    rows = scores.rows(arm, depth)
    columns = {name: getattr(scores, name).copy() for name in ("zero_shot", "adapted")}
    for name, new in values.items():
        columns[name][rows] = spread(*new, len(rows))
    return Scores(scores.evolved_in, scores.depth, scores.trial, scores.predicted, **columns)


@pytest.mark.parametrize(
    ("n", "dry_land", "verdict"),
    [
        (10, (13.5, 1.0), "agrees"),  # bound 2.72 m, half width 3.61 √(2 / 10) = 1.61 m at most: t(18) at JOINT
        (10, (11.5, 1.0), "cannot tell"),  # p = 0.0002: a difference, but perhaps a negligible one
        (10, (8.0, 1.0), "differs"),
        (4, (13.6, 0.1), "agrees"),  # half width 5.21 √((1² + 0.1²) / 4) = 2.62 m at most
        (4, (13.5, 3.0), "cannot tell"),  # p = 0.9 shows nothing
        (4, (3.0, 1.0), "differs"),
    ],
)
def test_a_statement_of_no_difference(n, dry_land, verdict):
    row = rows_of(with_arm(like_the_paper(n), "dry_land", 0.5, adapted=dry_land))[STATED["same"]]
    assert row.verdict == verdict and row.paper == "no difference (p > 0.01)"


@pytest.mark.parametrize(
    ("n", "dry_land", "verdict"),
    [
        (10, (4.8, 1.0), "agrees"),
        (4, (4.8, 1.0), "agrees"),  # fewer trials, and yet p < 0.0001
        (10, (12.0, 1.0), "agrees"),  # p = 0.002, which is enough for the last of 25
        (10, (14.0, 1.0), "differs"),  # no more than negligibly less, or greater
        (4, (12.0, 1.0), "cannot tell"),
        (4, (14.0, 3.0), "cannot tell"),
        (4, (20.0, 1.0), "differs"),
    ],
)
def test_a_statement_of_a_difference(n, dry_land, verdict):
    row = rows_of(with_arm(like_the_paper(n), "dry_land", 4.0, adapted=dry_land))[STATED["less"]]
    assert row.verdict == verdict and row.paper == "less (p < 0.0001)"


def test_a_statement_in_the_other_direction():
    assert rows_of(like_the_paper())[STATED["greater"]].this_run.startswith("greater, p = ")
    row = rows_of(with_arm(like_the_paper(), "residual_slush", 9.0, zero_shot=(-5.0, 1.0)))[STATED["greater"]]
    assert row.verdict == "differs" and row.why.endswith("has the other direction")


def test_members_agree_by_their_median():
    name = "Pearson's R of the members, at 9 m"
    row = rows_of(nothing(), members=ranges([0.1, 0.5, 0.9]))[name]
    assert (row.verdict, row.this_run) == ("agrees", "0.10 to 0.90")
    assert row.why == "the median of 3 members, 0.50 (0.48 to 0.52), lies in the paper's range"
    assert rows_of(nothing(), members=ranges([0.7, 0.8, 0.1]))[name].verdict == "cannot tell"  # 0.68 to 0.72
    assert rows_of(nothing(), members=ranges([0.75, 0.8, 0.1]))[name].verdict == "differs"


def test_a_range_has_the_intervals_of_its_ends_and_of_the_median_that_judges_it():
    row = rows_of(nothing(), members=ranges([0.1, 0.5, 0.9]))["Pearson's R of the members, at 9 m"]
    assert row.interval == "0.08 to 0.12 and 0.88 to 0.92"
    assert (row.low, row.value, row.high) == pytest.approx((0.48, 0.5, 0.52))


def test_a_t_test_has_the_interval_of_the_difference_that_it_is_of():
    """-8.8 m, and ± t(18) · 1 · √(2 / 10) of deviations of 1 and ten trials each, at the joint level."""
    row = rows_of(like_the_paper())[STATED["less"]]
    half = stats.t.ppf((1 + JOINT) / 2, 18) * math.sqrt(2 / 10)
    assert (row.low, row.value, row.high) == pytest.approx((4.8 - 13.6 - half, 4.8 - 13.6, 4.8 - 13.6 + half))
    assert row.interval == "difference -10.4 to -7.2 m, at 99.8%"
    assert row.p < 1e-4 and f"p = {row.p:.2g}" in row.this_run


def test_a_statement_is_judged_the_easier_the_more_others_are_decided():
    """p = 0.0096 is below 0.05 once the other 24 are decided, and above 0.05 / n while n of them are not."""
    alone = with_arm(like_the_paper(), "dry_land", 4.0, adapted=(12.3, 1.0))
    assert rows_of(alone)[STATED["less"]].verdict == "agrees"
    crowded = alone
    for depth in (1.0, 1.5, 2.0, 2.5, 3.0):
        for arm in ("true_slush", "residual_slush"):
            crowded = with_arm(crowded, arm, depth, zero_shot=(4.0, 9.0), adapted=(4.0, 9.0))
    rows = rows_of(crowded)
    assert n_undecided(rows) > 0.05 / rows[STATED["less"]].p and rows[STATED["less"]].verdict == "cannot tell"


def test_the_family_is_of_the_t_tests_that_a_run_can_judge():
    """At 9 m the paper states three."""
    scores = like_the_paper()
    deep = scores.depth == 9.0
    row = rows_of(Scores(**{name: column[deep] for name, column in vars(scores).items()}))[STATED["greater"]]
    half = stats.t.ppf(1 - 0.05 / 3 / 2, 18) * math.sqrt(2 / 10)
    assert (row.low, row.high) == pytest.approx((row.value - half, row.value + half))


def test_one_of_25_t_tests_is_misjudged_in_5_percent_of_runs_without_any_difference():
    """Arms are alike, so that to find one less or greater is an error. Tests share arms, so 5 % is the most."""
    draw, n_runs, n_wrong = rng(7), 100, 0
    scores = like_the_paper()
    for _ in range(n_runs):
        values = draw.normal(10, 4, (2, len(scores.depth)))
        rows = rows_of(replace(scores, zero_shot=values[0], adapted=values[1])).values()
        n_wrong += any(row.p is not None and not row.low <= 0 <= row.high for row in rows)
    assert n_wrong / n_runs < 0.05 + 3 * math.sqrt(0.05 * 0.95 / n_runs)


def test_a_robots_tank_tests_stand_beside_those_of_the_built_one():
    crossed, stayed = TankTrials(8, 7, 5, 0), TankTrials(8, 1, 0, 6)
    rows = against_paper(nothing(), (), {}, rng=rng())
    found = {row.what: row for row in with_tank_tests(rows, wet=crossed, dry=stayed, dry_servo=TankTrials(8, 8, 8, 2))}
    assert found[CROSSES_THE_TANK].this_run == (
        "in simulation 7 of 8 trials by Froude's law, 5 of 8 at the simulation's frequencies"
    )
    assert found[STAYS_ON_DRY_LAND].this_run == (
        "in simulation it stays in 6 of 8 trials, and in 2 of 8 with the torque of its servo"
    )
    assert found[CROSSES_THE_TANK].verdict == "not comparable" and "no robot was built" in found[CROSSES_THE_TANK].why
    assert [row for row in rows if row.what not in PHYSICAL] == [
        found[row.what] for row in rows if row.what not in PHYSICAL
    ]


def test_large_effects_elsewhere_do_not_make_arms_that_are_alike_differ():
    """At half of the depths Dry Land is far behind, so that Holm's procedure steps down; elsewhere all are alike."""
    draw, n_runs, n_wrong = rng(8), 100, 0
    scores = like_the_paper()
    behind = (scores.evolved_in == "dry_land") & np.isin(scores.depth, (1.0, 2.0, 3.0, 4.0))
    for _ in range(n_runs):
        values = draw.normal(np.where(behind, -10, 10), 4, (2, len(behind)))
        rows = rows_of(replace(scores, zero_shot=values[0], adapted=values[1])).items()
        alike = [row for what, row in rows if row.p is not None and not any(f"at {d} m: Dry" in what for d in "1234")]
        n_wrong += any(not row.low <= 0 <= row.high for row in alike)
    assert n_wrong / n_runs < 0.05 + 3 * math.sqrt(0.05 * 0.95 / n_runs)


@pytest.mark.parametrize(("n_trials", "half"), [(20, 0.02 * math.sqrt(2)), (80, 0.02 * math.sqrt(5))])
def test_an_aggregate_has_the_uncertainty_of_the_papers_trials_too(n_trials, half):
    """Half width 0.02, times √(1 + n / 20): the paper's designs come from 20 trials. The bound is 0.15."""
    name = "Pearson's R of the members' mean, at 9 m"
    for off, verdict in ((0.149 - half, "agrees"), (0.151 - half, "cannot tell"), (0.151 + half, "differs")):
        row = rows_of(nothing(), accuracy(mean_r=0.77 - off, n_trials=n_trials))[name]
        assert row.verdict == verdict


def test_what_could_not_be_regressed_passes_its_reason_on():
    missing = Estimate.missing("every design is predicted to go equally far")
    range_of = MembersRange(0, missing, missing, missing)
    rows = rows_of(
        nothing(), [Regression("mean", 9, 0, 3, missing, missing, missing)], {"slope": range_of, "r": range_of}
    )
    for name in ("slope of the members' mean, at 9 m", "slope of the members, at 9 m"):
        assert (rows[name].why, rows[name].this_run) == (missing.reason, "-")


def test_single_members_that_vary_less_differ():
    name = "deviation over trials, single member / ensemble, zero-shot at 9 m"
    assert rows_of(like_the_paper())[name].value == pytest.approx(4.0)
    calm = with_arm(like_the_paper(), "single_member", 9.0, zero_shot=(4.0, 0.5))
    assert rows_of(calm)[name].verdict == "differs"


def test_the_interval_is_this_runs_own_and_lies_in_that_of_a_repeat():
    """Student's t for a mean: 4.8 ± t(9) · 1 / √10. The paper's number may lie between the two intervals and agree."""
    row = rows_of(like_the_paper())["Dry Land adapted at 9 m [m]"]
    half = stats.t.ppf(0.975, 9) / math.sqrt(10)
    assert (row.low, row.high) == pytest.approx((4.8 - half, 4.8 + half))
    assert row.interval == "4.1 to 5.5"
    best = 13.6 - 1.2 * half  # the paper's number is beyond this run's interval, but not far
    row = rows_of(like_the_paper(best=best))["True Slush at 9 m [m]"]
    assert row.verdict == "agrees" and row.high < 13.6


def test_everything_that_a_whole_run_measures_has_an_interval():
    found = rows_of(like_the_paper(), accuracy(), ranges())
    with_interval = {what for what, row in found.items() if row.interval}
    assert with_interval == {what for what in found if not what.startswith("the built robot")}
    for what in with_interval:
        assert found[what].low < found[what].value < found[what].high


def test_too_few_trials_for_an_interval():
    row = rows_of(like_the_paper(n=1))["True Slush at 9 m [m]"]
    assert (row.verdict, row.interval, row.low) == ("not comparable", "", None)


def test_the_ratio_of_deviations_is_that_of_the_samples():
    row = next(row for what, row in rows_of(like_the_paper()).items() if what.startswith("deviation"))
    assert row.value == pytest.approx(4.0, rel=1e-12)  # 4.0 and 1.0
    assert row.verdict == "agrees" and row.low > 1


@pytest.mark.parametrize(
    ("single", "ensemble", "n", "verdict"),
    [(4, 1, 10, "agrees"), (1, 4, 10, "differs"), (1.2, 1, 10, "cannot tell"), (4, 1, 2, "not comparable")],
)
def test_more_variation_is_judged_by_its_whole_interval(single, ensemble, n, verdict):
    rows = [("single_member", single), ("residual_slush", ensemble)]
    z = np.concatenate([spread(5.0, sd, n) for _, sd in rows])
    arms = np.repeat([arm for arm, _ in rows], n)
    scores = Scores(arms, np.full(2 * n, 9.0), np.tile(np.arange(n), 2), np.full(2 * n, NAN), z, z)
    row = next(row for what, row in rows_of(scores).items() if what.startswith("deviation"))
    assert (row.verdict, row.value) == (verdict, pytest.approx(single / ensemble))
