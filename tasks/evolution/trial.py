"""A trial: one evolutionary run, as far as it is asked to go, with a record of every design that it evaluated.

Trials that have nothing to do with one another may go side by side: their designs are evaluated together, which changes
nothing but the time it takes, and each trial is what it would be by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.design import ANY_BODY, Designs, Morphology
from tasks.evolution.afpo import EMPTY_POPULATION, OPERATORS, Afpo, Children, Population, ask, tell
from tasks.evolution.objective import Evaluation

History = dict[str, npt.NDArray[Any]]
"""Columns of equal length, a row per evaluated design: see :data:`HISTORY_UNITS`."""

HISTORY_UNITS: Mapping[str, str] = {
    "generation": "",
    "identity": "running number within the trial",
    "operator": ", ".join(f"{code} {name}" for code, name in enumerate(OPERATORS)),
    "age": "generations",
    "parents": "two identities, -1 where there is none",
    "n_draws": "draws of its operator, the last of which the morphology allowed",
    "survived": "whether it was selected in its own generation",
    "fitness": "m",
    "displacement": "m, per member",
    "com_displacement": "m, per member",
}
"""Columns of a history beside the genes, and their units."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A trial as far as it has come."""

    generator_of: Callable[[int], Generator]
    """Gives each generation its own generator, so that it does not matter where a trial was cut."""
    population: Population = EMPTY_POPULATION
    body: Designs | None = None
    """One design whose body stays; only controllers evolve then."""


_Step = tuple[Children, Evaluation, Population]
"""A generation of a trial: its children, how they did, and who survived."""


def evolve(
    trials: Sequence[Trial],
    evaluate: Callable[[Designs], Evaluation],
    *,
    first_generation: int,
    n_generations: int,
    afpo: Afpo,
    morphology: Morphology = ANY_BODY,
) -> list[tuple[Population, History]]:
    """Advance trials by some generations, side by side.

    Args:
        trials: as they are before.
        evaluate: scores designs, of all trials at once; evolution does not know how.
        first_generation: number of the first generation to run.
        n_generations: how many to run.
        afpo: the algorithm's parameters.
        morphology: what bodies keep to.

    Returns:
        Of each trial: what survives of it, and the history of these generations.

    Raises:
        ValueError: there is no generation to run.
    """
    if n_generations < 1:
        raise ValueError(f"n_generations is {n_generations}, expected 1 or more")
    # After some milliseconds of anything else, Python's own work takes about twice as long. So what
    # can be done before or after all rollouts is.
    numbers = range(first_generation, first_generation + n_generations)
    generators = [[trial.generator_of(number) for number in numbers] for trial in trials]
    populations = [trial.population for trial in trials]
    steps: list[list[_Step]] = [[] for _ in trials]
    for rngs in zip(*generators, strict=True):
        families = [
            ask(population, rng, afpo, body=trial.body, morphology=morphology)
            for trial, population, rng in zip(trials, populations, rngs, strict=True)
        ]
        evaluations = _of_each(evaluate(_all_designs(families)), families)
        for i, (children, evaluation, rng) in enumerate(zip(families, evaluations, rngs, strict=True)):
            populations[i] = tell(populations[i], children, evaluation.fitness, rng, afpo)
            steps[i].append((children, evaluation, populations[i]))
    return [(after, _record(first_generation, of)) for after, of in zip(populations, steps, strict=True)]


def _all_designs(families: Sequence[Children]) -> Designs:
    """Join the children of trials, one trial after another."""
    if len(families) == 1:
        return families[0].designs
    return Designs.from_table(np.concatenate([children.table for children in families]))


def _of_each(evaluation: Evaluation, families: Sequence[Children]) -> list[Evaluation]:
    """Part what was said of all designs by trials."""
    ends = np.cumsum([len(children.age) for children in families])
    return [
        Evaluation(
            fitness=evaluation.fitness[first:end],
            displacement=evaluation.displacement[first:end],
            com_displacement=evaluation.com_displacement[first:end],
        )
        for first, end in zip((0, *ends[:-1]), ends, strict=True)
    ]


def _record(first_generation: int, steps: Sequence[_Step]) -> History:
    """Record what became of each generation's children, all generations at once."""
    children = [step[0] for step in steps]
    n_children = [len(of.age) for of in children]
    designs = Designs.from_table(np.concatenate([of.table for of in children]))
    return {
        "generation": np.repeat(np.arange(first_generation, first_generation + len(steps)), n_children),
        "identity": np.concatenate([of.identity for of in children]),
        "operator": np.concatenate([of.operator for of in children]),
        "age": np.concatenate([of.age for of in children]),
        "parents": np.concatenate([of.parents for of in children]),
        "n_draws": np.concatenate([of.n_draws for of in children]),
        "survived": np.concatenate([_mark(after.identity - of.identity[0], len(of.age)) for of, _, after in steps]),
        "fitness": np.concatenate([evaluation.fitness for _, evaluation, _ in steps]),
        "displacement": np.concatenate([evaluation.displacement for _, evaluation, _ in steps]),
        "com_displacement": np.concatenate([evaluation.com_displacement for _, evaluation, _ in steps]),
        **{name: np.ascontiguousarray(genes) for name, genes in designs.arrays()},
    }


def _mark(places: npt.NDArray[np.int64], n: int) -> npt.NDArray[np.bool_]:
    """Mark those of n places that are named; names below 0 are of others."""
    marked = np.zeros(n, dtype=bool)
    marked[places[places >= 0]] = True
    return marked
