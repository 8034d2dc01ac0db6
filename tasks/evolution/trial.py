"""A trial: one evolutionary run for a number of generations, with a record of every design that it evaluated.

Independent trials may be batched: their designs are evaluated together to save time, and each trial's result is the
same as if it ran alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.arrays import Bools, Int64
from tasks.design import ANY_BODY, Designs, Morphology
from tasks.evolution.afpo import EMPTY_POPULATION, OPERATORS, Afpo, Children, Population, ask, tell
from tasks.evolution.objectives import OBJECTIVES, PAPERS_OBJECTIVE, Evaluation

History = dict[str, npt.NDArray[Any]]  # columns of equal length, one row per evaluated design; see HISTORY_UNITS

HISTORY_UNITS: Mapping[str, str] = {
    "generation": "",
    "identity": "running number within the trial",
    "operator": ", ".join(f"{code} {name}" for code, name in enumerate(OPERATORS)),
    "age": "generations",
    "parents": "two identities, -1 where there is none",
    "n_draws": "draws of its operator, the last of which the morphology allowed",
    "survived": "whether it was selected in its own generation",
    "fitness": OBJECTIVES[PAPERS_OBJECTIVE].unit,
    "displacement": "m, per member",
    "com_displacement": "m, per member",
}
"""Columns of a history in addition to the genes, and their units; fitness has the unit of the objective."""


@dataclass(frozen=True, eq=False)
class Trial:
    """State of a trial between two generations."""

    generator_of: Callable[[int], Generator]  # generator of a generation, so that a trial can be cut after any of them
    population: Population = EMPTY_POPULATION
    body: Designs | None = None  # one design whose body stays fixed; only controllers evolve then


_Generation = tuple[Children, Evaluation, Population]  # its children, their evaluation and the survivors


def evolve(
    trials: Sequence[Trial],
    evaluate: Callable[[Designs], Evaluation],
    *,
    first_generation: int,
    n_generations: int,
    afpo: Afpo,
    morphology: Morphology = ANY_BODY,
) -> list[tuple[Population, History]]:
    """Return the survivors of each trial of a batch after some generations, and the history of these.

    Args:
        trials: the trials' states before.
        evaluate: scores the designs of all trials in one call.
        first_generation: number of the first generation to run.
        n_generations: number of generations to run.
        afpo: the algorithm's parameters.
        morphology: constraints on designs.

    Raises:
        ValueError: n_generations is less than 1.
    """
    if n_generations < 1:
        raise ValueError(f"n_generations is {n_generations}, expected at least 1")
    # Python runs about half as fast just after a rollout, so seeding and recording stay out of the loop.
    numbers = range(first_generation, first_generation + n_generations)
    generators = [[trial.generator_of(number) for number in numbers] for trial in trials]
    populations = [trial.population for trial in trials]
    generations: list[list[_Generation]] = [[] for _ in trials]
    for rngs in zip(*generators, strict=True):
        asked = [
            ask(population, rng, afpo, body=trial.body, morphology=morphology)
            for trial, population, rng in zip(trials, populations, rngs, strict=True)
        ]
        designs = Designs.from_table(np.concatenate([children.table for children in asked]))
        evaluations = _split_by_trial(evaluate(designs), asked)
        for i, (children, evaluation, rng) in enumerate(zip(asked, evaluations, rngs, strict=True)):
            populations[i] = tell(populations[i], children, evaluation.fitness, rng, afpo)
            generations[i].append((children, evaluation, populations[i]))
    return [(after, _record(first_generation, past)) for after, past in zip(populations, generations, strict=True)]


def _split_by_trial(evaluation: Evaluation, asked: Sequence[Children]) -> list[Evaluation]:
    ends = np.cumsum([len(children.age) for children in asked])
    arrays = [np.split(getattr(evaluation, field.name), ends[:-1]) for field in fields(Evaluation)]
    return [Evaluation(*of_trial) for of_trial in zip(*arrays, strict=True)]


def _record(first_generation: int, generations: Sequence[_Generation]) -> History:
    asked, evaluations, survivors = zip(*generations, strict=True)
    n_children = [len(children.age) for children in asked]
    designs = Designs.from_table(np.concatenate([children.table for children in asked]))
    return {
        "generation": np.repeat(np.arange(first_generation, first_generation + len(asked)), n_children),
        **{
            name: np.concatenate([getattr(children, name) for children in asked])
            for name in ("identity", "operator", "age", "parents", "n_draws")
        },
        "survived": np.concatenate([_survived(*pair) for pair in zip(asked, survivors, strict=True)]),
        **{
            name: np.concatenate([getattr(evaluation, name) for evaluation in evaluations])
            for name in ("fitness", "displacement", "com_displacement")
        },
        **{name: np.ascontiguousarray(genes) for name, genes in designs.arrays()},
    }


def _survived(children: Children, survivors: Population) -> Bools:
    """Mark the children that are among the survivors."""
    index: Int64 = survivors.identity - children.identity[0]  # negative for designs of earlier generations
    survived = np.zeros(len(children.age), dtype=bool)
    survived[index[index >= 0]] = True
    return survived
