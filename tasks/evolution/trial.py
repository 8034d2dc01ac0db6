"""A trial: one evolutionary run, as far as it is asked to go, with a record of every design that it evaluated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.design import ANY_BODY, Designs, Morphology
from tasks.evolution.afpo import Afpo, ask, tell
from tasks.evolution.breeding import OPERATORS, Children, Population
from tasks.evolution.objective import Evaluation
from tasks.held import hold

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


def evolve(
    population: Population,
    evaluate: Callable[[Designs], Evaluation],
    generator_of: Callable[[int], Generator],
    *,
    first_generation: int,
    n_generations: int,
    afpo: Afpo,
    body: Designs | None = None,
    morphology: Morphology = ANY_BODY,
) -> tuple[Population, History]:
    """Advance a trial by some generations.

    Args:
        population: what the trial was before; NOBODY_YET at its start.
        evaluate: scores designs; evolution does not know how.
        generator_of: gives each generation its own generator, so that it does not matter where a trial was cut.
        first_generation: number of the first generation to run.
        n_generations: how many to run.
        afpo: the algorithm's parameters.
        body: one design whose body stays; only controllers evolve then.
        morphology: what bodies keep to.

    Returns:
        The trial as it is afterwards, and the history of these generations.

    Raises:
        ValueError: there is no generation to run.
    """
    if n_generations < 1:
        raise ValueError(f"n_generations is {n_generations}, expected 1 or more")
    # After some milliseconds of anything else, Python's own work takes about twice as long. So what
    # can be done before or after all rollouts is.
    generators = [hold(generator_of(first_generation + index)) for index in range(n_generations)]
    steps = []
    for rng in generators:
        children = ask(population, rng, afpo, body=body, morphology=morphology)
        evaluation = evaluate(children.designs)
        population = tell(population, children, evaluation.fitness, rng, afpo)
        steps.append((children, evaluation, population))
    return population, _record(first_generation, steps)


def _record(first_generation: int, steps: Sequence[tuple[Children, Evaluation, Population]]) -> History:
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
