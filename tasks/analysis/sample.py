"""Which designs prediction accuracy is judged by. Paper, "Prediction Accuracy".

The paper draws 2,376 designs uniformly over the generations of runs in True Slush and on Dry Land: early ones that
hardly move and late ones that go far, so that a predictor has something to tell apart.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.arrays import Int64


def spread_evenly(n_designs: int, n_trials: int) -> list[int]:
    """Share out designs over trials so that no two shares differ by more than one."""
    return [n_designs * (i + 1) // n_trials - n_designs * i // n_trials for i in range(n_trials)]


def draw_over_generations(generation: npt.ArrayLike, n_designs: int, rng: Generator) -> Int64:
    """Draw designs of one trial without repeats, every generation as likely as every other.

    Args:
        generation: (n_evaluated,) in which each design of the trial was evaluated.
        n_designs: how many to draw; all there are, if there are fewer.
        rng: source of randomness.

    Returns:
        (n_drawn,) their indices, in ascending order.
    """
    _, which, n_in = np.unique(np.asarray(generation), return_inverse=True, return_counts=True)
    share = 1 / n_in[which]
    n_drawn = min(n_designs, len(which))
    return np.sort(rng.choice(len(which), size=n_drawn, replace=False, p=share / share.sum()))
