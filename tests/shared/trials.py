"""Trials on a landscape that costs nothing, in one segment or several."""

from collections.abc import Callable

import numpy as np

from tasks.design import Designs, Morphology
from tasks.evolution import EMPTY_POPULATION, Evaluation, History, Optimiser, Population, Trial, evolve
from tasks.seeding import generator


def long_and_fast(designs: Designs) -> Evaluation:
    """A landscape that costs nothing: long links, and a ripple. Now and then a design diverges."""
    displacement = designs.length_scale.sum(axis=1) + np.sin(20 * designs.frequency)
    displacement = np.where(designs.phase[:, 1] < 0.3, np.nan, displacement)[:, None]
    fitness = np.where(np.isfinite(displacement[:, 0]), displacement[:, 0], -np.inf)
    return Evaluation(
        fitness=fitness, displacement=displacement, com_displacement=displacement / 2, scores=displacement
    )


def of_trial(generation: int) -> np.random.Generator:
    return generator(5, "evolve", 9.0, 0, generation)


def of_another(generation: int) -> np.random.Generator:
    return generator(5, "evolve", 9.0, 1, generation)


def run(
    cuts: list[int],
    search: Optimiser,
    *,
    body: Designs | None = None,
    score: Callable[[Designs], Evaluation] = long_and_fast,
    morphology: Morphology | None = None,
) -> tuple[Population, History]:
    """Run a trial in segments that end at the given generations; between them the state travels as arrays."""
    population, histories, first = EMPTY_POPULATION, [], 0
    for end in cuts:
        ((population, history),) = evolve(
            [Trial(of_trial, Population.from_arrays(population.arrays()), body)],
            score,
            first_generation=first,
            n_generations=end - first,
            search=search,
            morphology=morphology or Morphology(),
        )
        histories.append(history)
        first = end
    return population, {name: np.concatenate([history[name] for history in histories]) for name in histories[0]}


def assert_same(one: tuple[Population, History], other: tuple[Population, History]) -> None:
    for (name, array), expected in zip(one[0].arrays().items(), other[0].arrays().values(), strict=True):
        assert array.tobytes() == expected.tobytes(), name
    assert list(one[1]) == list(other[1])
    for name, column in one[1].items():
        assert column.tobytes() == other[1][name].tobytes() and column.dtype == other[1][name].dtype, name
