"""Sensitivity: whether making a choice otherwise, one at a time, changes how far champions travel.

The tests are those of the paper: Student's t, two-sided, with its interval of the difference. Holm's correction has all
variants as its family. A difference is negligible within ``NEGLIGIBLE`` times the base's mean; see equivalence.py.
The number of trials is that which shows a difference of that size, from the base's own deviation, at the level that
Holm's correction asks of the smallest p-value.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tasks.analysis.comparison import Group, SignificanceTest, difference, group, holm, student
from tasks.analysis.equivalence import Judgement, judge_equivalence
from tasks.analysis.paper import NEGLIGIBLE
from tasks.analysis.statistical_power import n_trials_for
from tasks.analysis.uncertainty import LEVEL, Estimate, finite
from tasks.arrays import Floats

_METRES = "{:z.2f} m"


@dataclass(frozen=True)
class Effect:
    """A variant against its base."""

    variant: Group
    base: Group
    difference: Estimate  # mean of the variant minus mean of the base, with Student's interval [m]
    student: SignificanceTest
    student_holm: float | None  # p corrected over all variants
    bound: float  # largest negligible difference [m]
    judgement: Judgement  # whether the difference is negligible


def effects(pairs: Sequence[tuple[Floats, Floats]]) -> tuple[Effect, ...]:
    """Compare displacements of a variant, (n_variant,), with its base's, (n_base,) [m]; NaN where there is none."""
    made = [_effect(variant, base) for variant, base in pairs]
    corrected = holm([effect.student.p for effect in made])
    return tuple(replace(effect, student_holm=p) for effect, p in zip(made, corrected, strict=True))


def _effect(variant: Floats, base: Floats) -> Effect:
    x, y = finite(variant), finite(base)
    gap, bound = difference(x, y), negligible(y)
    n = 2 / (1 / len(x) + 1 / len(y)) if min(len(x), len(y)) else 0.0
    judged = judge_equivalence(gap, bound, n=n, form=_METRES)
    return Effect(group(variant), group(base), gap, student(x, y), None, bound, judged)


def negligible(base: Floats) -> float:
    """Return the largest negligible difference from (n_base,) displacements [m]; 0 if there is none."""
    known = finite(base)
    return NEGLIGIBLE * abs(float(known.mean())) if len(known) else 0.0


def trials_to_show(base: Floats, *, n_variants: int, power: float) -> int | None:
    """Return the trials of each study that show a difference which is just not negligible; None if above 100,000.

    Args:
        base: (n_base,) displacements [m], at least two finite ones that do not average 0.
        n_variants: number of variants that Holm's correction is over.
        power: probability of showing the difference.
    """
    sd = float(np.std(finite(base), ddof=1))
    return n_trials_for(negligible(base), sd, power=power, level=(1 - LEVEL) / n_variants)
