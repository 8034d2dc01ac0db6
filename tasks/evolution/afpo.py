"""Age-fitness Pareto optimisation (AFPO). Schmidt and Lipson (2011); paper, "Evolutionary Design".

- Children: a share are new random designs of age 0; the others are mutants, of their parent's age, or recombinations of
  two designs, of the older parent's age.
- Selection: parents and children compete. A design is dominated if another of its age or younger is fitter. The Pareto
  front, all designs that are not dominated, survives; a uniform sample of the others fills the population.
- Ageing: each survivor grows older by one generation.

New designs compete with the young alone, which keeps lines of descent apart until they have had time to improve.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.random import Generator

from tasks.arrays import Float64, Int64
from tasks.design import ANY_BODY, Designs, Morphology
from tasks.evolution.breeding import Breeding
from tasks.evolution.objectives import Evaluation
from tasks.evolution.search import Children, Population, Search, register_search

AGE = "age"  # (n_designs,) generations since the oldest ancestor was drawn at random


class Afpo(Breeding):
    """The algorithm's parameters; the paper's by default."""

    columns: ClassVar[Mapping[str, str]] = {AGE: "generations"}

    def ask(
        self, population: Population, rng: Generator, *, body: Designs | None = None, morphology: Morphology = ANY_BODY
    ) -> Children:
        """Return a generation of children; each has the older parent's age, 0 without parents."""
        children, parent = self.breed(population, rng, body=body, morphology=morphology)
        return children._replace(extra={AGE: np.append(_ages(population), 0)[parent].max(axis=1)})

    def tell(self, population: Population, children: Children, evaluation: Evaluation, rng: Generator) -> Population:
        """Return the survivors of parents and children, aged by one generation.

        There are fewer than the population's size only if too many designs diverged.
        """
        fitness = np.concatenate((population.fitness, evaluation.fitness))
        age = np.concatenate((_ages(population), children.extra[AGE]))
        survivors = select(fitness, age, rng, self.population_size)
        return Population(
            table=np.concatenate((population.table, children.table))[survivors],
            fitness=fitness[survivors],
            identity=np.concatenate((population.identity, children.identity))[survivors],
            n_evaluated=population.n_evaluated + len(children.identity),
            extra={AGE: age[survivors] + 1},
        )


register_search(Search("afpo", Afpo))


def _ages(population: Population) -> Int64:
    return np.asarray(population.extra.get(AGE, np.zeros(0, dtype=np.int64)))


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
