"""A trial: one evolutionary run for a number of generations, with a record of every design that it evaluated.

Independent trials may be batched: their designs are evaluated together to save time, and each trial's result is the
same as if it ran alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.design import ANY_BODY, Designs, Morphology
from tasks.evolution.objectives import OBJECTIVES, PAPERS_OBJECTIVE, Evaluation, ObjectiveName
from tasks.evolution.search import EMPTY_POPULATION, Children, Optimiser, Population

_RECORDED = ("fitness", "displacement", "com_displacement")  # of an evaluation
History = dict[str, npt.NDArray[Any]]  # columns of equal length, one row per evaluated design; see history_units


def history_units(search: Optimiser, objective: ObjectiveName = PAPERS_OBJECTIVE) -> dict[str, str]:
    """Return the columns of a search's history in addition to the genes, and their units."""
    return {
        "generation": "",
        "identity": "running number within the trial",
        "operator": ", ".join(f"{code} {name}" for code, name in enumerate(search.operators)),
        **search.columns,
        "parents": "two identities, -1 where there is none",
        "n_draws": "draws of its operator, the last of which the morphology allowed",
        "survived": "whether it was selected in its own generation",
        "fitness": OBJECTIVES[objective].unit,
        "displacement": "m, per member",
        "com_displacement": "m, per member",
    }


@dataclass(frozen=True, eq=False)
class Trial:
    """State of a trial between two generations."""

    generator_of: Callable[[int], Generator]  # generator of a generation, so that a trial can be cut after any of them
    population: Population = EMPTY_POPULATION
    body: Designs | None = None  # one design whose body stays fixed; only controllers evolve then


_Generation = tuple[Children, Evaluation, Population]  # its children, their evaluation and the state after it


def evolve(
    trials: Sequence[Trial],
    evaluate: Callable[[Designs], Evaluation],
    *,
    first_generation: int,
    n_generations: int,
    search: Optimiser,
    morphology: Morphology = ANY_BODY,
) -> list[tuple[Population, History]]:
    """Return the state of each trial of a batch after some generations, and the history of these.

    Args:
        trials: the trials' states before.
        evaluate: scores the designs of all trials in one call.
        first_generation: number of the first generation to run.
        n_generations: number of generations to run.
        search: what asks for designs and is told how they did.
        morphology: constraints on designs.
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
            search.ask(population, rng, body=trial.body, morphology=morphology)._replace(
                controller=population.controller
            )
            for trial, population, rng in zip(trials, populations, rngs, strict=True)
        ]
        designs = Designs.concatenate([children.designs for children in asked])
        evaluations = _split_by_trial(evaluate(designs), asked)
        for i, (children, evaluation, rng) in enumerate(zip(asked, evaluations, rngs, strict=True)):
            before = populations[i] if len(populations[i].table) else populations[i]._replace(table=children.table[:0])
            told = search.tell(before, children, evaluation, rng)
            populations[i] = told._replace(controller=children.controller)
            generations[i].append((children, evaluation, populations[i]))
    return [
        (after, _record(search, first_generation, past)) for after, past in zip(populations, generations, strict=True)
    ]


def _split_by_trial(evaluation: Evaluation, asked: Sequence[Children]) -> list[Evaluation]:
    ends = np.cumsum([len(children.identity) for children in asked])
    arrays = [np.split(getattr(evaluation, field.name), ends[:-1]) for field in fields(Evaluation)]
    return [Evaluation(*of_trial) for of_trial in zip(*arrays, strict=True)]


def _record(search: Optimiser, first_generation: int, generations: Sequence[_Generation]) -> History:
    asked, evaluations, kept = zip(*generations, strict=True)
    n_children = [len(children.identity) for children in asked]
    designs = Designs.concatenate([children.designs for children in asked])
    columns = {
        "generation": [np.repeat(np.arange(first_generation, first_generation + len(asked)), n_children)],
        **{name: [getattr(children, name) for children in asked] for name in ("identity", "operator")},
        **{name: [children.extra[name] for children in asked] for name in search.columns},
        **{name: [getattr(children, name) for children in asked] for name in ("parents", "n_draws")},
        "survived": [np.isin(children.identity, after.identity) for children, after in zip(asked, kept, strict=True)],
        **{name: [getattr(evaluation, name) for evaluation in evaluations] for name in _RECORDED},
    }
    return {
        **{name: np.concatenate(parts) for name, parts in columns.items()},
        **{name: np.ascontiguousarray(genes) for name, genes in designs.arrays()},
    }
