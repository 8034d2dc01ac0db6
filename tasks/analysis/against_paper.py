"""A run's comparison with the paper's results, number by number and statement by statement.

Every row is judged by :mod:`tasks.analysis.equivalence`, with bounds that :mod:`tasks.analysis.paper` states.

- A number agrees if the difference from the paper's is shown to be negligible. The interval of the difference is this
  run's 95 % interval widened by √(1 + n / n_paper), because the paper's number comes from a sample too: variances add
  and are proportional to 1/n, where n counts what was resampled, such as trials. The paper's deviation, which it does
  not give, is taken to be this run's. The paper has one data set and one ensemble. Where this run has several, its
  variance between them counts in full for the paper, and n_paper is smaller.
- A range over members agrees if it contains the interval of this run's median member.
- The statement that single members vary more agrees if the whole interval of the ratio is above 1. Deviations are from
  the replicate's mean, because the paper has one replicate.
- "No difference" agrees if the difference of the means is shown to be negligible, a fifth of the displacement of the
  designs evolved in True Slush. "Less" and "greater" agree if the whole interval of the difference has that direction.
  The statements that a run can judge are one family: at 95 % each, about one of the paper's 25 would be misjudged by
  chance. They are judged by Holm's step-down procedure: with n not yet decided, each by an interval of 1 - 0.05 / n,
  until no other is decided. A row has the interval that judged it. None is misjudged with a probability of about 95 %:
  as the verdict is on a direction, that is proven for independent tests (Shaffer 1980), and these share arms.

Intervals include the variance between replicates (:mod:`tasks.analysis.replicates`), and numbers of trials that would
tell are of as many more replicates. The p-values are of Student's t test, which treats trials as independent.

Anything that this run did not measure, or that has too few values for an interval, is not comparable.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.random import Generator

from tasks.analysis.comparison import SignificanceTest, nested_difference, nested_ratio, student
from tasks.analysis.equivalence import Judgement, Verdict, judge_direction, judge_equivalence
from tasks.analysis.paper import (
    AGGREGATES,
    CROSSES_THE_TANK,
    DEPTH,
    INSIGNIFICANT,
    MEANS,
    N_ASSESSED,
    N_TRIALS,
    NEGLIGIBLE,
    NEGLIGIBLE_FIGURE,
    NEGLIGIBLE_RATIO,
    PHYSICAL,
    RANGES,
    RATIOS,
    SIGNIFICANT,
    STATEMENTS,
    STAYS_ON_DRY_LAND,
    Statement,
    name_of,
    t_test_words,
)
from tasks.analysis.prediction import Figure, MembersRange, Regression
from tasks.analysis.replicates import (
    NestedSample,
    components,
    error_of,
    from_replicates_means,
    linearised,
    mean_of,
    nested,
    terms_of_ratio,
)
from tasks.analysis.scores import BEST, ScoredArm, Scores
from tasks.analysis.tank import TankTrials
from tasks.analysis.uncertainty import LEVEL, RESOLUTION, Estimate, bootstrap, is_constant
from tasks.arrays import Float64

_METRES = "{:z.1f} m"


@dataclass(frozen=True)
class Row:
    """One row of the comparison."""

    what: str
    paper: str
    source: str  # quotation and section of the paper
    this_run: str
    verdict: Verdict
    why: str
    value: float | None = None
    """This run's value in the unit of ``what``: a range's median, or the difference a - b of a t test's means [m]."""
    interval: str = ""  # text of the interval, for a range those of its two ends; empty if there is none
    low: float | None = None
    high: float | None = None  # ends of the interval of ``value``, 95 % except for t tests; None if there is none
    p: float | None = None  # p of a t test


