"""Randomised Slush: how its members are drawn, and that each of them is a slush like any other."""

import math
import re

import numpy as np
import pytest

from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.world import RandomisedSlush, RandomisedSlushes, Slush, TrueSlush

PARAMETERS = ("density", "linear_drag", "angular_drag")


def drawn(**settings) -> tuple[Slush, ...]:
    return RandomisedSlushes(**{"seed": 1, **settings}).slushes()


def test_a_member_depends_on_the_seed_and_its_number_alone() -> None:
    assert drawn() == drawn() and drawn(n_members=3) == drawn()[:3]
    assert not set(drawn(seed=2)) & set(drawn())
    assert len(set(drawn())) == 8


def test_a_study_s_seed_is_used_unless_another_is_stated() -> None:
    assert RandomisedSlushes().of_study(7).slushes() == drawn(seed=7)
    assert RandomisedSlushes(seed=3).of_study(7).slushes() == drawn(seed=3)
    with pytest.raises(ValueError, match=re.escape("randomised_slush.seed is null, expected the seed of a study")):
        RandomisedSlushes().slushes()


def test_parameters_fill_their_ranges() -> None:
    """A uniform number lies in each third of its range in a third of the cases: 21 ± 4 of 64."""
    ranges = {name: getattr(RandomisedSlushes(), name) for name in PARAMETERS}
    members = drawn(n_members=64)
    for name, (least, greatest) in ranges.items():
        scale = float if name == "density" else math.log
        share = [(scale(getattr(of, name)) - scale(least)) / (scale(greatest) - scale(least)) for of in members]
        counts, _ = np.histogram(share, bins=3, range=(0, 1))
        assert counts.sum() == 64 and counts.min() >= 9, name


@pytest.mark.parametrize("engine", ["batch", "reference"])
def test_every_member_s_rollouts_are_those_of_its_slush(engine: str) -> None:
    designs = random_designs(5, np.random.default_rng(1))
    environment = RandomisedSlush(1.0, RandomisedSlushes(n_members=3, seed=1))
    assert environment.is_ensemble and environment.n_members == 3
    ours = simulate(designs, environment, n_settle=30, n_measure=90, engine=engine, trace=True)
    assert ours.displacement.shape == ours.com_displacement.shape == ours.status.shape == (3, 5)
    assert ours.trace is not None and len({tuple(row) for row in ours.displacement.tolist()}) == 3
    for k, slush in enumerate(environment.random.slushes()):
        for other in ("batch", "reference"):
            own = simulate(designs, TrueSlush(1.0, slush), n_settle=30, n_measure=90, engine=other, trace=True)
            np.testing.assert_array_equal(ours.displacement[k], own.displacement)
            np.testing.assert_array_equal(ours.com_displacement[k], own.com_displacement)
            np.testing.assert_array_equal(ours.trace[k], own.trace)
