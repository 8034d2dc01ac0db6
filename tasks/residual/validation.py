"""Which throws networks learn from, and on which they are validated."""

import numpy as np

from tasks.arrays import Bools, Int64
from tasks.seeding import generator


def split_throws(throw: Int64, held_out: float, *, seed: int) -> tuple[Bools, Bools]:
    """Return masks of the transitions to learn from and of those to validate on, the same for all members.

    Whole throws are held out at random, because the steps of one resemble each other: at least one throw, and not all.
    If the share is 0, networks learn from every throw, as in the paper, and are validated on the same throws.

    Args:
        throw: (n_transitions,) throw of each transition.
        held_out: share of the throws to hold out.
        seed: the study's seed.

    Raises:
        ValueError: there are fewer than two throws, and some are to be held out.
    """
    if held_out == 0:
        every = np.ones(len(throw), dtype=bool)
        return every, every
    throws = np.unique(throw)
    if len(throws) < 2:
        raise ValueError(f"transitions of {len(throws)} throws, expected at least 2: one to train on, one held out")
    n_held_out = min(max(round(held_out * len(throws)), 1), len(throws) - 1)
    validated = np.isin(throw, generator(seed, "held out").permutation(throws)[:n_held_out])
    return ~validated, validated
