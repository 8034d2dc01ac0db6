"""Shared by the tests of variation: mutations, canonical designs, and bounds on counts."""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st
from scipy import stats

from tasks.design import GENES, Designs, Mutation

seeds = st.integers(0, 2**63 - 1)
mutations = st.builds(Mutation, genes_changed=st.floats(0, 37), step=st.floats(1e-3, 1.0), rewiring=st.floats(0, 1))

BODY = ("parent", *(gene.name for gene in GENES if gene.part == "body"))
NO_REWIRING = Mutation(rewiring=0.0)


def canonical(designs: Designs) -> Designs:
    """Zero the ignored genes of roots, so that designs that behave alike are equal."""
    cleared = {gene.name: getattr(designs, gene.name).copy() for gene in GENES if not gene.of_root}
    for array in cleared.values():
        array[:, 0] = 0
    return replace(designs, **cleared)


def is_canonical(designs: Designs) -> bool:
    return canonical(designs) == designs


def numbers(designs: Designs) -> np.ndarray:
    """The 37 numbers of each design."""
    blocks = [getattr(designs, gene.name) for gene in GENES]
    blocks = [
        block[:, int(not gene.of_root) :] if gene.per_link else block[:, None]
        for gene, block in zip(GENES, blocks, strict=True)
    ]
    return np.concatenate(blocks, axis=1).astype(np.float64)


def binomial_interval(n: int, p: float) -> tuple[float, float]:
    """Return the interval that a count of n draws of probability p leaves once in a million."""
    low, high = stats.binom.interval(1 - 1e-6, n, p)
    return float(low), float(high)
