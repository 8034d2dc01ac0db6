"""The paper's results as data, and a run's comparison with them.

- A number agrees if it lies within this run's 95 % prediction interval, the range for a repeat of this run with the
  paper's number of trials. Both arms of this run's 95 % interval are widened by √(1 + n / n_paper), because the paper's
  number comes from a sample too: variances add and are proportional to 1/n.
- A range over members agrees if it contains this run's median member.
- The statement that single members vary more agrees or differs if the whole interval does.
- A t test with "p < 0.0001" agrees if this run's p is as small in the same direction. One with "insignificant (p >
  0.01)" agrees if this run's p is above 0.01. Fewer trials than the paper's make large p-values easy and small ones
  hard, so effects that they fail to show are not comparable; effects that they show count.

Anything that this run did not measure, or that has too few values for an interval, is not comparable.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.random import Generator

from tasks.analysis.comparison import BEST, ScoredArm, Scores, difference, ratio, student
from tasks.analysis.prediction import Figure, MembersRange, Regression, mean_less_deviations
from tasks.analysis.uncertainty import RESOLUTION, Estimate, bootstrap, finite, is_constant, mean
from tasks.arrays import Float64

Verdict = Literal["agrees", "differs", "not comparable"]
Claim = Literal["less", "greater", "no difference"]

DEPTH = 9.0  # depth of the paper's prediction accuracy and of Fig. 4A [m]
N_TRIALS = 10  # trials of each environment at each depth: "Evolution"
N_DESIGNS = 2376  # designs of the prediction accuracy: "Prediction Accuracy"
SIGNIFICANT, INSIGNIFICANT = 1e-4, 0.01  # the paper's two thresholds: p below the first, p above the second

MEANS: Mapping[ScoredArm, tuple[float, str]] = {
    ("true_slush", "zero_shot"): (13.6, '"mean displacement 13.6 m", Evolution'),
    ("dry_land", "zero_shot"): (-0.8, '"mean -0.8 m", Evolution'),
    ("dry_land", "adapted"): (4.8, '"increases from -0.8 to 4.8 m", Evolution'),
}
"""Mean displacement in True Slush at 9 m [m]."""

RATIOS: Mapping[ScoredArm, tuple[float, str]] = {
    ("dry_land", "adapted"): (0.35, '"still only achieves 35% of mean fitness", Evolution'),
    ("residual_slush", "zero_shot"): (0.67, '"recover 67% … with their evolved controllers", Evolution'),
    ("residual_slush", "adapted"): (0.87, '"and 87% with controller adaptation", Evolution'),
}
"""Mean displacement divided by that of designs that evolved in True Slush, at 9 m."""

AGGREGATES: Mapping[tuple[str, Figure], tuple[float, str]] = {
    (mean_less_deviations(0), "r"): (0.77, '"a correlation coefficient of 0.77", Fig. 3'),
    (mean_less_deviations(0), "slope"): (1.26, '"and a slope of 1.26", Fig. 3'),
    (mean_less_deviations(1), "r"): (0.60, '"a slightly reduced correlation coefficient of 0.6", Fig. 3'),
    (mean_less_deviations(1), "slope"): (0.99, '"a nearly ideal regression slope of 0.99", Fig. 3'),
}
"""Figures of aggregates of the eight members."""

RANGES: Mapping[Figure, tuple[float, float, str]] = {
    "r": (0.24, 0.68, '"ranging from 0.24 and 0.68", Fig. 3'),
    "slope": (0.25, 0.76, '"ranging from 0.25 to 0.76", Fig. 3'),
}
"""Ranges of figures over the eight members."""


@dataclass(frozen=True)
class Statement:
    """A statement of the paper about a t test."""

    a: ScoredArm
    b: ScoredArm
    claim: Claim  # whether a is less or greater than b
    depths: tuple[float, ...]  # [m]
    source: str


_DRY_LAND: ScoredArm = ("dry_land", "adapted")
_RESIDUAL: ScoredArm = ("residual_slush", "adapted")
_DEEP = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, DEPTH)
_SHALLOW = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
_SAME_AT_50_CM = '"insignificant (p > 0.01) difference between Dry Land designs and True Slush for 0.5m", Evolution'
_BELOW_BOTH = '"significantly under-performed both those evolved in Residual Slush and …", Evolution'
_SAME_TO_3_M = '"insignificantly different … up until 3m of slush (p > 0.01)", Evolution'
_ZERO_SHOT = '"significantly more performant … (Student\'s t-test, p < 0.0001; n=10)", Evolution'

STATEMENTS = (
    Statement(_DRY_LAND, BEST, "no difference", (0.5,), _SAME_AT_50_CM),
    Statement(_DRY_LAND, BEST, "less", _DEEP, '"p < 0.0001 for all slush depths > 0.5m", Evolution'),
    Statement(_DRY_LAND, _RESIDUAL, "less", _DEEP, _BELOW_BOTH),
    Statement(_RESIDUAL, BEST, "no difference", _SHALLOW, _SAME_TO_3_M),
    Statement(("residual_slush", "zero_shot"), _DRY_LAND, "greater", (DEPTH,), _ZERO_SHOT),
)
"""For the sweep over depths the paper does not name the controllers; its Fig. 4B shows the adapted ones."""

PHYSICAL = (
    ("crosses the tank of slush", "8 of 8 trials", "Fig. 5"),
    ("moves on dry land", "a few centimetres in 150 s, in 6 of 6 trials", "Fig. 5"),
)
"""Results of the built robot."""


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
    interval: str = ""  # text of the 95 % interval, for a range those of its two ends; empty if there is none
    low: float | None = None
    high: float | None = None  # ends of the 95 % interval of ``value``; None if there is none
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
    rows += [_statement_row(scores, statement, depth) for statement in STATEMENTS for depth in statement.depths]
    rows += [
        Row(f"the built robot {what}", paper, source, "-", "not comparable", "it takes a robot")
        for what, paper, source in PHYSICAL
    ]
    return tuple(rows)


NAMES: Mapping[str, str] = {
    "true_slush": "True Slush",
    "dry_land": "Dry Land",
    "residual_slush": "Residual Slush",
    "single_member": "Single member",
    "zero_shot": "zero-shot",
    "adapted": "adapted",
}
"""Labels of the paper's arms and quantities."""


