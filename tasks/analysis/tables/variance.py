"""How much of the variance over trials lies between replicates, that is between throws and training, and within."""

import math
from dataclasses import dataclass

import scipy

from tasks.analysis.estimates import LEVEL, MISSING, RESOLUTION, Estimate, Sample, components, is_constant
from tasks.analysis.registry import OfArm, StudyData, analysis, column, percent
from tasks.analysis.scores import QUANTITIES, arms, sample


@dataclass(frozen=True)
class VarianceRow(OfArm):
    """The standard deviation of one quantity of one arm, split; None where replicates can't tell its parts apart."""

    quantity: str = column("quantity", form=lambda name: QUANTITIES[name])
    n: int = column("n", form="{}", meaning="Trials.")
    n_replicates: int = column("replicates", form="{}")
    sd_between: float | None = column("between", "m", meaning="Deviation between replicates: throws and training.")
    sd_within: float | None = column("within", "m", meaning="Within: evolution; of single members, training too.")
    share_between: Estimate = column("share between", form=percent, meaning="Of the variance (F test).")


@analysis(
    "variance",
    row=VarianceRow,
    reads=("transfer",),
    answers="How much of the spread over trials is due to throws and training?",
    section="transfer",
    shown=lambda row: row.n_replicates > 1,
)
def variance(study: StudyData) -> list[VarianceRow]:
    """Split the variance of every quantity that has two or more values, by arm and depth."""
    rows = []
    for environment, depth in arms(study.trials):
        for quantity in QUANTITIES:
            own = sample(study.trials, (environment, quantity), depth)
            if len(own) > 1:
                found = components(own)
                between, within = (None if math.isnan(v) else math.sqrt(v) for v in (found.between, found.within))
                who = environment, depth, quantity, len(own), own.n_replicates
                rows.append(VarianceRow(*who, between, within, share_between(own)))
    return rows


def share_between(own: Sample) -> Estimate:
    """Estimate the intraclass correlation, with the interval of the F test.

    Shrout & Fleiss 1979, Psychological Bulletin 86: exact in balanced groups of normal values.
    """
    found, n, n_replicates = components(own), len(own), own.n_replicates
    if n_replicates in (1, n) or is_constant(own.values, resolution=RESOLUTION):
        return MISSING
    freedom = n_replicates - 1, n - n_replicates
    tails = (scipy.stats.f.ppf(tail, *freedom) for tail in ((1 + LEVEL) / 2, (1 - LEVEL) / 2))
    low, high = (_intraclass(found.f / tail, found.n_per_replicate) for tail in tails)
    return Estimate(found.between / (found.between + found.within), low, high)


def _intraclass(f: float, n: float) -> float:
    """Return the share of variance that a ratio of mean squares stands for, with n trials in each replicate."""
    return 1.0 if math.isinf(f) else max(0.0, (f - 1) / (f - 1 + n))
