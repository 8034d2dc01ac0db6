"""Verdicts by equivalence: whether an effect is shown to be negligible, shown not to be, or neither.

An effect is negligible if it lies within bounds that are stated beforehand. It is shown to be negligible if its whole
95 % interval lies within the bounds, which is the procedure of two one-sided tests (TOST; Schuirmann 1987) at 2.5 %. It
is shown not to be if the whole interval lies outside them. Otherwise there are too few trials to tell: a test of "no
difference" with a large p-value shows nothing.

Where the bound is a share of a mean that was measured, such as a fifth of that of *E*, it is an estimate, and the
difference contains the same mean. At the upper edge an effect then passes for negligible up to 4 % of the time in place
of 2.5 %, and at the lower edge less often.
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

from tasks.analysis.uncertainty import Estimate

Verdict = Literal["agrees", "differs", "cannot tell", "not comparable"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
Direction = Literal["less", "greater"]

MOST_TRIALS = 1000  # numbers of trials above it are not worth naming


@dataclass(frozen=True)
class Judgement:
    """A verdict and its reason."""

    verdict: Verdict
    why: str
    n_needed: float | None = None  # trials that would tell, where the verdict is "cannot tell"; inf where none would


def judge_equivalence(effect: Estimate, bound: float, *, n: float, form: str, n_other: float = math.inf) -> Judgement:
    """Return whether an effect lies within ± bound, with the reason.

    Args:
        effect: with its 95 % interval.
        bound: largest negligible effect, in the effect's unit.
        n: number of trials that the interval comes from; their harmonic mean for two groups that can both grow.
        form: format of effects, such as "{:z.1f} m".
        n_other: number of trials of another sample whose uncertainty the interval includes and which can't grow.
    """
    if effect.value is None or effect.low is None or effect.high is None:
        return Judgement("not comparable", effect.reason or "")
    within, interval = f"± {form.format(bound)}", _words(effect, form)
    if -bound <= effect.low and effect.high <= bound:
        return Judgement("agrees", f"the difference, {interval}, lies within {within}")
    if effect.low > bound or effect.high < -bound:
        return Judgement("differs", f"the difference, {interval}, lies outside {within}")
    n_needed = _n_needed((effect.high - effect.low) / 2, abs(bound - abs(effect.value)), n, n_other)
    needs = _needs(n_needed, n_other)
    return Judgement("cannot tell", f"the difference, {interval}, lies across {within} ({needs})", n_needed)


def judge_direction(effect: Estimate, claim: Direction, bound: float, *, n: int, form: str) -> Judgement:
    """Return whether an effect has the direction that is claimed, with the reason.

    Args:
        effect: with its 95 % interval.
        claim: whether the effect is said to be below or above 0.
        bound: largest negligible effect, in the effect's unit.
        n: number of trials of each group.
        form: format of effects, such as "{:z.1f} m".
    """
    if effect.value is None or effect.low is None or effect.high is None:
        return Judgement("not comparable", effect.reason or "")
    interval = _words(effect, form)
    claimed, opposite = effect.low > 0, effect.high < 0
    if claim == "less":
        claimed, opposite = opposite, claimed
    if claimed:
        return Judgement("agrees", f"the difference, {interval}, has the claimed direction")
    if opposite:
        return Judgement("differs", f"the difference, {interval}, has the other direction")
    if -bound <= effect.low and effect.high <= bound:
        return Judgement("differs", f"the difference, {interval}, lies within ± {form.format(bound)}")
    n_needed = _n_needed((effect.high - effect.low) / 2, abs(effect.value), n, math.inf)
    needs = _needs(n_needed, math.inf)
    return Judgement("cannot tell", f"the difference, {interval}, may have either direction ({needs})", n_needed)


def _words(effect: Estimate, form: str) -> str:
    return f"{form.format(effect.value)} ({form.format(effect.low)} to {form.format(effect.high)})"


def _n_needed(half: float, room: float, n: float, n_other: float) -> float:
    """Return how many trials would make an interval of n trials, with this half width, fit into the room.

    The variance of an effect is proportional to 1 / n + 1 / n_other.
    """
    inverse = (room / half) ** 2 * (1 / n + 1 / n_other) - 1 / n_other
    return math.inf if inverse <= 0 else math.ceil(1 / inverse)


def _needs(n_needed: float, n_other: float) -> str:
    if math.isinf(n_needed) and math.isfinite(n_other):
        return "no number of trials is enough: the paper's own are too few"
    if n_needed > MOST_TRIALS:
        return f"needs more than {MOST_TRIALS:,} trials"
    return f"needs about {n_needed:g} trials"
