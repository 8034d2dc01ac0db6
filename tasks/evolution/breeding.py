"""Evolution's own work, compiled: a generation's children, and who of all is dominated.

In NumPy it is some hundred calls, each of which takes longer than its work on 64 designs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tasks.compiled import inline
from tasks.design.genes import Table
from tasks.design.operators import Variation
from tasks.design.variation import mutate_kernel, random_kernel, recombine_kernel

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]

OPERATORS = ("random", "mutation", "crossover")
"""How a design came about, in the order of their codes."""
RANDOM, MUTATION, CROSSOVER = range(3)

NOBODY = -1
"""The parent of a design that has none."""


class Parents(NamedTuple):
    """Who may have children; axis 0 is the design."""

    table: Table
    """(n_designs, N_COLUMNS)"""
    age: Ints
    """(n_designs,) generations."""
    identity: Ints
    """(n_designs,) running number within the trial."""


class Offspring(NamedTuple):
    """Children as they are drawn, whatever the morphology says; axis 0 is the child."""

    table: Table
    """(n_children, N_COLUMNS)"""
    age: Ints
    """(n_children,) generations: that of the older parent; 0 where there is none."""
    operator: Ints
    """(n_children,) index into OPERATORS."""
    places: Ints
    """(n_children, 2) the parents' places among those who may have children; NOBODY where there is none."""
    parents: Ints
    """(n_children, 2) the parents' identities; NOBODY where there is none."""


def breed(
    n_children: int, held: Any, parents: Parents, random_share: float, mutation_share: float, variation: Variation
) -> Offspring:
    """Draw a generation of children, all of them random where there are no parents.

    Args:
        n_children: how many.
        held: ``rng`` of it is the source of randomness.
        parents: who may have children.
        random_share: probability that a child is random.
        mutation_share: probability that it is a mutant; it is a recombination otherwise.
        variation: what may vary, and how.

    Returns:
        n_children children.
    """
    rng, n_parents = held.rng, len(parents.age)
    chance = rng.random(n_children)
    table = random_kernel(n_children, rng, variation)
    one = rng.integers(0, max(n_parents, 1), n_children)
    further = rng.integers(1, max(n_parents, 2), n_children)
    age = np.zeros(n_children, dtype=np.int64)
    operator = np.full(n_children, RANDOM)
    places, identities = np.full((n_children, 2), NOBODY), np.full((n_children, 2), NOBODY)
    for child in range(n_children):
        if n_parents == 0 or chance[child] < random_share:
            continue
        places[child, 0], identities[child, 0] = one[child], parents.identity[one[child]]
        age[child] = parents.age[one[child]]
        if chance[child] < random_share + mutation_share:
            operator[child] = MUTATION
        else:
            other = (one[child] + further[child]) % n_parents  # another one, wherever there are two
            operator[child] = CROSSOVER
            places[child, 1], identities[child, 1] = other, parents.identity[other]
            age[child] = max(age[child], parents.age[other])

    mutants = np.flatnonzero(operator == MUTATION)
    changed = parents.table[places[mutants, 0]]
    mutate_kernel(changed, rng, variation)
    table[mutants] = changed
    recombined = np.flatnonzero(operator == CROSSOVER)
    mixed = parents.table[places[recombined, 0]]
    recombine_kernel(mixed, parents.table[places[recombined, 1]], rng, variation)
    table[recombined] = mixed
    return Offspring(table, age, operator, places, identities)


def select(fitness: Floats, age: Ints, held: Any, n_survivors: int) -> Ints:
    """Choose survivors as :func:`tasks.evolution.select` does, drawing from ``held.rng``."""
    front, dominated = _front_and_dominated(fitness, age)
    n_more = max(0, min(n_survivors - len(front), len(dominated)))
    return np.concatenate((front[:n_survivors], dominated[_sample(len(dominated), n_more, held)]))


@inline
def _front_and_dominated(fitness: Floats, age: Ints) -> tuple[Ints, Ints]:
    """Tell the non-dominated, by decreasing fitness, the first of equals first, from those that others beat.

    A design is beaten by one of its age or younger. One whose fitness is not finite is neither.
    """
    is_beaten = np.zeros(len(fitness), dtype=np.bool_)
    best, first = -np.inf, 0
    by_age = np.argsort(age, kind="mergesort")
    while first < len(by_age):
        end = first
        while end < len(by_age) and age[by_age[end]] == age[by_age[first]]:
            if np.isfinite(fitness[by_age[end]]):
                best = max(best, fitness[by_age[end]])
            end += 1
        for place in range(first, end):
            is_beaten[by_age[place]] = fitness[by_age[place]] < best
        first = end
    can_survive = np.isfinite(fitness)
    front = np.flatnonzero(can_survive & ~is_beaten)
    by_fitness = np.argsort(-fitness[front], kind="mergesort")
    return front[by_fitness], np.flatnonzero(can_survive & is_beaten)


@inline
def _sample(n: int, n_drawn: int, held: Any) -> Ints:
    """Draw some of the numbers below n, in random order, as NumPy's ``choice`` without replacement does.

    Floyd's algorithm, then Fisher and Yates' shuffle.
    """
    drawn, is_drawn = np.empty(n_drawn, dtype=np.int64), np.zeros(n, dtype=np.bool_)
    for place in range(n_drawn):
        last = n - n_drawn + place
        number = held.rng.integers(0, last + 1)
        if is_drawn[number]:
            number = last
        drawn[place], is_drawn[number] = number, True
    for place in range(n_drawn - 1, 0, -1):
        other = held.rng.integers(0, place + 1)
        drawn[place], drawn[other] = drawn[other], drawn[place]
    return drawn
