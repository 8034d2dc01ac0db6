"""Evolution's own work, compiled: from a population to its children, and from both to the survivors.

In NumPy it is some hundred calls, each of which takes longer than its work on 64 designs. Loops over numbers take the
place of whole arrays' sums and indices, which take several times as long to compile.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tasks.arrays import Float64, Int64
from tasks.compiled import inline
from tasks.design.genes import N_COLUMNS, Designs, DesignTable
from tasks.design.variation import mutate_kernel, random_kernel, recombine_kernel
from tasks.design.variation_kernels import Variation

OPERATORS = ("random", "mutation", "crossover")
"""How a design came about, in the order of their codes."""
RANDOM, MUTATION, CROSSOVER = range(3)

NOBODY = -1
"""The parent of a design that has none."""


class Population(NamedTuple):
    """The survivors of a generation; axis 0 is the design."""

    table: DesignTable
    """(n_designs, N_COLUMNS) their genes; fewer than the population's size only if too many diverged."""
    fitness: Float64
    """(n_designs,) finite [m]"""
    age: Int64
    """(n_designs,) generations since the oldest ancestor was drawn at random."""
    identity: Int64
    """(n_designs,) running number within the trial, in order of evaluation."""
    n_evaluated: int
    """Designs evaluated in the trial so far."""

    @property
    def designs(self) -> Designs:
        """The n_designs designs."""
        return Designs.from_table(self.table)

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Give the state as named arrays, the inverse of :meth:`from_arrays`."""
        return {
            **dict(self.designs.arrays()),
            "fitness": self.fitness,
            "age": self.age,
            "identity": self.identity,
            "n_evaluated": np.array([self.n_evaluated], dtype=np.int64),
        }

    @staticmethod
    def from_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> Population:
        """Restore a state from its named arrays."""
        return Population(
            table=Designs.from_arrays(arrays).table.copy(),  # kernels are compiled for one that can be written to
            fitness=arrays["fitness"],
            age=arrays["age"],
            identity=arrays["identity"],
            n_evaluated=int(arrays["n_evaluated"][0]),
        )

    def champion(self) -> int:
        """Index of the fittest; the first of several. A trial's best design never leaves the population."""
        return int(np.argmax(self.fitness))


class Children(NamedTuple):
    """Designs that wait to be evaluated; axis 0 is the child."""

    table: DesignTable
    """(n_children, N_COLUMNS) their genes, not to be changed once ``designs`` was read."""
    age: Int64
    """(n_children,) generations: that of the older parent; 0 where there is none."""
    identity: Int64
    """(n_children,) running number within the trial."""
    operator: Int64
    """(n_children,) index into OPERATORS."""
    places: Int64
    """(n_children, 2) the parents' places in the population; NOBODY where there is none."""
    parents: Int64
    """(n_children, 2) the parents' identities; NOBODY where there is none."""
    n_draws: Int64
    """(n_children,) how often its operator drew until the morphology allowed the design."""

    @property
    def designs(self) -> Designs:
        """The n_children designs."""
        return Designs.from_table(self.table)


def breed(
    n_children: int, held: Any, population: Population, random_share: float, mutation_share: float, variation: Variation
) -> Children:
    """Draw a generation of children, whatever the morphology says; all are random where nobody survived.

    Args:
        n_children: how many.
        held: ``rng`` of it is the source of randomness.
        population: who may have children.
        random_share: probability that a child is random.
        mutation_share: probability that it is a mutant; it is a recombination otherwise.
        variation: what may vary, and how.

    Returns:
        n_children children.
    """
    rng, n_parents = held.rng, len(population.age)
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
        places[child, 0], identities[child, 0] = one[child], population.identity[one[child]]
        age[child] = population.age[one[child]]
        if chance[child] < random_share + mutation_share:
            operator[child] = MUTATION
        else:
            other = (one[child] + further[child]) % n_parents  # another one, wherever there are two
            operator[child] = CROSSOVER
            places[child, 1], identities[child, 1] = other, population.identity[other]
            age[child] = max(age[child], population.age[other])

    mutants, changed = _parents(population, operator, MUTATION, places[:, 0])
    mutate_kernel(changed, rng, variation)
    for number, child in enumerate(mutants):
        _copy_genes(changed[number], table[child])
    recombined, mixed = _parents(population, operator, CROSSOVER, places[:, 0])
    _, others = _parents(population, operator, CROSSOVER, places[:, 1])
    recombine_kernel(mixed, others, rng, variation)
    for number, child in enumerate(recombined):
        _copy_genes(mixed[number], table[child])
    identity = np.arange(population.n_evaluated, population.n_evaluated + n_children)
    return Children(table, age, identity, operator, places, identities, np.ones(n_children, dtype=np.int64))


