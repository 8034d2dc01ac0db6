"""Age-fitness Pareto optimisation: selection, shares of children, tournaments."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from varied_designs import binomial_interval

from tasks.design import random_designs
from tasks.evolution import Afpo, Population, select


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def population_of(n: int) -> Population:
    """A population of different ages, with identities that tell one from another."""
    draw = rng(0)
    return Population(
        table=random_designs(n, draw).table.copy(),
        fitness=draw.normal(size=n),
        identity=np.arange(100, 100 + n),
        n_evaluated=100 + n,
        extra={"age": draw.permutation(np.arange(1, n + 1))},
    )


# Selection. Non-dominated: no design of its age or younger has a higher fitness.


def test_the_dominated_are_sampled_alike_and_without_replacement() -> None:
    fitness, age = np.array([9.0, 1.0, 2.0, 3.0, 4.0]), np.array([0, 1, 1, 5, 9])
    draws = [select(fitness, age, rng(seed), 3).tolist() for seed in range(3000)]
    assert all(survivors[0] == 0 and len(set(survivors)) == 3 for survivors in draws)
    counts = np.bincount(np.array(draws)[:, 1:].ravel(), minlength=5)[1:]
    low, high = binomial_interval(3000, 2 / 4)
    assert ((counts >= low) & (counts <= high)).all()


numbers = st.one_of(st.integers(-3, 3).map(float), st.sampled_from([np.nan, np.inf, -np.inf]))


@given(st.lists(st.tuples(numbers, st.integers(0, 3)), max_size=30))
def test_selection_agrees_with_the_definition(designs: list[tuple[float, int]]) -> None:
    fitness, age = np.array([one[0] for one in designs], float), np.array([one[1] for one in designs], np.int64)
    survivors = select(fitness, age, rng(len(designs)), len(designs)).tolist()
    finite = [index for index in range(len(designs)) if np.isfinite(fitness[index])]
    dominated = {one for one in finite if any(age[by] <= age[one] and fitness[by] > fitness[one] for by in finite)}
    front = sorted(set(finite) - dominated, key=lambda index: (-fitness[index], index))
    assert survivors[: len(front)] == front
    assert sorted(survivors[len(front) :]) == sorted(dominated)


def test_shares_of_children() -> None:
    afpo, population, draw = Afpo(), population_of(64), rng(1)
    operators = np.concatenate([afpo.ask(population, draw).operator for _ in range(150)])
    for operator, share in enumerate((0.15, 0.65, 0.20)):
        low, high = binomial_interval(operators.size, share)
        assert low <= (operators == operator).sum() <= high


def test_the_fitter_of_two_is_a_parent_in_tournaments() -> None:
    afpo, population, draw = Afpo(parent_selection="tournament"), population_of(8), rng(12)
    parents = np.concatenate([afpo.ask(population, draw).parents for _ in range(1500)])
    first = parents[parents[:, 0] >= 0, 0]
    # The design of rank r, 0 for the fittest of 8, is not in a draw of two with all the fitter ones left out ...
    rank = np.argsort(np.argsort(-population.fitness))
    expected = ((8 - rank) ** 2 - (7 - rank) ** 2) / 64  # ... so it wins with P(both ≥ r) - P(both > r)
    for share, count in zip(expected, np.bincount(first - 100, minlength=8), strict=True):
        low, high = binomial_interval(first.size, share)
        assert low <= count <= high


def test_the_champion_is_the_fittest_and_the_first_of_several() -> None:
    population = population_of(4)._replace(fitness=np.array([1.0, 3.0, 3.0, 2.0]))
    assert population.champion() == 1
