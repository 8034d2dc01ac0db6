"""Age-fitness Pareto optimisation (AFPO) by ask and tell. Schmidt and Lipson (2011); paper, "Evolutionary Design".

A generation asks for children, has them evaluated elsewhere, and tells their fitness:

- Children: a share are new random designs of age 0; the others are mutants, of their parent's age, or recombinations of
  two designs, of the older parent's age.
- Selection: parents and children compete. A design is dominated if another of its age or younger is fitter. The Pareto
  front, all designs that are not dominated, survives; a uniform sample of the others fills the population.
- Ageing: each survivor grows older by one generation.

New designs compete with the young alone, which keeps lines of descent apart until they have had time to improve.

The population is a plain value and all randomness comes from the generator that is passed in, so a trial can stop after
any generation and resume.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from numpy.random import Generator
from pydantic import Field, model_validator

from tasks.arrays import Float64, Int64
from tasks.design import ANY_BODY, Designs, Morphology, Mutation
from tasks.design.genes import N_COLUMNS, DesignTable, GenePart
from tasks.design.variation import Sampler, mutate_kernel, random_kernel, recombine_kernel, variation_of
from tasks.parameters import Parameters, later_choice

OPERATORS = ("random", "mutation", "crossover")  # operators that make a child, in the order of their codes
RANDOM, MUTATION, CROSSOVER = range(3)

NO_PARENT = -1  # index and identity of a parent that a child does not have


class Afpo(Parameters):
    """The algorithm's parameters; the paper's by default."""

    population_size: int = Field(default=64, ge=2, le=1_000_000)
    """Designs that survive a generation, and children that each generation adds. [P]"""
    random_share: float = Field(default=0.15, ge=0.0, le=1.0)
    """Share of children that are new random designs. [P]"""
    mutation_share: float = Field(default=0.65, ge=0.0, le=1.0)
    """Share of children that are mutated copies. [P]"""
    crossover_share: float = Field(default=0.20, ge=0.0, le=1.0)
    """Share of children that are recombinations of two designs. [P]"""
    mutation: Mutation = Mutation()
    """How mutants depart from their parents."""
    parent_selection: Literal["uniform", "tournament"] = later_choice("uniform")
    """How the parent of a mutant and the first parent of a crossover are chosen: uniformly, or as the fitter of two
    survivors. The paper does not say; uniformly, as in age-fitness Pareto optimisation's own paper."""

    @model_validator(mode="after")
    def _shares_add_up(self) -> Self:
        total = sum(self.shares)
        if abs(total - 1.0) > 1e-9:
            raise ValueError(f"random_share + mutation_share + crossover_share is {total:g}, expected 1")
        return self

    @property
    def shares(self) -> tuple[float, float, float]:
        """Shares in the order of OPERATORS."""
        return self.random_share, self.mutation_share, self.crossover_share


