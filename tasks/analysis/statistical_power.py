"""How many trials a difference needs: the power of the two-sided Student's t test for two groups of n trials each.

With means that differ by d and deviations of s, the statistic has a noncentral t distribution with 2 (n - 1) degrees of
freedom and noncentrality d / (s √(2 / n)).
"""

import math

import scipy

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
