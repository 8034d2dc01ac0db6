"""How much of the variance over trials lies between replicates, that is between throws and training, and within."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import scipy

from tasks.analysis.replicates import NestedSample, components
from tasks.analysis.scores import QUANTITY_WORDS, EvolvedIn, Quantity, Scores
from tasks.analysis.uncertainty import LEVEL, RESOLUTION, Estimate, is_constant
from tasks.world import ENVIRONMENTS


@dataclass(frozen=True)
class VarianceRow:
    """The variance of one quantity of one arm. Missing figures are None."""

    evolved_in: EvolvedIn
    depth: float  # [m]
    quantity: Quantity
    n: int  # trials with a finite value
    n_replicates: int
    between: float | None  # variance between replicates: throws and training together [m²]
    within: float | None  # variance within replicates: evolution; of single members, their training too [m²]
    sd_between: float | None  # [m]
    sd_within: float | None  # [m]
    share_between: Estimate  # between / (between + within)


def variances(scores: Scores) -> tuple[VarianceRow, ...]:
    """Split the variance of every quantity that has two or more values, by arm and depth."""
    return tuple(_rows(scores))


def _rows(scores: Scores) -> Iterator[VarianceRow]:
    for evolved_in in ENVIRONMENTS:
        for depth in scores.depths():
            for quantity in QUANTITY_WORDS:
                sample = scores.sample(evolved_in, quantity, depth)
                if len(sample.values) > 1:
                    yield _row(sample, evolved_in, quantity, depth)


def _row(sample: NestedSample, evolved_in: EvolvedIn, quantity: Quantity, depth: float) -> VarianceRow:
    found, n = components(sample), len(sample.values)
    between, within = (None if math.isnan(variance) else variance for variance in (found.between, found.within))
    sd_between, sd_within = (None if variance is None else math.sqrt(variance) for variance in (between, within))
    share = _share_between(sample)
    return VarianceRow(
        evolved_in, depth, quantity, n, found.n_replicates, between, within, sd_between, sd_within, share
    )


def _share_between(sample: NestedSample) -> Estimate:
    """Estimate the intraclass correlation, with the interval of the F test.

    Shrout & Fleiss 1979, Psychological Bulletin 86: exact in balanced groups of normal values.
    """
    found, n = components(sample), len(sample.values)
    if found.n_replicates == 1:
        return Estimate.missing("1 replicate, expected 2 or more")
    if found.n_replicates == n:
        return Estimate.missing("every replicate has a single trial, expected several")
    if is_constant(sample.values, resolution=RESOLUTION):
        return Estimate.missing("the values have no spread")
    freedom = found.n_replicates - 1, n - found.n_replicates
    tails = (scipy.stats.f.ppf(tail, *freedom) for tail in ((1 + LEVEL) / 2, (1 - LEVEL) / 2))
    low, high = (_intraclass(found.f / tail, found.n_per_replicate) for tail in tails)
    return Estimate(found.between / (found.between + found.within), low, high)


def _intraclass(f: float, n: float) -> float:
    """Return the share of variance that a ratio of mean squares stands for, with n trials in each replicate."""
    return 1.0 if math.isinf(f) else max(0.0, (f - 1) / (f - 1 + n))