def name_of(arm: ScoredArm) -> str:
    """Return an arm's label; zero-shot designs of True Slush are at home there, so 'zero-shot' is left out."""
    evolved_in, quantity = arm
    return NAMES[evolved_in] if arm == BEST else f"{NAMES[evolved_in]} {NAMES[quantity]}"


def _mean_row(scores: Scores, arm: ScoredArm, stated: float, source: str) -> Row:
    values = finite(scores.values(*arm, DEPTH))
    what = f"{name_of(arm)} at {DEPTH:g} m [m]"
    return _number_row(what, stated, "{:z.1f}", source, mean(values), len(values), N_TRIALS, "trials")


def _ratio_row(scores: Scores, arm: ScoredArm, stated: float, source: str, rng: Generator) -> Row:
    part, whole = finite(scores.values(*arm, DEPTH)), finite(scores.values(*BEST, DEPTH))
    what = f"{name_of(arm)} / {name_of(BEST)} at {DEPTH:g} m"
    n = min(len(part), len(whole))
    return _number_row(what, stated, "{:z.0%}", source, ratio(part, whole, rng=rng), n, N_TRIALS, "trials")


def _aggregate_row(accuracy: Sequence[Regression], predictor: str, figure: Figure, stated: float, source: str) -> Row:
    what = f"{_FIGURE[figure]} of the members' {predictor}, at {DEPTH:g} m"
    of = next((row for row in accuracy if row.name == predictor), None)
    if of is None:
        return Row(what, f"{stated:z.2f}", source, "-", "not comparable", "accuracy was not assessed")
    return _number_row(what, stated, "{:z.2f}", source, getattr(of, figure), of.n, N_DESIGNS, "designs")


_FIGURE = {"r": "Pearson's R", "slope": "slope"}


def _number_row(
    what: str, stated: float, form: str, source: str, found: Estimate, n: int, n_paper: int, unit: str
) -> Row:
    """Compare a number of the paper with this run's prediction interval."""
    paper = form.format(stated)
    if found.value is None:
        return Row(what, paper, source, "-", "not comparable", found.reason or "")
    if found.low is None or found.high is None:
        return Row(what, paper, source, form.format(found.value), "not comparable", found.reason or "", found.value)
    wider = math.sqrt(1 + n / n_paper)
    low, high = (found.value + wider * (end - found.value) for end in (found.low, found.high))
    agrees = low <= stated <= high
    why = (
        f"a repeat with {n_paper} {unit} would give {form.format(low)} to {form.format(high)}, "
        f"judged by the spread of this run's {n}"
    )
    this_run, verdict = form.format(found.value), _agrees(agrees)
    return Row(what, paper, source, this_run, verdict, why, found.value, *_interval(found, form))


