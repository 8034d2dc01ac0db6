"""Random designs, mutation and crossover: valid whatever the draw, and in the shares that science.md states."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from varied_designs import BODY, NO_REWIRING, binomial_interval, canonical, is_canonical, mutations, numbers, seeds

from tasks.design import GENES, N_LINKS, Designs, LinkLimits, Morphology, Mutation, check, random_designs
from tasks.design.genes import N_GENES
from tasks.design.variation import crossover, jittered, mutate
from tasks.simulation import simulate

sizes = st.integers(0, 40)


def at_bounds(rng: np.random.Generator, n_designs: int) -> Designs:
    """Designs all of whose numbers sit on one of their bounds."""
    designs = random_designs(n_designs, rng)
    pushed = {
        gene.name: np.where(rng.random(getattr(designs, gene.name).shape) < 0.5, gene.low, gene.high)
        for gene in GENES
        if gene.kind != "flag"
    }
    return canonical(replace(designs, **pushed))


@pytest.mark.parametrize("parts", [(), ("controller",), ("Body", "control")])
def test_parts_that_do_not_exist_are_refused(parts):
    with pytest.raises(ValueError, match="parts: expected body, control or both, got"):
        mutate(random_designs(2, np.random.default_rng(0)), np.random.default_rng(1), parts=parts)


@pytest.mark.parametrize("n", [0, 3])
def test_a_body_is_that_of_one_design(n):
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match=f"body: expected one design, got {n}"):
        random_designs(2, rng, body=random_designs(4, rng)[:n])


@pytest.mark.parametrize("parts", [("body", "control"), ("control",)])
@given(seed=seeds, n_designs=sizes, mutation=mutations, edge=st.booleans())
def test_mutants_are_valid_and_differ(seed: int, n_designs: int, mutation: Mutation, edge: bool, parts) -> None:
    rng = np.random.default_rng(seed)
    drawn = random_designs(n_designs, rng)
    check(drawn)
    assert is_canonical(drawn) and len(drawn) == n_designs
    parents = at_bounds(rng, n_designs) if edge else drawn
    before = parents.table.copy()
    mutants = mutate(parents, rng, mutation=mutation, parts=parts)
    check(mutants)
    assert is_canonical(mutants) and (parents.table == before).all()
    assert (numbers(mutants) != numbers(parents)).any(axis=1).all()
    for name in BODY if parts == ("control",) else ():
        np.testing.assert_array_equal(getattr(mutants, name), getattr(parents, name))


def test_random_genes_are_uniform_motors_on_half_the_time_and_parents_any_link_before() -> None:
    designs = random_designs(6000, np.random.default_rng(11))
    for gene in GENES:
        drawn = getattr(designs, gene.name)
        drawn = drawn[:, int(not gene.of_root) :] if gene.per_link else drawn
        if gene.kind != "flag":
            # The seed is fixed, so this passes or fails for good; a true uniform fails for one seed in a thousand.
            uniform = stats.uniform(gene.low, gene.high - gene.low)
            assert stats.kstest(drawn.ravel(), uniform.cdf).pvalue > 1e-3, gene.name
        else:
            low, high = binomial_interval(drawn.size, 0.5)
            assert low <= drawn.sum() <= high
    for link in range(1, N_LINKS):
        counts = np.bincount(designs.parent[:, link], minlength=link)
        low, high = binomial_interval(6000, 1 / link)
        assert counts.size == link and ((counts >= low) & (counts <= high)).all()


def test_three_genes_change_on_average() -> None:
    rng = np.random.default_rng(15)
    n_designs = 6000
    parents = random_designs(n_designs, rng)
    changed = numbers(mutate(parents, rng, mutation=NO_REWIRING)) != numbers(parents)
    # Each gene is drawn with p = 3/37; designs of which none is drawn, a share (1 - p)^37, get one more. A gene in
    # the middle of its range always moves, and one near a bound is held by it only when it sits on it exactly.
    p = 3 / N_GENES
    per_design = changed.sum(axis=1)
    expected = 3 + (1 - p) ** N_GENES
    deviation = np.sqrt(N_GENES * p * (1 - p) / n_designs)
    assert abs(per_design.mean() - expected) < 5 * deviation
    # Every gene alike: p, and its share of the additional ones.
    low, high = binomial_interval(n_designs, expected / N_GENES)
    counts = changed.sum(axis=0)
    assert ((counts >= low) & (counts <= high)).all()


def test_an_interval_takes_a_gaussian_step_of_a_tenth_of_its_range() -> None:
    rng = np.random.default_rng(16)
    middle = random_designs(20_000, rng)
    middle = replace(middle, length_scale=np.full_like(middle.length_scale, 2.0))
    steps = mutate(middle, rng, mutation=NO_REWIRING).length_scale - 2.0
    steps = steps[steps != 0]  # the clip at ±1 m lies 5 deviations away
    assert steps.size > 5000
    assert stats.kstest(steps, stats.norm(0, 0.1 * (3.0 - 1.0)).cdf).pvalue > 1e-3


def test_angles_wrap_around() -> None:
    rng = np.random.default_rng(17)
    designs = random_designs(20_000, rng)
    designs = canonical(replace(designs, phase=np.full_like(designs.phase, 0.01)))
    phase = mutate(designs, rng, mutation=NO_REWIRING).phase[:, 1:]
    moved = phase[phase != 0.01]
    assert (moved != 0).all()  # nothing is caught at the bound
    signed = (moved - 0.01 + np.pi) % (2 * np.pi) - np.pi
    assert stats.kstest(signed, stats.norm(0, 0.1 * 2 * np.pi).cdf).pvalue > 1e-3


def test_a_mutant_is_rewired_once_in_twenty_and_never_to_the_same_parent() -> None:
    rng = np.random.default_rng(18)
    parents = random_designs(20_000, rng)
    rewired = mutate(parents, rng).parent != parents.parent
    assert rewired.sum(axis=1).max() == 1  # one link
    low, high = binomial_interval(20_000, 0.05)  # so that each of the draws hangs the link elsewhere
    assert low <= rewired.sum() <= high
    assert not rewired[:, :2].any()  # link 1 has no other parent than the root
    counts = rewired[:, 2:].sum(axis=0)
    low, high = binomial_interval(int(rewired.sum()), 1 / (N_LINKS - 2))
    assert ((counts >= low) & (counts <= high)).all()


def test_a_child_takes_whole_links_from_one_or_the_other() -> None:
    rng = np.random.default_rng(20)
    n_designs = 4000
    one, other = (
        canonical(replace(random_designs(n_designs, rng), motor_on=np.full((n_designs, N_LINKS), on)))
        for on in (True, False)
    )
    child = crossover(one, other, rng)
    per_link = ["parent", *(gene.name for gene in GENES if gene.per_link)]

    def whole(donor: Designs) -> np.ndarray:
        """Links all of whose genes are the donor's, the parent among them."""
        return np.all([getattr(child, name) == getattr(donor, name) for name in per_link], axis=0)

    from_one, from_other = whole(one), whole(other)
    assert (from_one ^ from_other).all()
    assert from_one.any(axis=1).all() and from_other.any(axis=1).all()  # both donors are used in every child
    low, high = binomial_interval(n_designs, 0.5)
    counts = from_one.sum(axis=0)
    assert ((counts >= low) & (counts <= high)).all()
    frequency_from_one = child.frequency == one.frequency
    assert (frequency_from_one | (child.frequency == other.frequency)).all()
    assert low <= frequency_from_one.sum() <= high


