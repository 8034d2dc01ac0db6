"""Age-fitness Pareto optimisation by ask and tell. Schmidt and Lipson (2011); paper, "Evolutionary Design".

The population is a plain value: asking for children and telling their fitness give new values, and all randomness comes
from the generator that is passed in. So a trial can stop after any generation and go on from what it was.

A design is non-dominated if no design of its age or younger has a higher fitness. Survivors are the non-dominated in
order of decreasing fitness, then a uniform sample of the dominated. New random designs are of age 0 and so compete with
the young alone, which keeps lines of descent apart until they have had time to improve.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from numpy.random import Generator
from pydantic import Field, model_validator

from tasks.compiled import compiled
from tasks.design import ANY_BODY, Designs, Morphology, Mutation, draw_mutants, draw_random, draw_recombinations
from tasks.design.genes import Part, Table
from tasks.design.variation import NO_DESIGNS, SOURCES, variation_of
from tasks.evolution import breeding
from tasks.evolution.breeding import MUTATION, OPERATORS, RANDOM, Offspring, Parents
from tasks.held import hold
from tasks.parameters import Parameters

Ints = npt.NDArray[np.int64]

_breed = compiled(breeding.breed, [*SOURCES, breeding], seconds=10)
_select = compiled(breeding.select, [breeding], seconds=4)


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


@dataclass(frozen=True, eq=False)
class Population:
    """The survivors of a generation."""

    table: Table
    """(n_designs, N_COLUMNS) their genes; fewer than the population's size only if too many diverged."""
    fitness: npt.NDArray[np.float64]
    """(n_designs,) finite [m]"""
    age: Ints
    """(n_designs,) generations since the oldest ancestor was drawn at random."""
    identity: Ints
    """(n_designs,) running number within the trial, in order of evaluation."""
    n_evaluated: int
    """Designs evaluated in the trial so far."""

    @cached_property
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
            table=Designs.from_arrays(arrays).table,
            fitness=arrays["fitness"],
            age=arrays["age"],
            identity=arrays["identity"],
            n_evaluated=int(arrays["n_evaluated"][0]),
        )

    def champion(self) -> int:
        """Index of the fittest; the first of several. A trial's best design never leaves the population."""
        return int(np.argmax(self.fitness))


@dataclass(frozen=True, eq=False)
class Children:
    """Designs that wait to be evaluated."""

    designs: Designs
    """n_children designs."""
    age: Ints
    """(n_children,)"""
    identity: Ints
    """(n_children,)"""
    operator: Ints
    """(n_children,) index into OPERATORS."""
    parents: Ints
    """(n_children, 2) identities; NOBODY where there is none."""
    n_draws: Ints
    """(n_children,) how often its operator drew until the morphology allowed the design."""


NOBODY_YET = Population(
    table=NO_DESIGNS.table,
    fitness=np.zeros(0),
    age=np.zeros(0, dtype=np.int64),
    identity=np.zeros(0, dtype=np.int64),
    n_evaluated=0,
)
"""The population before the first generation."""


def ask(
    population: Population,
    rng: Generator,
    afpo: Afpo,
    *,
    body: Designs | None = None,
    morphology: Morphology = ANY_BODY,
) -> Children:
    """Draw a generation of children; the first generation is random throughout.

    A mutant is of its parent's age, a recombination of the older parent's. Operators are drawn for each child alone, so
    that their shares hold on average.

    Args:
        population: the survivors.
        rng: source of randomness.
        afpo: the algorithm's parameters.
        body: one design whose body all children get; only controllers evolve then.
        morphology: what bodies keep to.
    """
    parts: tuple[Part, ...] = ("body", "control") if body is None else ("control",)
    variation = variation_of(morphology, mutation=afpo.mutation, parts=parts, body=body)
    table = population.table.view()
    table.flags.writeable = False  # as that of a population from the store is: kernels are compiled for one kind
    parents = Parents(table, population.age, population.identity)
    of_random, of_mutants, _ = afpo.shares
    drawn: Offspring = _breed(afpo.population_size, hold(rng).held, parents, of_random, of_mutants, variation)
    n_draws = np.ones(afpo.population_size, dtype=np.int64)
    if body is None and morphology.unjoined_links == "apart":
        _draw_again(drawn, n_draws, table, rng, afpo.mutation, morphology)
    return Children(
        designs=Designs.from_table(drawn.table),
        age=drawn.age,
        identity=population.n_evaluated + np.arange(afpo.population_size),
        operator=drawn.operator,
        parents=drawn.parents,
        n_draws=n_draws,
    )


def _draw_again(
    offspring: Offspring, n_draws: Ints, parents: Table, rng: Generator, mutation: Mutation, morphology: Morphology
) -> None:
    """Draw those children again, by their own operators, that the morphology refuses; in place."""
    for operator in range(len(OPERATORS)):
        children = np.flatnonzero(offspring.operator == operator)
        first, (one, other) = offspring.table[children], offspring.places[children].T
        if operator == RANDOM:
            again = draw_random(len(children), rng, morphology=morphology, first=first)
        elif operator == MUTATION:
            again = draw_mutants(parents[one], rng, mutation=mutation, morphology=morphology, first=first)
        else:
            again = draw_recombinations(parents[one], parents[other], rng, morphology=morphology, first=first)
        offspring.table[children], n_draws[children] = again.table, again.n_draws


def tell(
    population: Population, children: Children, fitness: npt.NDArray[np.float64], rng: Generator, afpo: Afpo
) -> Population:
    """Select the survivors of parents and children, and let everybody grow older by a generation.

    Args:
        population: the parents, who keep their fitness: the simulation is deterministic.
        children: as :func:`ask` gave them.
        fitness: (n_children,) theirs [m]; a design whose fitness is not finite can't be selected.
        rng: source of randomness.
        afpo: the algorithm's parameters.
    """
    if fitness.shape != children.age.shape:
        raise ValueError(f"fitness has shape {fitness.shape}, expected {children.age.shape}: one for each child")
    all_fitness = np.concatenate([population.fitness, fitness])
    all_age = np.concatenate([population.age, children.age])
    survivors = select(all_fitness, all_age, rng, afpo.population_size)
    all_tables = np.concatenate([population.table, children.designs.table])
    return Population(
        table=all_tables.take(survivors, axis=0),
        fitness=all_fitness[survivors],
        age=all_age[survivors] + 1,
        identity=np.concatenate([population.identity, children.identity])[survivors],
        n_evaluated=population.n_evaluated + len(fitness),
    )


def select(fitness: npt.NDArray[np.float64], age: Ints, rng: Generator, n_survivors: int) -> Ints:
    """Choose survivors: the non-dominated by decreasing fitness, then a uniform sample of the dominated.

    Args:
        fitness: (n_designs,) [m]; a design whose fitness is not finite does not survive.
        age: (n_designs,) generations.
        rng: source of randomness.
        n_survivors: how many to choose; fewer are chosen only if fewer have a finite fitness.

    Returns:
        Indices of the survivors.
    """
    survivors: Ints = _select(fitness, age, hold(rng).held, n_survivors)
    return survivors
