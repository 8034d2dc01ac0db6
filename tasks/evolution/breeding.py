"""Breeding: random designs, mutants and recombinations of what a search keeps. Paper, "Evolutionary Design"."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.random import Generator
from pydantic import Field, model_validator

from tasks.arrays import Int64
from tasks.design import ANY_BODY, Designs, Morphology, Mutation
from tasks.design.gene import GenePart
from tasks.design.genes import DesignTable
from tasks.design.variation import Sampler, mutate_kernel, random_kernel, recombine_kernel, variation_of
from tasks.evolution.search import NO_PARENT, Children, Population
from tasks.parameters import Parameters

OPERATORS = ("random", "mutation", "crossover")  # operators that make a child, in the order of their codes
RANDOM, MUTATION, CROSSOVER = range(3)


class Breeding(Parameters):
    """How children are made; the paper's by default."""

    operators: ClassVar[tuple[str, ...]] = OPERATORS
    columns: ClassVar[Mapping[str, str]] = {}

    population_size: int = Field(default=64, ge=2, le=1_000_000)
    """Children that each generation adds; AFPO keeps as many designs. [P]"""
    random_share: float = Field(default=0.15, ge=0.0, le=1.0)
    """Share of children that are new random designs. [P]"""
    mutation_share: float = Field(default=0.65, ge=0.0, le=1.0)
    """Share of children that are mutated copies. [P]"""
    crossover_share: float = Field(default=0.20, ge=0.0, le=1.0)
    """Share of children that are recombinations of two designs. [P]"""
    mutation: Mutation = Mutation()
    """How mutants depart from their parents."""
    parent_selection: Literal["uniform", "tournament"] = "uniform"
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

    def breed(
        self, population: Population, rng: Generator, *, body: Designs | None = None, morphology: Morphology = ANY_BODY
    ) -> tuple[Children, Int64]:
        """Return a generation of children, all of them random if the population is empty, and who their parents are.

        Each child draws its operator independently, so the shares hold on average. Parents are (n_children, 2) indices
        into the population, or NO_PARENT.
        """
        n_children, n_parents = self.population_size, len(population.fitness)
        parts: tuple[GenePart, ...] = ("body", "control") if body is None else ("control",)
        variation = variation_of(
            morphology, mutation=self.mutation, parts=parts, body=body, controller=population.controller
        )

        # Every child draws a random design and two parents, whether its operator needs them or not.
        chance = rng.random(n_children)
        table = random_kernel(n_children, rng, variation)
        first = rng.integers(0, max(n_parents, 1), n_children)
        if self.parent_selection == "tournament" and n_parents:
            rival = rng.integers(0, n_parents, n_children)
            first = np.where(population.fitness[rival] > population.fitness[first], rival, first)
        second = first + rng.integers(1, max(n_parents, 2), n_children)
        second %= max(n_parents, 1)  # never the first, if it can be
        operator = np.digitize(chance, np.cumsum(self.shares[:2])) if n_parents else np.full(n_children, RANDOM)
        mutants, crosses = operator == MUTATION, operator == CROSSOVER

        # Mutants and recombinations replace the random designs.
        parents = population.table if n_parents else table[:0]
        mutated = parents[first[mutants]]
        mutate_kernel(mutated, rng, variation)
        table[mutants] = mutated
        crossed, others = parents[first[crosses]], parents[second[crosses]]
        recombine_kernel(crossed, others, rng, variation)
        table[crosses] = crossed

        parent = np.stack((np.where(mutants | crosses, first, NO_PARENT), np.where(crosses, second, NO_PARENT)), axis=1)
        children = Children(
            table=table,
            identity=np.arange(population.n_evaluated, population.n_evaluated + n_children),
            operator=operator,
            parents=np.append(population.identity, NO_PARENT)[parent],  # NO_PARENT is the index of what is appended
            n_draws=np.ones(n_children, dtype=np.int64),
            controller=population.controller,
        )
        constraints = morphology if body is None else morphology.of_controllers()
        if constraints.rejects:
            sampler = Sampler(rng, variation, constraints, population.controller)
            _resample_rejected(children, population.table, parent, sampler)
        return children, parent


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