@given(n=sizes, seed=seeds)
def test_jitter_moves_every_joint_by_its_shift_and_none_out_of_bounds(n: int, seed: int) -> None:
    designs = at_bounds(np.random.default_rng(seed), n)
    moved = jittered(designs, np.random.default_rng(seed), {"child_attachment": 0.1, "rest_angle": 0.01})
    check(moved)
    for name, array in designs.arrays():
        shift = np.abs(getattr(moved, name).astype(float) - array)
        expected = {"child_attachment": 0.1, "rest_angle": 0.01}.get(name, 0.0)
        np.testing.assert_allclose(shift[:, 1:] if array.ndim == 2 else shift, expected, atol=1e-12)
        assert array.ndim == 1 or not shift[:, 0].any()


@pytest.mark.parametrize("n_actuated", [None, 1])
@pytest.mark.parametrize("controller", ["open_loop", "reflex"])
def test_designs_of_2_to_12_links_vary_within_their_limits(n_actuated: int | None, controller: str) -> None:
    rng = np.random.default_rng(5)
    morphology = Morphology(n_links=LinkLimits(least=2, most=12), n_actuated=n_actuated)
    designs = random_designs(200, rng, morphology=morphology, controller=controller)
    assert set(designs.n_links) == set(range(2, 13))
    changed = mutate(designs, rng, morphology=morphology, mutation=Mutation(resizing=1.0))
    crossed = crossover(changed, changed[::-1], rng, morphology=morphology)
    for varied in (designs, changed, crossed):
        check(varied)
        assert n_actuated is None or (varied.motor_on.sum(axis=1) == n_actuated).all()
    steps = changed.n_links - designs.n_links
    inner = (designs.n_links > 2) & (designs.n_links < 12)
    assert set(steps[inner]) == {-1, 1} and steps[designs.n_links == 2].min() == 0 == steps[designs.n_links == 12].max()
    parents = np.stack((changed.n_links, changed.n_links[::-1]))
    assert (crossed.n_links == parents).any(axis=0).all() and (crossed.n_links != parents).any(axis=1).all()
    assert len(mutate(designs, rng)) == 200 and (mutate(designs, rng).n_links == designs.n_links).all()


def test_designs_of_all_sizes_are_simulated_as_if_alone() -> None:
    rng = np.random.default_rng(6)
    designs = random_designs(6, rng, morphology=Morphology(n_links=LinkLimits(least=2, most=9)))
    together = simulate(designs, "dry_land", n_settle=2, n_measure=8, trace=True)
    for k in range(len(designs)):
        alone = simulate(designs[k], "dry_land", n_settle=2, n_measure=8, trace=True)
        assert alone.trace.shape == (1, 10, designs.n_links[k], 6) and alone.displacement == together.displacement[k]
        np.testing.assert_array_equal(alone.trace[0], together.trace[k, :, : designs.n_links[k]])
        assert np.isnan(together.trace[k, :, designs.n_links[k] :]).all()
