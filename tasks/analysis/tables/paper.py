"""A run's comparison with the paper's results, number by number and statement by statement.

- A number agrees if the difference from the paper's is shown to be negligible. The interval of the difference is wider
  than this run's, because the paper's number comes from a sample too: variances add. The paper's deviation, which it
  does not give, is taken to be this run's. The paper has one data set and one ensemble: where this run has several, its
  variance between them counts in full for the paper.
- The statement that single members vary more agrees if the whole interval of the ratio is above 1. Deviations are from
  the replicate's mean, because the paper has one replicate.
- Statements about t tests are comparisons of two arms (tasks/analysis/comparison.py), by Welch's test in place of
  Student's. "No difference" agrees if the difference is shown to be negligible. "Less" and "greater" agree if it has
  that direction and p < 0.05, corrected by Holm's procedure over all statements.

Numbers that this run did not measure have no row.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from numpy.random import Generator

from tasks.analysis import paper as published
from tasks.analysis.columns import column
from tasks.analysis.comparison import VERDICTS, Verdict, compare, holm, judge, p_value
from tasks.analysis.estimates import (
    LEVEL,
    RESOLUTION,
    Estimate,
    Sample,
    between,
    error_of,
    error_of_mean,
    linearised,
    ratio,
    sum_of_means,
    within_replicates,
)
from tasks.analysis.paper import BEST, DEPTH, N_ASSESSED, N_TRIALS, Figure
from tasks.analysis.registry import analysis
from tasks.analysis.scores import ScoredArm, ScoredTrial, arm_name, sample
from tasks.analysis.study import StudyData
from tasks.analysis.tables.regressions import regressions_of

_FIGURE: Mapping[Figure, str] = {"r": "Pearson's R", "slope": "slope"}


@dataclass(frozen=True)
class PaperRow:
    """A result of the paper, and what this run has in its place."""

    kind: Literal["number", "t test"] = column("kind", form="{}", shown=False)
    what: str = column("what", form="{}")
    paper: str = column("paper", form="{}")
    this_run: str = column("this run (95 %)", form="{}")
    decides: str = column(
        "decides", form="{}", meaning="The interval that decides, of the difference Δ, and the bounds."
    )
    verdict: Verdict = column("verdict", form="{}")
    value: Estimate = column("value", form="{:z.3g}", shown=False, meaning="This run's, in the unit of what.")
    p: float | None = column("p", form=p_value, shown=False, meaning="Of Welch's test, corrected.")
    source: str = column("source", form="{}", shown=False, meaning="Quotation and section of the paper.")

    @property
    def is_metres(self) -> bool:
        """Whether a displacement itself is compared."""
        return self.kind == "number" and self.what.endswith("[m]")


def written(estimate: Estimate, form: str) -> str:
    """Write an estimate with its interval in brackets."""
    value = "–" if estimate.value is None else form.format(estimate.value)
    ends = between(*map(form.format, estimate.interval or ()))
    return f"{value} ({ends})" if ends else value


def _metrics(rows: Sequence[PaperRow]) -> dict[str, float]:
    counts = Counter(row.verdict for row in rows)
    return {f"paper.n_{verdict.replace(' ', '_')}": float(counts[verdict]) for verdict in VERDICTS}


@analysis(
    "paper",
    row=PaperRow,
    reads=("champions", "predictions"),
    answers="Which results of the paper does this run confirm?",
    section="paper",
    version=2,
    shown=lambda row: row.kind == "number",
    metrics=_metrics,
)
def paper(study: StudyData) -> list[PaperRow]:
    """Compare every number and statement of the paper that this run measured."""
    trials, settings = study.trials, study.settings
    at_depth = settings.data_sets and settings.assessed_depth == DEPTH
    numbers = [*_means(trials), *_ratios(trials, study.rng("paper")), *_variation(trials)]
    return [*numbers, *(_figures(study) if at_depth else ()), *_statements(trials)]


def _name(arm: ScoredArm) -> str:
    """Name an arm; zero-shot designs of True Slush are at home there."""
    return "True Slush" if arm == BEST else arm_name(arm)


def _means(trials: Sequence[ScoredTrial]) -> Iterator[PaperRow]:
    for arm, (value, source) in published.MEANS.items():
        of_arm, what = sample(trials, arm, DEPTH), f"{_name(arm)} at {DEPTH:g} m [m]"
        mean, bound = sum_of_means(of_arm), published.NEGLIGIBLE * published.MEANS[BEST][0]
        yield from _number(what, value, "{:z.1f}", source, mean, bound, _widened(of_arm) if mean.interval else 1.0)


def _ratios(trials: Sequence[ScoredTrial], rng: Generator) -> Iterator[PaperRow]:
    for arm, (value, source) in published.RATIOS.items():
        part, whole = sample(trials, arm, DEPTH), sample(trials, BEST, DEPTH)
        share, what = ratio(part, whole, rng=rng), f"{_name(arm)} / {_name(BEST)} at {DEPTH:g} m"
        wider = _widened(*linearised(part, whole)) if share.interval else 1.0
        yield from _number(what, value, "{:z.0%}", source, share, published.NEGLIGIBLE_RATIO, wider)


def _widened(*samples: Sample) -> float:
    """Return the factor by which the paper's own trials, if they vary like these, widen the interval of their sum."""
    return math.sqrt(1 + sum(map(_variance_of_paper, samples)) / error_of(*samples)[0])


