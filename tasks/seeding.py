"""Random numbers of a work item, seeded from its identity and never from the order in which work items run."""

import hashlib
import json
import operator

import numpy as np
from numpy.random import Generator, SeedSequence

_encode = json.JSONEncoder(allow_nan=False).encode


def replicate_seed(seed: int, replicate: int) -> int:
    """Return the seed of one replicate's data set and networks; replicate 0 has the study's own seed."""
    return seed if replicate == 0 else int(generator(seed, "replicate", replicate).integers(2**63))


def generator(seed: int, *identity: str | int | float) -> Generator:
    """Return the generator of one work item.

    Args:
        seed: seed of the study, at least 0.
        identity: parts that distinguish the work item from all others, such as stage, depth, environment, trial,
            generation. Types matter: 1 and 1.0 are different identities.
    """
    seed = operator.index(seed)
    if seed < 0:
        raise ValueError(f"seed is {seed}, expected at least 0")
    digest = hashlib.sha256(_encode(identity).encode()).digest()
    n_words = max(1, -(-seed.bit_length() // 32))
    words = np.frombuffer(seed.to_bytes(4 * n_words, "little") + digest, dtype="<u4")
    return np.random.default_rng(SeedSequence(words))
