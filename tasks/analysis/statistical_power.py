"""How many trials a difference needs: the power of the two-sided Student's t test for two groups of n trials each.

With means that differ by d and deviations of s, the statistic has a noncentral t distribution with 2 (n - 1) degrees of
freedom and noncentrality d / (s √(2 / n)).

Where trials share throws and networks, the mean of n trials has the error of :mod:`tasks.analysis.replicates`, with ν
degrees of freedom. It is that of ν + 1 independent values, each worth n / (ν + 1) trials: in a balanced group whose
replicates differ, of the replicates' means. The test then is Student's for such values, and more trials are those of
more replicates of the same size.
"""

import math

import scipy

from tasks.analysis.replicates import NestedSample, components

_MOST_TRIALS = 100_000


def power_of(difference: float, sd: float, n: int, *, level: float = 0.05) -> float:
    """Return the probability that a t test of two groups shows a difference.

    Args:
        difference: difference of the groups' true means.
        sd: standard deviation within both groups, in the same unit.
        n: trials of each group, at least 2.
        level: p-value below which a difference counts as shown.
    """
    freedom = 2 * (n - 1)
    threshold = scipy.stats.t.ppf(1 - level / 2, freedom)
    noncentrality = abs(difference) / (sd * math.sqrt(2 / n))
    shown = scipy.stats.nct.sf(threshold, freedom, noncentrality)
    wrong_way = scipy.stats.nct.cdf(-threshold, freedom, noncentrality)
    return float(shown + wrong_way)


def n_trials_for(difference: float, sd: float, *, power: float = 0.8, level: float = 0.05) -> int | None:
    """Return the smallest number of trials of each group that shows a difference with some probability.

    Args:
        difference: difference of the groups' true means, not 0.
        sd: standard deviation within both groups, in the same unit.
        power: probability of showing the difference.
        level: p-value below which a difference counts as shown.

    Returns:
        At least 2; None above 100,000.

    Raises:
        ValueError: the difference is 0, or the power or the level is not between 0 and 1.
    """
    if difference == 0 or not 0 < power < 1 or not 0 < level < 1:
        raise ValueError(
            f"expected a difference other than 0, and power and level between 0 and 1, got {difference:g}, {power:g}, "
            f"{level:g}"
        )
    if sd == 0:
        return 2
    low, high = 1, 2  # power grows with n: the smallest sufficient n lies in (low, high]
    while power_of(difference, sd, high, level=level) < power:
        low, high = high, 2 * high
        if high > 2 * _MOST_TRIALS:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power_of(difference, sd, middle, level=level) >= power else (middle, high)
    return high if high <= _MOST_TRIALS else None


def effective_deviation(sample: NestedSample) -> float:
    """Return the deviation of independent values whose mean has the error of that of two or more nested trials."""
    return math.sqrt(components(sample).error.variance * len(sample.values))


def n_nested_trials_for(difference: float, sample: NestedSample, *, power: float = 0.8) -> int | None:
    """Return the smallest number of trials of each group that shows a difference, in replicates like a sample's.

    Args:
        difference: difference of the groups' true means, not 0.
        sample: two or more trials, whose errors both groups have.
        power: probability of showing the difference, at p < 0.05.

    Returns:
        At least 2, and with one replicate that of :func:`n_trials_for`; None above 100,000.
    """
    trials_per_value = len(sample.values) / (components(sample).error.freedom + 1)
    n_values = n_trials_for(difference, effective_deviation(sample) / math.sqrt(trials_per_value), power=power)
    n = None if n_values is None else math.ceil(round(n_values * trials_per_value, 6))  # 6 digits: rounding errors
    return n if n is not None and n <= _MOST_TRIALS else None