def _agrees(holds: bool) -> Verdict:
    return "agrees" if holds else "differs"


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
    _, *of_median = _interval(median, "{:z.2f}")
    why = f"the median of {found.n} members is {median.value:z.2f}"
    this_run = f"{lowest.value:z.2f} to {highest.value:z.2f}"
    verdict = _agrees(low <= median.value <= high)
    return Row(what, paper, source, this_run, verdict, why, median.value, " and ".join(ends), *of_median)


def _variation_row(scores: Scores, rng: Generator) -> Row:
    """Compare the deviation over trials of single members with that of the ensemble."""
    what = f"deviation over trials, single member / ensemble, zero-shot at {DEPTH:g} m"
    paper, source = "above 1", '"very high variation in fitness across independent trials", Evolution'
    single, ensemble = (finite(scores.values(arm, "zero_shot", DEPTH)) for arm in ("single_member", "residual_slush"))
    if min(len(single), len(ensemble)) < 2 or is_constant(ensemble, resolution=RESOLUTION):
        why = f"{len(single)} and {len(ensemble)} trials, expected 2 or more of both, not all equal"
        return Row(what, paper, source, "-", "not comparable", why)
    # A deviation is a function of the means of x and x², once x is centred so that no digits are lost.
    moments = [np.stack((x - x.mean(), (x - x.mean()) ** 2), axis=1) for x in (single, ensemble)]
    spread = "the ensemble's champions all go equally far"
    found = bootstrap(partial(_deviations_ratio, len(single), len(ensemble)), *moments, rng=rng, undefined=spread)[0]
    assert found.value is not None
    trials, this_run = f"{len(single)} and {len(ensemble)} trials", f"{found.value:z.2f}"
    if found.low is None or found.high is None:
        return Row(what, paper, source, this_run, "not comparable", f"{trials}: {found.reason}", found.value)
    verdict, why = _above_one(found.low, found.high)
    return Row(what, paper, source, this_run, verdict, f"{trials}: {why}", found.value, *_interval(found, "{:z.2f}"))


def _above_one(low: float, high: float) -> tuple[Verdict, str]:
    if low > 1:
        return "agrees", "the whole interval is above 1"
    if high < 1:
        return "differs", "the whole interval is below 1"
    return "not comparable", "the interval holds 1, too few to tell"


def _deviations_ratio(n: int, m: int, single: Float64, ensemble: Float64) -> Float64:
    """Return the ratio of the sample deviations of n and m values, from (..., 2) means of x and x²: (..., 1)."""
    variances = [
        size / (size - 1) * (means[..., 1] - means[..., 0] ** 2) for size, means in ((n, single), (m, ensemble))
    ]
    return np.sqrt(variances[0] / np.where(variances[1] > 0, variances[1], np.nan))[..., None]


def _statement_row(scores: Scores, statement: Statement, depth: float) -> Row:
    what = f"Student's t at {depth:g} m: {name_of(statement.a)} against {name_of(statement.b)}"
    bound = f"p > {INSIGNIFICANT:g}" if statement.claim == "no difference" else f"p < {SIGNIFICANT:g}"
    paper = f"{statement.claim} ({bound})"
    a, b = (finite(scores.values(*arm, depth)) for arm in (statement.a, statement.b))
    test = student(a, b)
    if test.p is None:
        return Row(what, paper, statement.source, "-", "not comparable", test.reason or "")
    direction: Literal["less", "greater"] = "greater" if a.mean() > b.mean() else "less"
    verdict, why = _judge(statement.claim, direction, test.p, min(len(a), len(b)))
    this_run = f"{direction}, p = {test.p:.2g}, n = {len(a)} and {len(b)}"
    gap = difference(a, b)
    words, low, high = _interval(gap, "{:z.1f}")
    interval = f"difference {words} m"
    return Row(what, paper, statement.source, this_run, verdict, why, gap.value, interval, low, high, test.p)


def _judge(claim: Claim, direction: Claim, p: float, n: int) -> tuple[Verdict, str]:
    """Compare a statement about a t test with this run's direction and p, from at least n trials."""
    if claim == "no difference":
        if p <= INSIGNIFICANT:
            return "differs", f"p is not above {INSIGNIFICANT:g}"
        shown: tuple[Verdict, str] = ("agrees", f"p is above {INSIGNIFICANT:g}")
    elif direction == claim:
        if p < SIGNIFICANT:
            return "agrees", f"p is below {SIGNIFICANT:g}, in the same direction"
        shown = ("differs", f"p is not below {SIGNIFICANT:g}")
    else:
        if p <= INSIGNIFICANT:
            return "differs", "the difference is significant in the other direction"
        shown = ("differs", "the difference is in the other direction")
    return ("not comparable", f"{n} trials have not the power of the paper's {N_TRIALS}") if n < N_TRIALS else shown