@inline
def _parents(population: Population, operator: Int64, wanted: int, place: Int64) -> tuple[Int64, DesignTable]:
    """List the children of an operator, and copy the genes of their parents at given places in the population."""
    children = np.empty(len(operator), dtype=np.int64)
    n = 0
    for child in range(len(operator)):
        if operator[child] == wanted:
            children[n] = child
            n += 1
    genes = np.empty((n, N_COLUMNS))
    for number in range(n):
        _copy_genes(population.table[place[children[number]]], genes[number])
    return children[:n], genes


@inline
def _copy_genes(one: DesignTable, to: DesignTable) -> None:
    for column in range(N_COLUMNS):
        to[column] = one[column]


def survive(population: Population, children: Children, fitness: Float64, held: Any, n_survivors: int) -> Population:
    """Select the survivors among all, who then are a generation older.

    Args:
        population: those who survived before.
        children: the designs evaluated now.
        fitness: (n_children,) theirs [m].
        held: ``rng`` of it is the source of randomness.
        n_survivors: how many are to survive.
    """
    n_parents, n_all = len(population.age), len(population.age) + len(children.age)
    all_fitness, all_age = np.empty(n_all), np.empty(n_all, dtype=np.int64)
    for parent in range(n_parents):
        all_fitness[parent], all_age[parent] = population.fitness[parent], population.age[parent]
    for child in range(len(children.age)):
        all_fitness[n_parents + child], all_age[n_parents + child] = fitness[child], children.age[child]
    survivors = _choose(all_fitness, all_age, held, n_survivors)
    n = len(survivors)
    table, of_survivors = np.empty((n, N_COLUMNS)), np.empty(n)
    age, identity = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    for place in range(n):
        design, child = survivors[place], survivors[place] - n_parents
        of_survivors[place], age[place] = all_fitness[design], all_age[design] + 1
        if child < 0:
            identity[place] = population.identity[design]
            _copy_genes(population.table[design], table[place])
        else:
            identity[place] = children.identity[child]
            _copy_genes(children.table[child], table[place])
    return Population(table, of_survivors, age, identity, population.n_evaluated + len(fitness))


def select(fitness: Float64, age: Int64, held: Any, n_survivors: int) -> Int64:
    """Choose survivors as :func:`tasks.evolution.select` does, drawing from ``held.rng``."""
    return _choose(fitness, age, held, n_survivors)


@inline
def _choose(fitness: Float64, age: Int64, held: Any, n_survivors: int) -> Int64:
    front, dominated = _front_and_dominated(fitness, age)
    n_front = min(n_survivors, len(front))
    n_more = min(n_survivors - n_front, len(dominated))
    drawn = _sample(len(dominated), n_more, held)
    survivors = np.empty(n_front + n_more, dtype=np.int64)
    for place in range(n_front):
        survivors[place] = front[place]
    for place in range(n_more):
        survivors[n_front + place] = dominated[drawn[place]]
    return survivors


@inline
def _front_and_dominated(fitness: Float64, age: Int64) -> tuple[Int64, Int64]:
    """Tell the non-dominated, by decreasing fitness, the first of equals first, from those that others beat.

    A design is beaten by one of its age or younger. One whose fitness is not finite is neither.
    """
    oldest = 0
    for design in range(len(age)):
        oldest = max(oldest, age[design])
    best = np.full(1 + oldest, -np.inf)  # of each age or younger
    for design in range(len(age)):
        if np.isfinite(fitness[design]):
            best[age[design]] = max(best[age[design]], fitness[design])
    for older in range(1, len(best)):
        best[older] = max(best[older], best[older - 1])
    front, dominated = np.empty(len(age), dtype=np.int64), np.empty(len(age), dtype=np.int64)
    n_front = n_dominated = 0
    for design in range(len(age)):
        if not np.isfinite(fitness[design]):
            continue
        if fitness[design] < best[age[design]]:
            dominated[n_dominated] = design
            n_dominated += 1
        else:
            front[n_front] = design
            n_front += 1
    for last in range(1, n_front):  # sorted by insertion, so that equals keep their order
        design, place = front[last], last
        while place > 0 and fitness[front[place - 1]] < fitness[design]:
            front[place] = front[place - 1]
            place -= 1
        front[place] = design
    return front[:n_front], dominated[:n_dominated]


@inline
def _sample(n: int, n_drawn: int, held: Any) -> Int64:
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
