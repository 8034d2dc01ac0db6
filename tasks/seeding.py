"""Randomness from identity: what a piece of work is decides its random numbers, never the order in which it ran."""

from __future__ import annotations

import hashlib
import json
import operator

import numpy as np
from numpy.random import Generator, SeedSequence

_encode = json.JSONEncoder(allow_nan=False).encode


def generator(seed: int, *identity: str | int | float) -> Generator:
    """Make the generator of one piece of work.

    Args:
        seed: of the whole study, 0 or more.
        identity: what tells this piece of work from every other, such as stage, depth, environment, trial, generation.
            Each part keeps its type: 1 and 1.0 are different identities.

    Raises:
        ValueError: the seed is negative.
    """
    seed = operator.index(seed)
    if seed < 0:
        raise ValueError(f"seed is {seed}, expected 0 or more")
    digest = hashlib.sha256(_encode(identity).encode()).digest()
    n_words = max(1, -(-seed.bit_length() // 32))
    words = np.frombuffer(seed.to_bytes(4 * n_words, "little") + digest, dtype="<u4")
    return np.random.default_rng(SeedSequence(words))
