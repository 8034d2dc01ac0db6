"""Trials give the bits that they gave before, with the compiler and without it."""

import hashlib
import os
import subprocess
import sys

import numba
import numpy as np
import pytest

from tasks.design import Morphology, random_designs
from tasks.evolution import EMPTY_POPULATION, Afpo, Evaluation
from tasks.seeding import generator

TWO = Morphology(n_actuated=2)
APART = Morphology(n_actuated=2, unjoined_links="apart")

GOLDEN = {
    "plain": "2bfba7b398f36229",
    "small": "da2f6d5ccd2dd935",
    "body": "4a28b68e44c97a02",
    "two": "c46da44548bb32a3",
    "two, body": "763bc5d878e85b86",
    "apart": "54b817f4247716a9",
}
"""A study begun with other bits can't be resumed or repeated. If these change, so does the version of EVOLVE
in stages/evolve.py."""


def evolved(kind: str, n_generations: int) -> str:
    """Evolve on a cheap landscape with ties and diverged designs; return a digest of every array on the way."""
    morphology = {"two": TWO, "two, body": TWO, "apart": APART}.get(kind, Morphology())
    body = random_designs(1, np.random.default_rng(3), morphology=morphology) if "body" in kind else None
    afpo = Afpo(population_size=64 if kind in ("plain", "body") else 12)
    population, digest = EMPTY_POPULATION, hashlib.sha256()
    for generation in range(n_generations):
        rng = generator(1, kind, generation)
        children = afpo.ask(population, rng, body=body, morphology=morphology)
        fitness = np.round(rng.normal(size=afpo.population_size) + children.designs.length_scale.sum(axis=1), 1)
        fitness[rng.random(afpo.population_size) < 0.05] = -np.inf
        population = afpo.tell(population, children, Evaluation(fitness, *[fitness[:, None]] * 3), rng)
        told = children.extra["age"], children.operator, children.parents, children.n_draws, children.designs.table
        for array in (*told, *population.arrays().values()):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


@pytest.mark.parametrize("kind", GOLDEN)
def test_a_trial_has_the_bits_that_it_had_before(kind: str) -> None:
    assert evolved(kind, 10 if kind == "apart" else 60) == GOLDEN[kind]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="plain Python has nothing to compare with")
def test_plain_python_has_the_same_bits() -> None:
    kinds = [kind for kind in GOLDEN if kind != "apart"]  # which takes 10,000 draws
    script = f"import runpy; f = runpy.run_path({__file__!r})['evolved']; print(*(f(kind, 4) for kind in {kinds}))"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == [evolved(kind, 4) for kind in kinds], done.stderr