def _variance_of_paper(sample: Sample) -> float:
    """Return the variance of the mean of the paper's trials, which share a replicate."""
    n_replicates, within = len(np.unique(sample.replicate)), within_replicates(sample)[0]
    between = n_replicates * (error_of_mean(sample)[0] - within / len(sample))
    return max(between, 0.0) + within / N_TRIALS


def _variation(trials: Sequence[ScoredTrial]) -> Iterator[PaperRow]:
    """Compare the deviation over trials of single members with that of the ensemble, by the F distribution."""
    single, ensemble = (sample(trials, (arm, "zero_shot"), DEPTH) for arm in ("single_member", "residual_slush"))
    (x, n_x), (y, n_y) = within_replicates(single), within_replicates(ensemble)
    if min(n_x, n_y) < 1 or y <= RESOLUTION**2:
        return
    ends = (math.sqrt(x / y / scipy.stats.f.ppf(tail, n_x, n_y)) for tail in ((1 + LEVEL) / 2, (1 - LEVEL) / 2))
    spread = Estimate(math.sqrt(x / y), *ends)
    what = f"deviation over trials, single member / ensemble, zero-shot at {DEPTH:g} m"
    source = '"very high variation in fitness across independent trials", Evolution'
    this_run, verdict = written(spread, "{:z.2f}"), judge(spread, 1.0, math.inf)
    yield PaperRow("number", what, "above 1", this_run, "the interval, above 1", verdict, spread, None, source)


def _figures(study: StudyData) -> Iterator[PaperRow]:
    """Compare R and slope of the aggregates of the main ensemble's members."""
    data_set = study.settings.data_sets[0]
    assessed = study.assessed(data_set)
    if assessed is None:
        return
    n_trials, n_replicates = len(np.unique(assessed.trial)), len(np.unique(assessed.replicate))
    wider = math.sqrt(1 + n_trials * n_replicates / N_ASSESSED)  # R replicates' mean has at least 1/R of the variance
    rows = {row.name: row for row in regressions_of(study, data_set)}
    for (predictor, figure), (value, source) in published.AGGREGATES.items():
        what = f"{_FIGURE[figure]} of the members' {predictor}, at {DEPTH:g} m"
        estimate = getattr(rows[predictor], figure)
        yield from _number(what, value, "{:z.2f}", source, estimate, published.NEGLIGIBLE_FIGURE[figure], wider)


def _number(
    what: str, value: float, form: str, source: str, ours: Estimate, bound: float, wider: float
) -> Iterator[PaperRow]:
    """Judge the difference between this run's number and the paper's, whose interval is wider by a factor."""
    if ours.value is None:
        return
    off = ours.value - value
    gap = Estimate(off, *(off + wider * (end - ours.value) for end in ours.interval or ()))
    decides = f"Δ {written(gap, form)}, within ± {form.format(bound)}"
    verdict = judge(gap, -bound, bound)
    yield PaperRow("number", what, form.format(value), written(ours, form), decides, verdict, ours, None, source)


def _statements(trials: Sequence[ScoredTrial]) -> Iterator[PaperRow]:
    """Judge the paper's statements about t tests, as one family."""
    tests = [
        (statement, row)
        for statement in published.STATEMENTS
        for row in reversed(compare(trials, trials, [(statement.a, statement.b)], BEST[0]))
        if row.depth in statement.depths and row.p is not None
    ]
    for (statement, row), p in zip(tests, holm([row.p for _, row in tests]), strict=True):
        assert p is not None
        verdict, claim, limit = row.verdict, statement.claim, f"> {published.INSIGNIFICANT:g}"
        if claim != "no difference":
            limit = f"< {published.SIGNIFICANT:g}"
            if p < 1 - LEVEL:
                verdict = "agrees" if ((row.difference.value or 0.0) > 0) == (claim == "greater") else "differs"
            else:
                verdict = "differs" if verdict == "agrees" else "cannot tell"  # it is negligible
        what = f"{_name(statement.a)} against {_name(statement.b)} at {row.depth:g} m [m]"
        decides = f"Δ {written(row.difference, '{:z.1f}')}, negligible within ± {row.bound:.1f}"
        this_run, paper = f"n = {row.of_a.n} and {row.of_b.n}, p = {p:.2g}", f"{claim} (p {limit})"
        yield PaperRow("t test", what, paper, this_run, decides, verdict, row.difference, p, statement.source)