def against_paper(
    scores: Scores, accuracy: Sequence[Regression], ranges: Mapping[Figure, MembersRange], *, rng: Generator
) -> tuple[Row, ...]:
    """Return the comparison of a run with every number and statement of the paper's results.

    Args:
        scores: scores of the champions, in any arms and depths.
        accuracy: result of :func:`tasks.analysis.prediction.accuracy` at 9 m; empty if not assessed.
        ranges: result of :func:`tasks.analysis.prediction.members_ranges` at 9 m; empty if not assessed.
        rng: source of randomness.
    """
    rows = [_mean_row(scores, arm, *stated) for arm, stated in MEANS.items()]
    rows += [_ratio_row(scores, arm, *stated, rng) for arm, stated in RATIOS.items()]
    rows += [_variation_row(scores, rng)]
    rows += [_range_row(ranges.get(figure), figure, *stated) for figure, stated in RANGES.items()]
    rows += [_aggregate_row(accuracy, *key, *stated) for key, stated in AGGREGATES.items()]
    rows += _statement_rows(scores)
    rows += [
        Row(what, paper, source, "-", "not comparable", "it takes a robot")
        for what, (paper, source) in PHYSICAL.items()
    ]
    return tuple(rows)


def with_tank_tests(rows: Sequence[Row], *, wet: TankTrials, dry: TankTrials, dry_servo: TankTrials) -> tuple[Row, ...]:
    """Return the comparison with the simulated tank tests of a robot beside those of the paper's built one.

    Args:
        rows: the comparison.
        wet: trials in the filled tank.
        dry: trials on its dry floor with the simulation's motors.
        dry_servo: the same with the torque of the servo at scale.
    """
    found = {
        CROSSES_THE_TANK: f"in simulation {wet.n_crossed} of {wet.n} trials by Froude's law, "
        f"{wet.n_crossed_at_kept_frequencies} of {wet.n} at the simulation's frequencies",
        STAYS_ON_DRY_LAND: f"in simulation it stays in {dry.n_immobile} of {dry.n} trials, and in "
        f"{dry_servo.n_immobile} of {dry_servo.n} with the torque of its servo",
    }
    why = "no robot was built: these are trials of the proposed one in the virtual tank"
    return tuple(replace(row, this_run=found[row.what], why=why) if row.what in found else row for row in rows)


def _mean_row(scores: Scores, arm: ScoredArm, stated: float, source: str) -> Row:
    sample = scores.sample(*arm, DEPTH)
    what = f"{name_of(arm)} at {DEPTH:g} m [m]"
    bound, n = NEGLIGIBLE * MEANS[BEST][0], len(sample.values)
    return _number_row(what, stated, "{:z.1f}", source, mean_of(sample), bound, n, _papers_trials(n, sample))


def _ratio_row(scores: Scores, arm: ScoredArm, stated: float, source: str, rng: Generator) -> Row:
    part, whole = scores.sample(*arm, DEPTH), scores.sample(*BEST, DEPTH)
    what = f"{name_of(arm)} / {name_of(BEST)} at {DEPTH:g} m"
    found, n, n_paper = nested_ratio(part, whole, rng=rng), min(len(part.values), len(whole.values)), float(N_TRIALS)
    if found.low is not None:
        n_paper = _papers_trials(n, *linearised(*terms_of_ratio(part, whole)))
    return _number_row(what, stated, "{:z.0%}", source, found, NEGLIGIBLE_RATIO, n, n_paper)


def _papers_trials(n: int, *samples: NestedSample) -> float:
    """Return the number of trials for which the paper's variance is this run's times n / n_paper.

    Args:
        n: this run's trials.
        *samples: their values; this run's estimate is the sum of the means.
    """
    if not nested(*samples):
        return N_TRIALS
    of_paper = sum(components(sample).of_one_replicate(N_TRIALS) for sample in samples)
    return n * error_of(*samples).variance / of_paper


def _aggregate_row(accuracy: Sequence[Regression], predictor: str, figure: Figure, stated: float, source: str) -> Row:
    what = f"{_FIGURE[figure]} of the members' {predictor}, at {DEPTH:g} m"
    regression = next((row for row in accuracy if row.name == predictor), None)
    if regression is None:
        return Row(what, f"{stated:z.2f}", source, "-", "not comparable", "accuracy was not assessed")
    found: Estimate = getattr(regression, figure)
    n = regression.n_resampled
    n_paper = N_ASSESSED / regression.n_replicates  # of N replicates, the mean has at least 1/N the variance
    return _number_row(what, stated, "{:z.2f}", source, found, NEGLIGIBLE_FIGURE[figure], n, n_paper)


