"""Differences between two studies: each arm of one against the same arm of the other, at every common depth.

The settings of two studies differ, and with them the variances of their champions, so the intervals and p-values are
Welch's. Where a study has several replicates, they include the variance between these
(:mod:`tasks.analysis.replicates`), and numbers of trials that would tell are of as many more replicates. Holm's
correction has all tests of the comparison as its family. A difference is negligible within ``NEGLIGIBLE`` times the
displacement of the designs that evolved in True Slush in the reference, study B.

Trials of two studies count as independent. If they share their seed, they may be alike, which makes the tests cautious.
Trials that no setting tells apart are the very same, with the same values to the last bit. Where that is so of a whole
group, there is no test, because it would compare results with themselves.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from tasks.analysis.comparison import Group, SignificanceTest, clustered, group, hedges_g, holm, nested_difference
from tasks.analysis.equivalence import Judgement, judge_equivalence
from tasks.analysis.paper import NEGLIGIBLE
from tasks.analysis.scores import BEST, QUANTITY_WORDS, EvolvedIn, Quantity, ScoredArm, Scores
from tasks.analysis.uncertainty import RESOLUTION, Estimate, finite
from tasks.world import ENVIRONMENTS

_METRES = "{:z.2f} m"
_AT_HOME: ScoredArm = (BEST[0], "predicted")  # the same rollout as zero-shot, which would be tested twice


@dataclass(frozen=True)
class StudyDifference:
    """One quantity of one arm in study A against the same in study B."""

    evolved_in: EvolvedIn
    depth: float  # [m]
    quantity: Quantity
    a: Group
    b: Group
    difference: Estimate  # mean of A minus mean of B, with the clustered test's interval [m]
    hedges_g: Estimate
    clustered: SignificanceTest  # Welch's if both studies have one replicate
    clustered_holm: float | None  # p corrected over all tests of the comparison
    bound: float  # largest negligible difference [m]
    judgement: Judgement  # whether the difference is negligible


def compare_studies(a: Scores, b: Scores) -> tuple[StudyDifference, ...]:
    """Compare every quantity that both studies have, by arm and depth, the greatest depth first.

    Args:
        a: champions of study A.
        b: champions of study B, the reference.
    """
    made = tuple(_differences(a, b))
    corrected = holm([row.clustered.p for row in made])
    return tuple(replace(row, clustered_holm=p) for row, p in zip(made, corrected, strict=True))


def _differences(a: Scores, b: Scores) -> Iterator[StudyDifference]:
    for depth in sorted(set(a.depths()) & set(b.depths()), reverse=True):
        for evolved_in in ENVIRONMENTS:
            for quantity in QUANTITY_WORDS:
                if (evolved_in, quantity) == _AT_HOME:
                    continue
                if all(len(finite(scores.values(evolved_in, quantity, depth))) for scores in (a, b)):
                    yield _difference(a, b, evolved_in, quantity, depth)


def _difference(a: Scores, b: Scores, evolved_in: EvolvedIn, quantity: Quantity, depth: float) -> StudyDifference:
    samples = [scores.sample(evolved_in, quantity, depth) for scores in (a, b)]
    x, y = (sample.values for sample in samples)
    gap, g, test = nested_difference(*samples, equal_variances=False), hedges_g(x, y), clustered(*samples)
    if _n_same(a, b, evolved_in, quantity, depth) == (n_least := min(len(x), len(y))):
        reason = f"{n_least} of the trials are the same in both studies, to the last bit"
        gap, g = Estimate(gap.value, reason=reason), Estimate.missing(reason)
        test = SignificanceTest(None, None, reason)
    best = finite(b.values(*BEST, depth))
    bound = NEGLIGIBLE * abs(float((best if len(best) else y).mean()))
    n = 2 / (1 / len(x) + 1 / len(y))
    judged = judge_equivalence(gap, bound, n=n, form=_METRES)
    of_a, of_b = (
        group(scores.values(evolved_in, quantity, depth), scores.replicate[scores.rows(evolved_in, depth)])
        for scores in (a, b)
    )
    return StudyDifference(evolved_in, depth, quantity, of_a, of_b, gap, g, test, None, bound, judged)


def _n_same(a: Scores, b: Scores, evolved_in: EvolvedIn, quantity: Quantity, depth: float) -> int:
    """Count the trials with exactly the same value in both studies; robots that do not move at all are not counted."""
    of_a, of_b = (
        dict(zip(scores.trial[scores.rows(evolved_in, depth)], scores.values(evolved_in, quantity, depth), strict=True))
        for scores in (a, b)
    )
    return sum(of_b.get(trial) == value and abs(value) > RESOLUTION for trial, value in of_a.items())
