"""MAP-Elites: the fittest design of every kind of body. Mouret and Clune (2015), arXiv:1504.04909.

A grid divides bodies by two measures, how far they extend at rest and how much link they have, and an archive keeps the
fittest design of each cell. Parents are drawn from the archive, so kinds of bodies that are not the best yet go on
improving. The archive is that of pyribs, which the extra `search` installs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from numpy.random import Generator
from pydantic import Field

from tasks.arrays import Float64
from tasks.design import ANY_BODY, Designs, Morphology, rest_pose
from tasks.evolution.breeding import Breeding
from tasks.evolution.objectives import Evaluation
from tasks.evolution.search import Children, Population, Search, register_search, require_search

if TYPE_CHECKING:
    from ribs.archives import GridArchive

MEASURES = {"body_length": (1.0, 7.0), "body_size": (8.0, 16.0)}
"""Measures of a body and the range [m] that the cells divide: 99 % of random designs; cells at its ends hold the rest.
The length is the extent along x at rest, the root upright; the size is the sum of the links' long axes."""

CELL = "cell"  # (n_designs, 2) index of an elite's cell along each measure


class MapElites(Breeding):
    """MAP-Elites' parameters; children are made as by AFPO."""

    columns: ClassVar[Mapping[str, str]] = dict.fromkeys(MEASURES, "m")

    cells: tuple[Annotated[int, Field(ge=1, le=1000)], Annotated[int, Field(ge=1, le=1000)]] = (12, 12)
    """Cells of the grid along body length and body size."""

    def ask(
        self, population: Population, rng: Generator, *, body: Designs | None = None, morphology: Morphology = ANY_BODY
    ) -> Children:
        """Return a generation of children of elites."""
        children, _ = self.breed(population, rng, body=body, morphology=morphology)
        return children._replace(extra=dict(zip(MEASURES, measure_bodies(children.designs).T, strict=True)))

    def tell(self, population: Population, children: Children, evaluation: Evaluation, rng: Generator) -> Population:
        """Return the elites, by cell: a child that is fitter than its cell's elite replaces it."""
        archive = self._archive(population.table.shape[1])
        finite = np.isfinite(evaluation.fitness)
        for table, fitness, identity in (
            (population.table, population.fitness, population.identity),
            (children.table[finite], evaluation.fitness[finite], children.identity[finite]),
        ):
            if len(table):
                designs = Designs.from_table(table, population.controller)
                archive.add(table, fitness, measure_bodies(designs), identity=identity)
        elites = archive.data()
        order = np.argsort(elites["index"])
        return Population(
            table=elites["solution"][order],
            fitness=elites["objective"][order],
            identity=elites["identity"][order],
            n_evaluated=population.n_evaluated + len(children.identity),
            extra={CELL: archive.int_to_grid_index(elites["index"][order]).astype(np.int64)},
        )

    def _archive(self, n_columns: int) -> GridArchive:
        require_search("map_elites")
        from ribs.archives import GridArchive  # takes seconds to import, and is an extra

        fields = {"identity": ((), np.int64)}
        return GridArchive(solution_dim=n_columns, dims=self.cells, ranges=[*MEASURES.values()], extra_fields=fields)


register_search(Search("map_elites", MapElites, package="ribs"))


def measure_bodies(designs: Designs) -> Float64:
    """Return (n_designs, 2) MEASURES [m]."""
    measures = np.empty((len(designs), 2))
    for which, alike in designs.by_number_of_links():
        x, _, angle = rest_pose(alike)
        half = (np.abs(np.sin(angle)) * alike.length_scale + np.abs(np.cos(angle)) / alike.length_scale) / 2
        measures[which, 0] = (x + half).max(axis=1) - (x - half).min(axis=1)
        measures[which, 1] = alike.length_scale.sum(axis=1)
    return measures
