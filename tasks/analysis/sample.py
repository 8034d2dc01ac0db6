"""The sample of designs that predictions are assessed with.

The paper draws 2,376 designs uniformly over the generations of trials in True Slush and on Dry Land, so that the sample
contains early designs that hardly move and late ones that go far.
"""

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.arrays import Int64


def spread_evenly(n_designs: int, n_trials: int) -> list[int]:
    """Split a number of designs over trials into parts that differ by at most one."""
    return [n_designs * (i + 1) // n_trials - n_designs * i // n_trials for i in range(n_trials)]


def draw_over_generations(generation: npt.ArrayLike, n_designs: int, rng: Generator) -> Int64:
    """Return indices of designs drawn without replacement from a trial, each generation with equal probability.

    ``generation`` is that of each of the trial's designs; all are drawn if there are fewer than n_designs.
    """
    _, which, n_in = np.unique(np.asarray(generation), return_inverse=True, return_counts=True)
    share = 1 / n_in[which]
    n_drawn = min(n_designs, len(which))
    return np.sort(rng.choice(len(which), size=n_drawn, replace=False, p=share / share.sum()))
