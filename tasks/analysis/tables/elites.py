"""Elites of MAP-Elites: the fittest design of each cell of every trial's archive."""

from collections.abc import Sequence
from dataclasses import dataclass

from tasks.analysis.columns import OfTrial, column
from tasks.analysis.registry import analysis
from tasks.analysis.study import StudyData
from tasks.evolution.map_elites import CELL, measure_bodies


@dataclass(frozen=True)
class Elite(OfTrial):
    """The fittest design of a cell, which is the row of its identity in the table of histories."""

    length_cell: int = column("cell of length", form="{}", meaning="Number of its cell along body length, from 0.")
    size_cell: int = column("cell of size", form="{}", meaning="Number of its cell along body size, from 0.")
    body_length: float = column("body length", "m", meaning="Extent along x at rest.")
    body_size: float = column("body size", "m", meaning="Sum of the long axes of its links.")
    fitness: float = column("fitness", form="{:z.2f}", meaning="Where it evolved, in the objective's unit.")
    identity: int = column("identity", form="{}", meaning="Its running number within the trial.")


@analysis(
    "elites",
    row=Elite,
    reads=("populations",),
    answers="How fit is the best robot of each body length and size?",
    search="map_elites",
)
def elites(study: StudyData) -> Sequence[Elite]:
    """List the archive of every trial, cell by cell."""
    return [
        Elite(*trial, length_cell, size_cell, length, size, fitness, identity)
        for trial, population in study.populations.items()
        for (length_cell, size_cell), (length, size), fitness, identity in zip(
            population.extra[CELL].tolist(),
            measure_bodies(population.designs).tolist(),
            population.fitness.tolist(),
            population.identity.tolist(),
            strict=True,
        )
    ]