class Population(NamedTuple):
    """The survivors of a generation; axis 0 is the design."""

    table: DesignTable  # genes; n_designs is below the population's size only if too many designs diverged
    fitness: Float64  # (n_designs,) [m], finite
    age: Int64  # (n_designs,) generations since the oldest ancestor was drawn at random
    identity: Int64  # (n_designs,) running number within the trial, in order of evaluation
    n_evaluated: int  # designs evaluated in the trial so far

    @property
    def designs(self) -> Designs:
        """The n_designs designs."""
        return Designs.from_table(self.table)

    def champion(self) -> int:
        """Return the index of the fittest design, the first among equals."""
        return int(np.argmax(self.fitness))

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the state as named arrays; the inverse of :meth:`from_arrays`."""
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
            table=Designs.from_arrays(arrays).table,
            fitness=arrays["fitness"],
            age=arrays["age"],
            identity=arrays["identity"],
            n_evaluated=int(arrays["n_evaluated"][0]),
        )


_NONE = np.zeros(0, dtype=np.int64)
EMPTY_POPULATION = Population(np.zeros((0, N_COLUMNS)), np.zeros(0), age=_NONE, identity=_NONE, n_evaluated=0)
"""The population before the first generation."""


class Children(NamedTuple):
    """Designs that wait to be evaluated; axis 0 is the child."""

    table: DesignTable  # genes (n_children, N_COLUMNS)
    age: Int64  # (n_children,) generations: the older parent's age, 0 without parents
    identity: Int64  # (n_children,) running number within the trial
    operator: Int64  # (n_children,) index into OPERATORS
    parents: Int64  # (n_children, 2) identities of the parents, or NO_PARENT
    n_draws: Int64  # (n_children,) draws of the operator until the morphology allowed the design

    @property
    def designs(self) -> Designs:
        """The n_children designs."""
        return Designs.from_table(self.table)


def ask(
    population: Population,
    rng: Generator,
    afpo: Afpo,
    *,
    body: Designs | None = None,
    morphology: Morphology = ANY_BODY,
) -> Children:
    """Return a generation of children, all of them random if the population is empty.

    Each child draws its operator independently, so the shares hold on average.

    Args:
        population: the survivors so far.
        rng: source of randomness.
        afpo: the algorithm's parameters.
        body: one design whose body all children get; only controllers evolve then.
        morphology: constraints on designs.
    """
    n_children, n_parents = afpo.population_size, len(population.age)
    parts: tuple[GenePart, ...] = ("body", "control") if body is None else ("control",)
    variation = variation_of(morphology, mutation=afpo.mutation, parts=parts, body=body)

    # Every child draws a random design and two parents, whether its operator needs them or not.
    chance = rng.random(n_children)
    table = random_kernel(n_children, rng, variation)
    first = rng.integers(0, max(n_parents, 1), n_children)
    if afpo.parent_selection == "tournament" and n_parents:
        rival = rng.integers(0, n_parents, n_children)
        first = np.where(population.fitness[rival] > population.fitness[first], rival, first)
    second = (first + rng.integers(1, max(n_parents, 2), n_children)) % max(n_parents, 1)  # never first, if it can be
    operator = np.digitize(chance, np.cumsum(afpo.shares[:2])) if n_parents else np.full(n_children, RANDOM)
    mutants, crosses = operator == MUTATION, operator == CROSSOVER

    # Mutants and recombinations replace the random designs.
    mutated = population.table[first[mutants]]
    mutate_kernel(mutated, rng, variation)
    table[mutants] = mutated
    crossed, others = population.table[first[crosses]], population.table[second[crosses]]
    recombine_kernel(crossed, others, rng, variation)
    table[crosses] = crossed

    parent = np.stack((np.where(mutants | crosses, first, NO_PARENT), np.where(crosses, second, NO_PARENT)), axis=1)
    children = Children(
        table=table,
        age=np.append(population.age, 0)[parent].max(axis=1),  # NO_PARENT is the index of what is appended
        identity=np.arange(population.n_evaluated, population.n_evaluated + n_children),
        operator=operator,
        parents=np.append(population.identity, NO_PARENT)[parent],
        n_draws=np.ones(n_children, dtype=np.int64),
    )
    constraints = morphology if body is None else morphology.of_controllers()
    if constraints.rejects:
        _resample_rejected(children, population.table, parent, Sampler(rng, variation, constraints))
    return children


def _resample_rejected(children: Children, parents: DesignTable, parent: Int64, sampler: Sampler) -> None:
    """Replace, in place, children that are not allowed by further draws of the same operator from the same parents."""
    for code in range(len(OPERATORS)):
        chosen = np.flatnonzero(children.operator == code)
        drawn, (one, other) = children.table[chosen], parent[chosen].T
        if code == RANDOM:
            again = sampler.random(len(chosen), first=drawn)
        elif code == MUTATION:
            again = sampler.mutants(parents[one], first=drawn)
        else:
            again = sampler.recombinations((parents[one], parents[other]), first=drawn)
        children.table[chosen], children.n_draws[chosen] = again.table, again.n_draws


def tell(population: Population, children: Children, fitness: Float64, rng: Generator, afpo: Afpo) -> Population:
    """Return the survivors of parents and children, aged by one generation.

    Args:
        population: the parents; they keep their fitness, because the simulation is deterministic.
        children: the children that :func:`ask` returned.
        fitness: (n_children,) their fitness [m]; a design whose fitness is not finite is never selected.
        rng: source of randomness.
        afpo: the algorithm's parameters.

    Raises:
        ValueError: fitness does not have one value for each child.
    """
    if fitness.shape != children.age.shape:
        raise ValueError(f"fitness has shape {fitness.shape}, expected {children.age.shape}: one for each child")
    all_fitness = np.concatenate((population.fitness, fitness))
    all_ages = np.concatenate((population.age, children.age))
    survivors = select(all_fitness, all_ages, rng, afpo.population_size)
    return Population(
        table=np.concatenate((population.table, children.table))[survivors],
        fitness=all_fitness[survivors],
        age=all_ages[survivors] + 1,
        identity=np.concatenate((population.identity, children.identity))[survivors],
        n_evaluated=population.n_evaluated + len(fitness),
    )


def select(fitness: Float64, age: Int64, rng: Generator, n_survivors: int) -> Int64:
    """Return the indices of the survivors: the Pareto front on (age, fitness), then a sample of the dominated.

    Args:
        fitness: (n_designs,) [m]; a design whose fitness is not finite does not survive.
        age: (n_designs,) [generations].
        rng: source of randomness.
        n_survivors: number of designs to choose; fewer are chosen only if fewer have a finite fitness.
    """
    finite = np.flatnonzero(np.isfinite(fitness))
    fitness, age = fitness[finite], age[finite]
    order = np.lexsort((-fitness, age))  # by age; at the same age, the fittest first
    best = np.empty_like(fitness)
    best[order] = np.maximum.accumulate(fitness[order])  # best fitness at each design's age or younger
    front, dominated = np.flatnonzero(fitness == best), np.flatnonzero(fitness < best)
    front = front[np.argsort(-fitness[front], kind="stable")][:n_survivors]
    n_sampled = min(n_survivors - len(front), len(dominated))
    sampled = rng.choice(dominated, n_sampled, replace=False)
    survivors: Int64 = finite[np.concatenate((front, sampled))]
    return survivors
