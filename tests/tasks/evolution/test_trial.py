"""A trial of any search: cut anywhere it is the same, its best is never lost, and its history tells everything."""

import numpy as np
import pytest
from trials import assert_same, long_and_fast, of_another, of_trial, run

from tasks.design import GENES, Designs, Morphology, check, links_apart, random_designs
from tasks.evolution import SEARCHES, Afpo, Evaluation, History, Optimiser, Population, Trial, evolve, history_units
from tasks.evolution.breeding import CROSSOVER, MUTATION, RANDOM

N_GENERATIONS = 25


@pytest.fixture(scope="module", params=SEARCHES)
def search(request: pytest.FixtureRequest) -> Optimiser:
    return SEARCHES[request.param].settings.model_validate({"population_size": 12})


@pytest.fixture(scope="module")
def uncut(search: Optimiser) -> tuple[Population, History]:
    return run([N_GENERATIONS], search)


@pytest.mark.parametrize("cuts", [[1, N_GENERATIONS], [10, 11, N_GENERATIONS], list(range(1, N_GENERATIONS + 1))])
def test_a_trial_cut_anywhere_is_the_uncut_one(
    uncut: tuple[Population, History], search: Optimiser, cuts: list[int]
) -> None:
    assert_same(run(cuts, search), uncut)


def test_the_history_has_a_row_for_every_design(uncut: tuple[Population, History], search: Optimiser) -> None:
    population, history = uncut
    n = N_GENERATIONS * search.population_size
    genes = {"parent", *(gene.name for gene in GENES)}
    assert set(history) == set(history_units(search)) | genes
    assert {len(column) for column in history.values()} == {n}
    np.testing.assert_array_equal(history["identity"], np.arange(n))
    np.testing.assert_array_equal(history["generation"], np.repeat(np.arange(N_GENERATIONS), search.population_size))
    designs = Designs.from_arrays(history)
    check(designs)
    again = long_and_fast(designs)
    for name in ("fitness", "displacement", "com_displacement"):
        np.testing.assert_array_equal(history[name], getattr(again, name))
    # What the search keeps are rows of it, the best among them.
    assert designs[population.identity] == population.designs
    np.testing.assert_array_equal(history["fitness"][population.identity], population.fitness)
    assert history["survived"][population.identity].all()
    assert population.fitness[population.champion()] == history["fitness"].max()
    # Parents were evaluated before and had survived.
    assert set(history["operator"]) <= set(range(len(search.operators)))
    child, place = np.nonzero(history["parents"] >= 0)
    parent = history["parents"][child, place]
    assert (history["generation"][parent] < history["generation"][child]).all()
    assert history["survived"][parent].all() and np.isfinite(history["fitness"][parent]).all()


def test_ages_and_parents() -> None:
    population, history = run([N_GENERATIONS], Afpo(population_size=12))
    n_parents = (history["parents"] >= 0).sum(axis=1)
    np.testing.assert_array_equal(n_parents, np.array([0, 1, 2])[history["operator"]])
    # A line of descent is as old as the generations since its oldest ancestor.
    ages = history["age"] - history["generation"]
    mutant = history["operator"] == MUTATION
    np.testing.assert_array_equal(ages[mutant], ages[history["parents"][mutant, 0]])
    cross = history["operator"] == CROSSOVER
    np.testing.assert_array_equal(ages[cross], ages[history["parents"][cross]].max(axis=1))
    assert (history["age"][history["operator"] == RANDOM] == 0).all()
    # Survivors have grown older by a generation since each that they lived through.
    lived = N_GENERATIONS - history["generation"][population.identity]
    np.testing.assert_array_equal(population.extra["age"], history["age"][population.identity] + lived)


def test_batched_trials_equal_each_alone(search: Optimiser) -> None:
    """One begins, one goes on, one has a body that stays; and all designs of a generation are evaluated at once."""
    n_at_once = []

    def score(designs: Designs) -> Evaluation:
        n_at_once.append(len(designs))
        return long_and_fast(designs)

    started, _ = run([3], search)
    body = random_designs(1, np.random.default_rng(2))
    trials = [Trial(of_another), Trial(of_trial, started), Trial(of_trial, body=body)]
    together = evolve(trials, score, first_generation=3, n_generations=5, search=search)
    assert n_at_once == [3 * search.population_size] * 5
    for trial, batched in zip(trials, together, strict=True):
        (alone,) = evolve([trial], long_and_fast, first_generation=3, n_generations=5, search=search)
        assert_same(batched, alone)


def test_after_a_generation_that_diverged_throughout_a_search_starts_again(search: Optimiser) -> None:
    def diverge(designs: Designs) -> Evaluation:
        nan = np.full((len(designs), 1), np.nan)
        return Evaluation(np.full(len(designs), -np.inf), nan, nan, nan)

    empty, _ = run([1], search, score=diverge)
    assert len(empty.designs) == 0
    ((_, history),) = evolve(
        [Trial(of_trial, empty)], long_and_fast, first_generation=1, n_generations=2, search=search
    )
    assert not history["operator"][:12].any()
    np.testing.assert_array_equal(history["identity"], np.arange(12, 36))


@pytest.mark.parametrize("frozen", [False, True])
def test_every_design_of_a_trial_keeps_to_its_morphology(search: Optimiser, frozen: bool) -> None:
    buildable = Morphology(n_actuated=2, unjoined_links="apart")
    body = random_designs(1, np.random.default_rng(6), morphology=buildable) if frozen else None
    _, history = run([12], search, body=body, morphology=buildable)
    designs = Designs.from_arrays(history)
    check(designs)
    assert links_apart(designs).all() and (designs.motor_on.sum(axis=1) == 2).all()
    random = history["operator"] == RANDOM
    if body is None:
        assert history["n_draws"][random].mean() > 100  # 1,100 on average
        assert history["n_draws"][~random].mean() < 10
    else:
        # A controller that evolves anew keeps the body's motors, and there is nothing to draw again.
        for name in ("parent", "motor_on", *(gene.name for gene in GENES if gene.part == "body")):
            assert (history[name] == getattr(body, name)).all(), name
        assert (history["n_draws"] == 1).all()
        assert len(np.unique(designs.frequency)) > 24


def test_gaits_are_within_a_morphology_that_limits_them(search: Optimiser) -> None:
    slow = Morphology(max_joint_speed=0.5)
    _, history = run([12], search, morphology=slow)
    assert slow.allows(Designs.from_arrays(history)).all()
    assert history["n_draws"].max() > 1
