"""The kernels of evolution: the bits that they gave before, with the compiler and without it."""

import copy
import hashlib
import os
import subprocess
import sys

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load as decode
from safetensors.numpy import save as encode

from tasks.design import Morphology, random_designs
from tasks.evolution import EMPTY_POPULATION, Afpo, Population, afpo, ask, select, tell
from tasks.seeding import generator

compiled_only = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="plain Python has nothing to compare with")

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
"""A study that was begun with other numbers could not be resumed or repeated: VERSION in pipeline/stages/evolve.py."""


def evolved(kind: str, n_generations: int) -> str:
    """Evolve on a landscape that costs nothing, ties and diverged designs among it; give a digest of all that was."""
    morphology = {"two": TWO, "two, body": TWO, "apart": APART}.get(kind, Morphology())
    body = random_designs(1, np.random.default_rng(3), morphology=morphology) if "body" in kind else None
    size = Afpo(population_size=64 if kind in ("plain", "body") else 12)
    population, digest = EMPTY_POPULATION, hashlib.sha256()
    for generation in range(n_generations):
        rng = generator(1, kind, generation)
        children = ask(population, rng, size, body=body, morphology=morphology)
        fitness = np.round(rng.normal(size=size.population_size) + children.designs.length_scale.sum(axis=1), 1)
        fitness[rng.random(size.population_size) < 0.05] = -np.inf
        population = tell(population, children, fitness, rng, size)
        for array in (children.age, children.operator, children.parents, children.n_draws, children.designs.table):
            digest.update(np.ascontiguousarray(array).tobytes())
        for array in population.arrays().values():
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


@pytest.mark.parametrize("kind", GOLDEN)
def test_a_trial_has_the_bits_that_it_had_before(kind: str) -> None:
    assert evolved(kind, 10 if kind == "apart" else 60) == GOLDEN[kind]


@compiled_only
def test_plain_python_has_the_same_bits() -> None:
    kinds = [kind for kind in GOLDEN if kind != "apart"]  # which takes 10,000 draws
    script = f"""
import runpy
evolved = runpy.run_path({__file__!r})["evolved"]
print(*(evolved(kind, 4) for kind in {kinds}))
"""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == [evolved(kind, 4) for kind in kinds], done.stderr


@given(st.integers(0, 200), st.integers(0, 200), st.integers(0, 2**32))
def test_a_sample_is_numpys_choice(n: int, n_drawn: int, seed: int) -> None:
    ours, theirs = np.random.default_rng(seed), np.random.default_rng(seed)
    age, fitness = np.zeros(n + 1, np.int64), np.append(np.zeros(n), 1.0)  # the last beats all others
    chosen = select(fitness, age, ours, n_drawn + 1).tolist()
    assert chosen == [n, *theirs.choice(np.arange(n), min(n, n_drawn), replace=False)]
    assert ours.random() == theirs.random()


numbers = st.one_of(st.integers(-3, 3).map(float), st.sampled_from([np.nan, np.inf, -np.inf]))


@given(st.lists(st.tuples(numbers, st.integers(0, 3)), max_size=12))
def test_the_front_is_what_nobody_as_young_beats(designs: list[tuple[float, int]]) -> None:
    fitness, age = np.array([one[0] for one in designs], float), np.array([one[1] for one in designs], np.int64)
    survivors = select(fitness, age, np.random.default_rng(len(designs)), len(designs)).tolist()
    finite = [index for index in range(len(designs)) if np.isfinite(fitness[index])]
    beaten = {one for one in finite if any(age[by] <= age[one] and fitness[by] > fitness[one] for by in finite)}
    front = sorted(set(finite) - beaten, key=lambda index: (-fitness[index], index))
    assert survivors[: len(front)] == front
    assert sorted(survivors[len(front) :]) == sorted(beaten)


@compiled_only
def test_a_kernel_is_compiled_once_wherever_its_arrays_come_from() -> None:
    """A second time would take as long as the first, without a word."""
    for body in None, random_designs(3, np.random.default_rng(4))[[1]]:
        population, rng, small = EMPTY_POPULATION, np.random.default_rng(5), Afpo(population_size=6)
        for _ in range(2):
            restored = Population.from_arrays(decode(encode(population.arrays())))
            for came in population, restored, copy.deepcopy(population):
                children = ask(came, rng, small, body=body)
                population = tell(came, children, np.arange(6.0), rng, small)
    assert len(afpo._breed.signatures) == len(afpo._survive.signatures) == 1