_FIGURE = {"r": "Pearson's R", "slope": "slope"}


def _number_row(
    what: str, stated: float, form: str, source: str, found: Estimate, bound: float, n: int, n_paper: float
) -> Row:
    """Judge the difference between this run's number and the paper's."""
    paper = form.format(stated)
    if found.value is None:
        return Row(what, paper, source, "-", "not comparable", found.reason or "")
    this_run, off = form.format(found.value), found.value - stated
    if found.low is None or found.high is None:
        return Row(what, paper, source, this_run, "not comparable", found.reason or "", found.value)
    wider = math.sqrt(1 + n / n_paper)
    effect = Estimate(off, off + wider * (found.low - found.value), off + wider * (found.high - found.value))
    judged = judge_equivalence(effect, bound, n=n, form=form, n_other=n_paper)
    return Row(what, paper, source, this_run, judged.verdict, judged.why, found.value, *_interval(found, form))


def _interval(found: Estimate, form: str) -> tuple[str, float | None, float | None]:
    """Format an estimate's interval; return the text and the two ends."""
    if found.low is None or found.high is None:
        return "", None, None
    return f"{form.format(found.low)} to {form.format(found.high)}", found.low, found.high


def _range_row(found: MembersRange | None, figure: Figure, low: float, high: float, source: str) -> Row:
    what = f"{_FIGURE[figure]} of the members, at {DEPTH:g} m"
    paper = f"{low:z.2f} to {high:z.2f}"
    if found is None:
        return Row(what, paper, source, "-", "not comparable", "accuracy was not assessed")
    lowest, median, highest = found.lowest, found.median, found.highest
    if lowest.value is None or median.value is None or highest.value is None:
        return Row(what, paper, source, "-", "not comparable", median.reason or "")
    ends = [words for end in (lowest, highest) if (words := _interval(end, "{:z.2f}")[0])]
    this_run = f"{lowest.value:z.2f} to {highest.value:z.2f}"
    judged = _in_range(found, low, high)
    _, *of_median = _interval(median, "{:z.2f}")
    return Row(what, paper, source, this_run, judged.verdict, judged.why, median.value, " and ".join(ends), *of_median)


def _in_range(found: MembersRange, low: float, high: float) -> Judgement:
    """Judge whether the median member lies in the paper's range over members."""
    median = found.median
    if median.low is None or median.high is None:
        return Judgement("not comparable", median.reason or "")
    words = f"the median of {found.n} members, {median.value:z.2f} ({_interval(median, '{:z.2f}')[0]}),"
    if low <= median.low and median.high <= high:
        return Judgement("agrees", f"{words} lies in the paper's range")
    if median.high < low or median.low > high:
        return Judgement("differs", f"{words} lies outside the paper's range")
    return Judgement("cannot tell", f"{words} lies across an end of the paper's range")


def _variation_row(scores: Scores, rng: Generator) -> Row:
    """Compare the deviation over trials of single members with that of the ensemble."""
    what = f"deviation over trials, single member / ensemble, zero-shot at {DEPTH:g} m"
    paper, source = "above 1", '"very high variation in fitness across independent trials", Evolution'
    single, ensemble = (scores.sample(arm, "zero_shot", DEPTH) for arm in ("single_member", "residual_slush"))
    trials = f"{len(single.values)} and {len(ensemble.values)} trials"
    departures = [from_replicates_means(sample) for sample in (single, ensemble)]
    n_free = [len(sample.values) - len(np.unique(sample.replicate)) for sample in (single, ensemble)]
    if min(n_free) < 1 or is_constant(departures[1], resolution=RESOLUTION):
        why = f"{trials}, expected at least 2 of both in a replicate, not all equal"
        return Row(what, paper, source, "-", "not comparable", why)
    # A deviation is a function of the means of x and x², once x is centred so that no digits are lost.
    moments = [np.stack((x, x**2), axis=1) for x in departures]
    corrections = len(departures[0]) / n_free[0], len(departures[1]) / n_free[1]
    spread = "the ensemble's champions all go equally far"
    found = bootstrap(partial(_deviations_ratio, corrections), *moments, rng=rng, undefined=spread)[0]
    assert found.value is not None
    this_run = f"{found.value:z.2f}"
    if found.low is None or found.high is None:
        return Row(what, paper, source, this_run, "not comparable", f"{trials}: {found.reason}", found.value)
    judged = _above_one(found.low, found.high)
    interval = _interval(found, "{:z.2f}")
    return Row(what, paper, source, this_run, judged.verdict, f"{trials}: {judged.why}", found.value, *interval)


