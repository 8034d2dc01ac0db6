"""The one comparison: two arms of a study, or one arm in two studies, with the interval that decides the verdict.

The interval of the difference of the means is Welch's, because champions of different environments have different
variances. Where trials share throws and networks, it includes the variance between replicates. p-values are corrected
by Holm's procedure over all rows that are shown together, which statsmodels has, but not for p-values that are missing.

A difference *agrees* with none if its whole interval lies within the bounds: the procedure of two one-sided tests
(Schuirmann 1987) at 2.5 %. It *differs* if the interval lies outside them and the corrected p-value is below
5 %. Otherwise these trials *cannot tell*: a large p-value shows nothing. The two groups count as independent, which
makes the tests of arms that share networks, or of studies that share a seed, cautious.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import scipy

from tasks.analysis.columns import SCORE, column
from tasks.analysis.estimates import LEVEL, Estimate, Mean, Sample, error_of, mean_of, sum_of_means
from tasks.analysis.paper import NEGLIGIBLE
from tasks.analysis.scores import QUANTITIES, ScoredArm, ScoredTrial, arm_name, sample
from tasks.world import EnvironmentName

Verdict = Literal["agrees", "differs", "cannot tell", "identical"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)[:3]  # of a test; arms of the very same trials need none


def judge(effect: Estimate, low: float, high: float) -> Verdict:
    """Return whether the interval of an effect lies within the bounds of what is negligible, outside, or across."""
    if effect.low is None or effect.high is None:
        return "cannot tell"
    if low <= effect.low and effect.high <= high:
        return "agrees"
    return "differs" if effect.low > high or effect.high < low else "cannot tell"


def p_value(p: float) -> str:
    """Write a probability to two digits, and a very small one as a bound."""
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}"


def written_arm(arm: str) -> str:
    """Write an arm as readers know it: "residual_slush/adapted" is "Residual Slush adapted"."""
    environment, _, quantity = arm.partition("/")
    return arm_name((environment, quantity)) if quantity in QUANTITIES else arm  # type: ignore[arg-type]


@dataclass(frozen=True)
class Comparison:
    """Two groups of champions at one depth; b is the reference."""

    a: str = column("A", form=written_arm, meaning="Environment where A evolved, and the quantity.")
    b: str = column("B", form=written_arm, meaning="The same of B, the reference.")
    depth: float = column("depth", "m", form="{:g}")
    of_a: Mean = column("mean of A", SCORE)
    of_b: Mean = column("mean of B", SCORE)
    difference: Estimate = column("A − B", SCORE, meaning="Difference of the means, with the interval that decides.")
    bound: float = column("negligible", SCORE, form="± {:.1f}", meaning="Largest difference that counts as none.")
    p: float | None = column("p", form=p_value, shown=False, meaning="Of the test that the interval belongs to.")
    p_holm: float | None = column("p (Holm)", form=p_value, meaning="p, corrected over the rows shown together.")
    verdict: Verdict = column("verdict", form="{}", meaning="Whether the difference is negligible.")


def compare(
    a: Sequence[ScoredTrial],
    b: Sequence[ScoredTrial],
    pairs: Sequence[tuple[ScoredArm, ScoredArm]],
    target: EnvironmentName,
) -> list[Comparison]:
    """Compare arms of one study, or of two, at every depth where both have champions, the greatest depth first.

    B is the reference; a and b are the same for arms of one study. ``pairs`` are an arm of A and one of B each. A share
    of what designs of the target score, where champions are transferred to, is negligible. Identical arms come last.
    """
    depths = sorted({trial.depth for trial in a} & {trial.depth for trial in b}, reverse=True)
    rows = [
        _compared(x, y, of_a, of_b, depth, sample(b, (target, "zero_shot"), depth))
        for depth in depths
        for of_a, of_b in pairs
        if len(x := sample(a, of_a, depth)) and len(y := sample(b, of_b, depth))
    ]
    corrected = zip(rows, holm([row.p for row in rows]), strict=True)
    judged = [replace(row, p_holm=p, verdict=_after_correction(row, p)) for row, p in corrected]
    return sorted(judged, key=lambda row: row.verdict == "identical")


def _after_correction(row: Comparison, p_holm: float | None) -> Verdict:
    return "cannot tell" if row.verdict == "differs" and p_holm is not None and p_holm >= 1 - LEVEL else row.verdict


def _compared(x: Sample, y: Sample, a: ScoredArm, b: ScoredArm, depth: float, best: Sample) -> Comparison:
    gap, p = difference(x, y)
    bound = NEGLIGIBLE * abs(float((best if len(best) else y).values.mean()))
    means = mean_of(x.values), mean_of(y.values)
    verdict = "identical" if np.array_equal(x.values, y.values) else judge(gap, -bound, bound)
    return Comparison("/".join(a), "/".join(b), depth, *means, gap, bound, p, None, verdict)


def difference(x: Sample, y: Sample) -> tuple[Estimate, float | None]:
    """Estimate the difference of the means of x and y, and return the p-value of its two-sided test."""
    if len(x) and np.array_equal(x.values, y.values):  # the very same trials in two studies
        return Estimate(0.0, 0.0, 0.0), None
    gap = sum_of_means(x, replace(y, values=-y.values))
    if gap.value is None or gap.interval is None:
        return gap, None
    variance, freedom = error_of(x, y)
    return gap, float(2 * scipy.stats.t.sf(abs(gap.value) / math.sqrt(variance), freedom))


def holm(p: Sequence[float | None]) -> list[float | None]:
    """Correct p-values for multiple comparisons (Holm 1979); None stays None and does not count."""
    known = np.array([value for value in p if value is not None])
    order = np.argsort(known, kind="stable")
    scaled = np.maximum.accumulate(known[order] * np.arange(len(known), 0, -1)).clip(max=1.0)
    corrected = iter(scaled[np.argsort(order, kind="stable")].tolist())
    return [None if value is None else next(corrected) for value in p]
