"""Randomness from identity: what a piece of work is decides its random numbers, never the order in which it ran."""

from __future__ import annotations

import hashlib
import json

import numpy as np
from numpy.random import Generator, SeedSequence


def generator(seed: int, *identity: str | int | float) -> Generator:
    """Make the generator of one piece of work.

    Args:
        seed: of the whole study, 0 or more.
        identity: what tells this piece of work from every other, such as stage, depth, environment, trial, generation.
            Each part keeps its type: 1 and 1.0 are different identities.
    """
    digest = hashlib.sha256(json.dumps(identity, allow_nan=False).encode()).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return np.random.default_rng(SeedSequence([seed, *words]))