def _above_one(low: float, high: float) -> Judgement:
    if low > 1:
        return Judgement("agrees", "the whole interval is above 1")
    if high < 1:
        return Judgement("differs", "the whole interval is below 1")
    return Judgement("cannot tell", "the interval contains 1")


def _deviations_ratio(corrections: tuple[float, float], single: Float64, ensemble: Float64) -> Float64:
    """Return the ratio of two sample deviations, (..., 1).

    Args:
        corrections: number of values over degrees of freedom, of both samples.
        single: (..., 2) means of x and x².
        ensemble: (..., 2) likewise.
    """
    x, y = (
        correction * (means[..., 1] - means[..., 0] ** 2)
        for correction, means in zip(corrections, (single, ensemble), strict=True)
    )
    return np.sqrt(x / np.where(y > 0, y, np.nan))[..., None]


def _statement_rows(scores: Scores) -> list[Row]:
    """Judge all statements by Holm's step-down procedure."""
    stated = [(statement, depth) for statement in STATEMENTS for depth in statement.depths]
    n_comparable = sum(_test_of(scores, statement, depth)[1].low is not None for statement, depth in stated)
    decided: dict[int, Row] = {}
    while True:
        level = 1 - (1 - LEVEL) / max(n_comparable - len(decided), 1)
        judged = {
            i: _statement_row(scores, statement, depth, level)
            for i, (statement, depth) in enumerate(stated)
            if i not in decided
        }
        found = {i: row for i, row in judged.items() if row.verdict in ("agrees", "differs")}
        decided |= found
        if not found or len(found) == len(judged):
            return [row for _, row in sorted((judged | decided).items())]


def _test_of(
    scores: Scores, statement: Statement, depth: float, level: float = LEVEL
) -> tuple[SignificanceTest, Estimate]:
    """Return the paper's test and the difference of the means that it is about."""
    samples = [scores.sample(*arm, depth) for arm in (statement.a, statement.b)]
    return student(*(sample.values for sample in samples)), nested_difference(*samples, level=level)


def _statement_row(scores: Scores, statement: Statement, depth: float, level: float) -> Row:
    what = t_test_words(depth, statement.a, statement.b)
    threshold = f"p > {INSIGNIFICANT:g}" if statement.claim == "no difference" else f"p < {SIGNIFICANT:g}"
    paper = f"{statement.claim} ({threshold})"
    a, b, best = (scores.sample(*arm, depth).values for arm in (statement.a, statement.b, BEST))
    test, gap = _test_of(scores, statement, depth, level)
    if test.p is None or gap.low is None:
        return Row(what, paper, statement.source, "-", "not comparable", test.reason or gap.reason or "")
    bound = NEGLIGIBLE * abs(float((best if len(best) else b).mean()))
    n = min(len(a), len(b))
    if statement.claim == "no difference":
        judged = judge_equivalence(gap, bound, n=n, form=_METRES)
    else:
        judged = judge_direction(gap, statement.claim, bound, n=n, form=_METRES)
    direction = "greater" if a.mean() > b.mean() else "less"
    this_run = f"{direction}, p = {test.p:.2g}, n = {len(a)} and {len(b)}"
    words, low, high = _interval(gap, "{:z.1f}")
    interval = f"difference {words} m, at {level:.1%}"
    return Row(
        what, paper, statement.source, this_run, judged.verdict, judged.why, gap.value, interval, low, high, test.p
    )
