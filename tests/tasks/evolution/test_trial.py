"""A trial: cut anywhere it is the same, its best is never lost, and its history tells everything."""

from collections.abc import Callable

import numpy as np
import pytest

from tasks.design import GENES, Designs, Morphology, check, links_apart, random_designs
from tasks.evolution import EMPTY_POPULATION, HISTORY_UNITS, Afpo, Evaluation, History, Population, Trial, evolve
from tasks.evolution.afpo import CROSSOVER, MUTATION, RANDOM
from tasks.seeding import generator

AFPO = Afpo(population_size=12)
N_GENERATIONS = 25


def long_and_fast(designs: Designs) -> Evaluation:
    """A landscape that costs nothing: long links, and a ripple. Now and then a design diverges."""
    displacement = designs.length_scale.sum(axis=1) + np.sin(20 * designs.frequency)
    displacement = np.where(designs.phase[:, 1] < 0.3, np.nan, displacement)[:, None]
    fitness = np.where(np.isfinite(displacement[:, 0]), displacement[:, 0], -np.inf)
    return Evaluation(fitness=fitness, displacement=displacement, com_displacement=displacement / 2)


def of_trial(generation: int) -> np.random.Generator:
    return generator(5, "evolve", 9.0, 0, generation)


def of_another(generation: int) -> np.random.Generator:
    return generator(5, "evolve", 9.0, 1, generation)


def run(
    cuts: list[int],
    *,
    afpo: Afpo = AFPO,
    body: Designs | None = None,
    score: Callable[[Designs], Evaluation] = long_and_fast,
) -> tuple[Population, History]:
    """Run a trial in segments that end at the given generations; between them the state travels as arrays."""
    population, histories, first = EMPTY_POPULATION, [], 0
    for end in cuts:
        population = Population.from_arrays(population.arrays())
        trial = Trial(of_trial, population, body)
        ((population, history),) = evolve([trial], score, first_generation=first, n_generations=end - first, afpo=afpo)
        histories.append(history)
        first = end
    return population, {name: np.concatenate([history[name] for history in histories]) for name in histories[0]}


def assert_same(one: tuple[Population, History], other: tuple[Population, History]) -> None:
    for (name, array), expected in zip(one[0].arrays().items(), other[0].arrays().values(), strict=True):
        assert array.tobytes() == expected.tobytes(), name
    assert list(one[1]) == list(other[1])
    for name, column in one[1].items():
        assert column.tobytes() == other[1][name].tobytes() and column.dtype == other[1][name].dtype, name


@pytest.fixture(scope="module")
def uncut() -> tuple[Population, History]:
    return run([N_GENERATIONS])


@pytest.mark.parametrize("cuts", [[1, N_GENERATIONS], [10, 11, N_GENERATIONS], list(range(1, N_GENERATIONS + 1))])
def test_a_trial_cut_anywhere_is_the_uncut_one(uncut: tuple[Population, History], cuts: list[int]) -> None:
    assert_same(run(cuts), uncut)


def test_the_history_has_a_row_for_every_design(uncut: tuple[Population, History]) -> None:
    population, history = uncut
    n = N_GENERATIONS * AFPO.population_size
    genes = {"parent", *(gene.name for gene in GENES)}
    assert set(history) == set(HISTORY_UNITS) | genes
    assert {len(column) for column in history.values()} == {n}
    np.testing.assert_array_equal(history["identity"], np.arange(n))
    np.testing.assert_array_equal(history["generation"], np.repeat(np.arange(N_GENERATIONS), AFPO.population_size))
    designs = Designs.from_arrays(history)
    check(designs)
    again = long_and_fast(designs)
    np.testing.assert_array_equal(history["fitness"], again.fitness)
    np.testing.assert_array_equal(history["displacement"], again.displacement)
    np.testing.assert_array_equal(history["com_displacement"], again.com_displacement)
    # The survivors are rows of it.
    assert designs[population.identity].equals(population.designs)
    np.testing.assert_array_equal(history["fitness"][population.identity], population.fitness)
    # They have grown older by a generation since each that they lived through.
    lived = N_GENERATIONS - history["generation"][population.identity]
    np.testing.assert_array_equal(population.age, history["age"][population.identity] + lived)


def test_parents_were_evaluated_before_and_had_survived(uncut: tuple[Population, History]) -> None:
    _, history = uncut
    n_parents = (history["parents"] >= 0).sum(axis=1)
    np.testing.assert_array_equal(n_parents, np.array([0, 1, 2])[history["operator"]])
    child = np.repeat(np.arange(len(n_parents)), n_parents)
    parent = history["parents"][history["parents"] >= 0]
    assert (history["generation"][parent] < history["generation"][child]).all()
    assert history["survived"][parent].all()
    assert np.isfinite(history["fitness"][parent]).all()
    # A line of descent is as old as the generations since its oldest ancestor.
    ages = history["age"] - history["generation"]
    mutant = history["operator"] == MUTATION
    np.testing.assert_array_equal(ages[mutant], ages[history["parents"][mutant, 0]])
    cross = history["operator"] == CROSSOVER
    np.testing.assert_array_equal(ages[cross], ages[history["parents"][cross]].max(axis=1))
    assert (history["age"][history["operator"] == RANDOM] == 0).all()


def test_batched_trials_equal_each_alone() -> None:
    """One begins, one goes on, one has a body that stays; and all designs of a generation are evaluated at once."""
    n_at_once = []

    def score(designs: Designs) -> Evaluation:
        n_at_once.append(len(designs))
        return long_and_fast(designs)

    started, _ = run([3])
    body = random_designs(1, np.random.default_rng(2))
    trials = [Trial(of_another), Trial(of_trial, started), Trial(of_trial, body=body)]
    together = evolve(trials, score, first_generation=3, n_generations=5, afpo=AFPO)
    assert n_at_once == [3 * AFPO.population_size] * 5
    for trial, batched in zip(trials, together, strict=True):
        (alone,) = evolve([trial], long_and_fast, first_generation=3, n_generations=5, afpo=AFPO)
        assert_same(batched, alone)


BUILDABLE = Morphology(n_actuated=2, unjoined_links="apart")


@pytest.mark.parametrize("frozen", [False, True])
def test_every_design_of_a_trial_keeps_to_its_morphology(frozen: bool) -> None:
    body = random_designs(1, np.random.default_rng(6), morphology=BUILDABLE) if frozen else None
    ((_, history),) = evolve(
        [Trial(of_trial, body=body)],
        long_and_fast,
        first_generation=0,
        n_generations=12,
        afpo=AFPO,
        morphology=BUILDABLE,
    )
    designs = Designs.from_arrays(history)
    check(designs)
    assert links_apart(designs).all()
    assert (designs.motor_on.sum(axis=1) == 2).all()
    assert (history["n_draws"] >= 1).all()
    random = history["operator"] == RANDOM
    if body is None:
        assert history["n_draws"][random].mean() > 100  # 1,100 on average
        assert 1 < history["n_draws"][history["operator"] == MUTATION].mean() < 10
    else:
        # A controller that evolves anew keeps the body's motors, and there is nothing to draw again.
        for name in ("parent", "motor_on", *(gene.name for gene in GENES if gene.part == "body")):
            assert (history[name] == getattr(body, name)).all(), name
        assert (history["n_draws"] == 1).all()
        assert len(np.unique(designs.frequency)) > 24
