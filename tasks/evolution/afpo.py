"""Age-fitness Pareto optimisation by ask and tell. Schmidt and Lipson (2011); paper, "Evolutionary Design".

The population is a plain value: asking for children and telling their fitness give new values, and all randomness comes
from the generator that is passed in. So a trial can stop after any generation and go on from what it was.

A design is non-dominated if no design of its age or younger has a higher fitness. Survivors are the non-dominated in
order of decreasing fitness, then a uniform sample of the dominated. New random designs are of age 0 and so compete with
the young alone, which keeps lines of descent apart until they have had time to improve.
"""

from __future__ import annotations

from typing import Self

import numpy as np
import numpy.typing as npt
from numpy.random import Generator
from pydantic import Field, model_validator

from tasks.arrays import Int64
from tasks.compiled import compiled
from tasks.design import (
    ANY_BODY,
    Designs,
    Morphology,
    Mutation,
    draw_mutants,
    draw_random,
    draw_recombinations,
    genes,
    variation,
)
from tasks.design.genes import N_COLUMNS, DesignTable, GenePart
from tasks.design.variation import VARIATION_SOURCES, variation_of
from tasks.evolution import breeding
from tasks.evolution.breeding import MUTATION, OPERATORS, RANDOM, Children, Population
from tasks.kernel_generators import hold
from tasks.parameters import Parameters

_breed = compiled(breeding.breed, [*VARIATION_SOURCES, variation, breeding], seconds=10)
_survive = compiled(breeding.survive, [genes, breeding], seconds=4)
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


EMPTY_POPULATION = Population(
    table=np.zeros((0, N_COLUMNS)),
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
    parts: tuple[GenePart, ...] = ("body", "control") if body is None else ("control",)
    varying = variation_of(morphology, mutation=afpo.mutation, parts=parts, body=body)
    children: Children = _breed(
        afpo.population_size, hold(rng).held, population, afpo.random_share, afpo.mutation_share, varying
    )
    if body is None and morphology.unjoined_links == "apart":
        _draw_again(children, population.table, rng, afpo.mutation, morphology)
    return children


def _draw_again(
    children: Children, parents: DesignTable, rng: Generator, mutation: Mutation, morphology: Morphology
) -> None:
    """Draw those children again, by their own operators, that the morphology refuses; in place."""
    for operator in range(len(OPERATORS)):
        which = np.flatnonzero(children.operator == operator)
        first, (one, other) = children.table[which], children.places[which].T
        if operator == RANDOM:
            again = draw_random(len(which), rng, morphology=morphology, first=first)
        elif operator == MUTATION:
            again = draw_mutants(parents[one], rng, mutation=mutation, morphology=morphology, first=first)
        else:
            again = draw_recombinations(parents[one], parents[other], rng, morphology=morphology, first=first)
        children.table[which], children.n_draws[which] = again.table, again.n_draws


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

    Raises:
        ValueError: there is not one fitness for each child.
    """
    if fitness.shape != children.age.shape:
        raise ValueError(f"fitness has shape {fitness.shape}, expected {children.age.shape}: one for each child")
    told = np.array(fitness, dtype=np.float64)  # kernels are compiled for one that can be written to
    survivors: Population = _survive(population, children, told, hold(rng).held, afpo.population_size)
    return survivors


def select(fitness: npt.NDArray[np.float64], age: Int64, rng: Generator, n_survivors: int) -> Int64:
    """Choose survivors: the non-dominated by decreasing fitness, then a uniform sample of the dominated.

    Args:
        fitness: (n_designs,) [m]; a design whose fitness is not finite does not survive.
        age: (n_designs,) generations, 0 or more; the oldest decides how much memory it takes.
        rng: source of randomness.
        n_survivors: how many to choose; fewer are chosen only if fewer have a finite fitness.

    Returns:
        Indices of the survivors.

    Raises:
        ValueError: an age is negative.
    """
    if len(age) and age.min() < 0:
        raise ValueError(f"age of design {age.argmin()} is {age.min()}, expected 0 or more generations")
    survivors: Int64 = _select(fitness, age, hold(rng).held, n_survivors)
    return survivors
