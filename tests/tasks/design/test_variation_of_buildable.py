"""Variation of designs that can be built: every operator keeps to the morphology and prefers nothing within it."""

import numpy as np
import pytest
from hypothesis import given, settings
from varied_designs import BODY, binomial_interval, is_canonical, mutations, seeds

from tasks.design import DesignError, Designs, Morphology, Mutation, check, crossover, mutate, random_designs, variation
from tasks.design.variation import MAX_DRAWS, Sampler, variation_of

BUILDABLE = Morphology(n_actuated=2, unjoined_links="apart")
IN_GAIT = Morphology(n_actuated=2, unjoined_links="apart_in_gait", max_joint_speed=1.0)


def keeps_to(morphology: Morphology, designs: Designs) -> bool:
    check(designs)
    motors = designs.motor_on.sum(axis=1)
    return bool(is_canonical(designs) and morphology.allows(designs).all() and (motors == 2).all())


@pytest.fixture(scope="module")
def buildable() -> Designs:
    return random_designs(48, np.random.default_rng(21), morphology=BUILDABLE)


@pytest.fixture(scope="module")
def apart_in_gait() -> Designs:
    return random_designs(24, np.random.default_rng(23), morphology=IN_GAIT)


@settings(max_examples=10)
@given(seed=seeds, mutation=mutations.map(lambda m: m.model_copy(update={"rewiring": 0.9 * m.rewiring})))
def test_every_operator_keeps_to_the_morphology(buildable, apart_in_gait, seed: int, mutation: Mutation) -> None:
    """A mutation that always rewires may find no place for any link: see the next test."""
    rng = np.random.default_rng(seed)
    for morphology, designs, chosen in ((BUILDABLE, buildable, mutation), (IN_GAIT, apart_in_gait, Mutation())):
        parents = designs[rng.permutation(24)[:12]]
        assert keeps_to(morphology, mutate(parents, rng, mutation=chosen, morphology=morphology))
        assert keeps_to(morphology, crossover(parents[:6], parents[6:], rng, morphology=morphology))
        controllers = mutate(parents, rng, parts=("control",), morphology=morphology)
        anew = random_designs(6, rng, body=parents[:1], morphology=morphology)
        assert keeps_to(morphology, controllers) and keeps_to(morphology, anew)
        assert (anew.rest_angle == parents.rest_angle[0]).all()
        assert (anew.phase[:, 1:] != parents.phase[0, 1:]).all()


def test_a_parent_without_a_mutant_is_named(buildable: Designs) -> None:
    """Wherever one of its links is hung, links that no joint ties overlap."""
    rng = np.random.default_rng(0)
    parents = buildable[rng.permutation(48)[8:10]]
    only_rewired = Mutation(genes_changed=0.0, step=0.001, rewiring=1.0)
    mutate(parents[:1], rng, mutation=only_rewired, morphology=BUILDABLE)
    with pytest.raises(DesignError, match=f"design 1: {MAX_DRAWS:,} samples were drawn and none is allowed"):
        mutate(parents, rng, mutation=only_rewired, morphology=BUILDABLE)


def test_a_joint_that_both_parents_actuate_is_actuated_in_their_child() -> None:
    rng = np.random.default_rng(30)
    morphology = Morphology(n_actuated=3)
    one, other = (random_designs(4000, rng, morphology=morphology) for _ in range(2))
    child = crossover(one, other, rng, morphology=morphology)
    both, either = one.motor_on & other.motor_on, one.motor_on | other.motor_on
    assert (child.motor_on.sum(axis=1) == 3).all()
    assert (child.motor_on | ~both).all()
    assert (either | ~child.motor_on).all()
    # Neither parent is preferred.
    lone = one.motor_on ^ other.motor_on
    low, high = binomial_interval(int((child.motor_on & lone).sum()), 0.5)
    assert low <= (child.motor_on & lone & one.motor_on).sum() <= high


def test_a_child_that_no_draw_allows_has_the_body_of_one_and_the_controller_of_the_other(
    buildable, monkeypatch
) -> None:
    monkeypatch.setattr(variation, "MAX_RECOMBINATIONS", 1)
    one, other = buildable[:24], buildable[24:]
    sampler = Sampler(np.random.default_rng(31), variation_of(BUILDABLE), BUILDABLE)
    drawn = sampler.recombinations((one.table, other.table))
    fallen_back = drawn.n_draws > 1
    assert fallen_back.any()
    for name, array in drawn.designs[fallen_back].arrays():
        donor = one if name in (*BODY, "motor_on") else other
        np.testing.assert_array_equal(array, getattr(donor[fallen_back], name), err_msg=name)
