"""Random designs, mutation and crossover: valid whatever the draw, and in the shares that science.md states."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import stats

from tasks.design import (
    GENES,
    N_LINKS,
    Designs,
    Morphology,
    Mutation,
    check,
    crossover,
    draw_random,
    draw_recombinations,
    links_apart,
    mutate,
    random_designs,
)
from tasks.design.genes import N_GENES, Gene, concatenate
from tasks.design.variation import MAX_RECOMBINATIONS

seeds = st.integers(0, 2**63 - 1)
sizes = st.integers(0, 40)
mutations = st.builds(
    Mutation,
    genes_changed=st.floats(0, 37),
    step=st.floats(1e-3, 1.0),
    rewiring=st.floats(0, 1),
)

BODY = ("parent", *(gene.name for gene in GENES if gene.part == "body"))
CONTROL = tuple(gene.name for gene in GENES if gene.part == "control")
NO_REWIRING = Mutation(rewiring=0.0)


def copy(designs: Designs) -> Designs:
    return Designs(**{name: array.copy() for name, array in designs.arrays()})


def canonical(designs: Designs) -> Designs:
    """Zero what a root ignores, so that designs that behave alike are equal."""
    cleared = {gene.name: getattr(designs, gene.name).copy() for gene in GENES if not gene.of_root}
    for array in cleared.values():
        array[:, 0] = 0
    return replace(designs, **cleared)


def is_canonical(designs: Designs) -> bool:
    return canonical(designs).equals(designs)


def numbers(designs: Designs) -> np.ndarray:
    """The 37 numbers of each design."""
    blocks = [getattr(designs, gene.name) for gene in GENES]
    blocks = [
        block[:, gene.first_link :] if gene.per_link else block[:, None]
        for gene, block in zip(GENES, blocks, strict=True)
    ]
    return np.concatenate(blocks, axis=1).astype(np.float64)


def at_bounds(rng: np.random.Generator, n_designs: int) -> Designs:
    """Designs all of whose numbers sit on one of their bounds."""
    designs = random_designs(n_designs, rng)
    pushed = {
        gene.name: np.where(rng.random(getattr(designs, gene.name).shape) < 0.5, gene.low, gene.high)
        for gene in GENES
        if gene.kind != "flag"
    }
    return canonical(replace(designs, **pushed))


def binomial_interval(n: int, p: float) -> tuple[float, float]:
    """Where a count of n draws of probability p falls but once in a million."""
    low, high = stats.binom.interval(1 - 1e-6, n, p)
    return float(low), float(high)


@given(seed=seeds, n_designs=sizes)
def test_random_designs_are_valid(seed: int, n_designs: int) -> None:
    designs = random_designs(n_designs, np.random.default_rng(seed))
    check(designs)
    assert len(designs) == n_designs
    assert is_canonical(designs)


@settings(deadline=None)
@given(seed=seeds, n_designs=sizes, mutation=mutations, edge=st.booleans())
def test_mutants_are_valid_and_differ(seed: int, n_designs: int, mutation: Mutation, edge: bool) -> None:
    rng = np.random.default_rng(seed)
    parents = at_bounds(rng, n_designs) if edge else random_designs(n_designs, rng)
    before = copy(parents)
    mutants = mutate(parents, rng, mutation=mutation)
    check(mutants)
    assert is_canonical(mutants)
    assert parents.equals(before)
    assert (numbers(mutants) != numbers(parents)).any(axis=1).all()


@settings(deadline=None)
@given(seed=seeds, n_designs=sizes, mutation=mutations, edge=st.booleans())
def test_mutants_of_control_keep_their_bodies(seed: int, n_designs: int, mutation: Mutation, edge: bool) -> None:
    rng = np.random.default_rng(seed)
    parents = at_bounds(rng, n_designs) if edge else random_designs(n_designs, rng)
    mutants = mutate(parents, rng, mutation=mutation, parts=("control",))
    check(mutants)
    for name in BODY:
        np.testing.assert_array_equal(getattr(mutants, name), getattr(parents, name))
    assert (numbers(mutants) != numbers(parents)).any(axis=1).all()


@settings(deadline=None)
@given(seed=seeds, n_designs=sizes)
def test_recombinations_are_valid(seed: int, n_designs: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = random_designs(n_designs, rng), random_designs(n_designs, rng)
    before = copy(one), copy(other)
    children = crossover(one, other, rng)
    check(children)
    assert is_canonical(children)
    assert one.equals(before[0])
    assert other.equals(before[1])


@given(seed=seeds)
def test_variation_depends_on_its_generator_alone(seed: int) -> None:
    def vary() -> Iterator[Designs]:
        rng = np.random.default_rng(seed)
        designs = random_designs(6, rng)
        yield designs
        yield mutate(designs, rng)
        yield crossover(designs[:3], designs[3:], rng)

    assert all(one.equals(other) for one, other in zip(vary(), vary(), strict=True))


@pytest.mark.parametrize("gene", [gene for gene in GENES if gene.kind != "flag"], ids=lambda gene: gene.name)
def test_random_genes_are_uniform(gene: Gene) -> None:
    designs = random_designs(4000, np.random.default_rng(11))
    drawn = getattr(designs, gene.name)
    drawn = drawn[:, gene.first_link :] if gene.per_link else drawn
    low, high = gene.low, gene.high
    # The seed is fixed, so this passes or fails for good; a true uniform fails for one seed in a thousand.
    assert stats.kstest(drawn.ravel(), stats.uniform(low, high - low).cdf).pvalue > 1e-3


def test_random_motors_are_on_half_the_time() -> None:
    on = random_designs(4000, np.random.default_rng(12)).motor_on[:, 1:]
    low, high = binomial_interval(on.size, 0.5)
    assert low <= on.sum() <= high


def test_random_parents_are_uniform_among_the_links_before() -> None:
    parent = random_designs(6000, np.random.default_rng(13)).parent
    for link in range(1, N_LINKS):
        counts = np.bincount(parent[:, link], minlength=link)
        assert counts.size == link
        low, high = binomial_interval(6000, 1 / link)
        assert ((counts >= low) & (counts <= high)).all()


def test_random_controllers_on_a_given_body() -> None:
    rng = np.random.default_rng(14)
    body = random_designs(1, rng)
    designs = random_designs(50, rng, body=body)
    check(designs)
    for name in BODY:
        np.testing.assert_array_equal(getattr(designs, name), np.repeat(getattr(body, name), 50, axis=0))
    assert len(np.unique(designs.frequency)) == 50
    assert len(np.unique(designs.phase[:, 1:])) == 250


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
    # Half of the steps lead below 0 and come back below 2π; nothing is caught at the bound.
    low, high = binomial_interval(moved.size, stats.norm.cdf(-0.01 / (0.1 * 2 * np.pi)))
    assert low <= (moved > np.pi).sum() <= high
    assert (moved != 0).all()
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


def test_a_rewired_link_is_hung_from_any_other_link_before_it_alike() -> None:
    rng = np.random.default_rng(19)
    parents = random_designs(20_000, rng)
    parents = replace(parents, parent=np.tile([-1, 0, 1, 1, 1, 1], (20_000, 1)))
    after = mutate(parents, rng, mutation=Mutation(rewiring=1.0)).parent
    assert ((after != parents.parent).sum(axis=1) == 1).all()
    for link in range(2, N_LINKS):
        new = after[after[:, link] != 1, link]
        counts = np.bincount(new, minlength=link)
        assert counts[1] == 0
        low, high = binomial_interval(new.size, 1 / (link - 1))
        assert ((np.delete(counts, 1) >= low) & (np.delete(counts, 1) <= high)).all()


def test_a_child_takes_whole_links_from_one_or_the_other() -> None:
    rng = np.random.default_rng(20)
    n_designs = 4000
    one, other = (
        canonical(replace(random_designs(n_designs, rng), motor_on=np.full((n_designs, N_LINKS), on)))
        for on in (True, False)
    )
    child = crossover(one, other, rng)
    per_link = [name for name in (*BODY, *CONTROL) if name != "frequency"]

    def whole(donor: Designs) -> np.ndarray:
        """Links all of whose genes are the donor's, the parent among them."""
        return np.all([getattr(child, name) == getattr(donor, name) for name in per_link], axis=0)

    from_one, from_other = whole(one), whole(other)
    assert (from_one ^ from_other).all()
    assert from_one.any(axis=1).all()  # both donors are used in every child
    assert from_other.any(axis=1).all()
    low, high = binomial_interval(n_designs, 0.5)
    counts = from_one.sum(axis=0)
    assert ((counts >= low) & (counts <= high)).all()
    frequency_from_one = child.frequency == one.frequency
    assert (frequency_from_one | (child.frequency == other.frequency)).all()
    assert low <= frequency_from_one.sum() <= high


@pytest.mark.parametrize(
    "setting", [{"genes_changed": -1}, {"genes_changed": 38}, {"step": 0}, {"rewiring": 1.1}, {"rewire": 0.1}]
)
def test_impossible_rates_are_refused_by_name(setting: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=next(iter(setting))):
        Mutation(**setting)


# -- designs that can be built -----------------------------------------------------------------------------------------

BUILDABLE = Morphology(n_actuated=2, unjoined_links="apart")


def keeps_to_it(designs: Designs) -> bool:
    check(designs)
    return bool(is_canonical(designs) and links_apart(designs).all() and (designs.motor_on.sum(axis=1) == 2).all())


@pytest.fixture(scope="module")
def buildable() -> Designs:
    return random_designs(48, np.random.default_rng(21), morphology=BUILDABLE)


@settings(deadline=None, max_examples=15)
@given(seed=seeds, mutation=mutations)
def test_every_operator_keeps_to_the_morphology(buildable: Designs, seed: int, mutation: Mutation) -> None:
    rng = np.random.default_rng(seed)
    parents = buildable[rng.permutation(48)[:12]]
    assert keeps_to_it(mutate(parents, rng, mutation=mutation, morphology=BUILDABLE))
    assert keeps_to_it(crossover(parents[:6], parents[6:], rng, morphology=BUILDABLE))
    assert keeps_to_it(random_designs(2, rng, morphology=BUILDABLE))


def test_a_thousand_mutations_in_a_row_keep_to_the_morphology(buildable: Designs) -> None:
    rng = np.random.default_rng(22)
    line = buildable[:4]
    motors, trees = set(), set()
    for _ in range(1000):
        line = mutate(line, rng, morphology=BUILDABLE)
        motors |= {tuple(row) for row in line.motor_on.tolist()}
        trees |= {tuple(row) for row in line.parent.tolist()}
    assert keeps_to_it(line)
    assert len(motors) == 10  # every pair of five joints has been actuated, so nothing is stuck
    assert len(trees) > 20


def test_random_bodies_are_distributed_as_those_of_plain_draws_that_happen_to_be_apart() -> None:
    rng = np.random.default_rng(23)
    plain = concatenate([random_designs(40_000, rng) for _ in range(10)])
    plain = plain[links_apart(plain)]
    drawn = random_designs(400, rng, morphology=BUILDABLE)
    assert len(plain) > 200
    for name in ("length_scale", "rest_angle", "parent_attachment", "child_attachment", "phase"):
        for link in range(1, N_LINKS):
            two = (getattr(of, name)[:, link] for of in (plain, drawn))
            # 25 comparisons with fixed seeds: true equals fail one of them for one seed in a thousand.
            assert stats.ks_2samp(*two).pvalue > 1e-3 / 25, (name, link)


def test_every_pair_of_joints_is_actuated_alike() -> None:
    designs = random_designs(10_000, np.random.default_rng(24), morphology=Morphology(n_actuated=2))
    codes, counts = np.unique(designs.motor_on @ (1 << np.arange(N_LINKS)), return_counts=True)
    assert len(codes) == 10
    low, high = binomial_interval(10_000, 1 / 10)
    assert ((counts >= low) & (counts <= high)).all()


def test_a_motor_moves_to_any_other_joint_alike() -> None:
    designs = random_designs(40_000, np.random.default_rng(25), morphology=Morphology(n_actuated=2))
    designs = replace(designs, motor_on=np.tile([False, True, True, False, False, False], (40_000, 1)))
    after = mutate(designs, np.random.default_rng(26), mutation=NO_REWIRING, morphology=Morphology(n_actuated=2))
    assert (after.motor_on.sum(axis=1) == 2).all()
    moved = after[(after.motor_on != designs.motor_on).sum(axis=1) == 2].motor_on
    p = 3 / N_GENES  # each of the five flags is drawn so often; two that are drawn may undo each other
    assert 0.9 * 5 * p * (1 - p) ** 4 < len(moved) / 40_000 < 5 * p * 1.2
    # It left either of its joints, and came to any of the three others, alike.
    for joints, share in (((1, 2), 1 / 2), ((3, 4, 5), 1 / 3)):
        low, high = binomial_interval(len(moved), share)
        for joint in joints:
            assert low <= moved[:, joint].sum() <= high


@pytest.mark.parametrize("n_actuated", [0, 5])
def test_where_no_motor_can_move_something_else_changes(n_actuated: int) -> None:
    morphology = Morphology(n_actuated=n_actuated)
    designs = random_designs(500, np.random.default_rng(27), morphology=morphology)
    after = mutate(designs, np.random.default_rng(28), mutation=Mutation(genes_changed=0), morphology=morphology)
    np.testing.assert_array_equal(after.motor_on, designs.motor_on)
    assert ((numbers(after) != numbers(designs)).any(axis=1)).all()


def test_controllers_of_built_bodies_vary_and_their_motors_stay(buildable: Designs) -> None:
    rng = np.random.default_rng(29)
    body = buildable[:1]
    controllers = random_designs(40, rng, body=body, morphology=BUILDABLE)
    mutants = mutate(controllers, rng, parts=("control",), morphology=BUILDABLE)
    children = crossover(mutants[:20], mutants[20:], rng, morphology=BUILDABLE)
    for designs in (controllers, mutants, children):
        assert keeps_to_it(designs)
        for name in (*BODY, "motor_on"):
            array = getattr(designs, name)
            np.testing.assert_array_equal(array, np.repeat(getattr(body, name), len(array), axis=0))
        assert len(np.unique(designs.frequency)) == len(designs)
    assert (numbers(mutants) != numbers(controllers)).any(axis=1).all()


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


def test_parents_without_a_common_child_give_the_body_of_one_and_the_controller_of_the_other(
    buildable: Designs,
) -> None:
    # A pair whose recombinations all overlap: found by asking for those that came to their last draw.
    rng = np.random.default_rng(31)
    pairs = rng.permuted(np.tile(np.arange(48), (60, 1)), axis=1)[:, :2]
    one, other = buildable[pairs[:, 0]], buildable[pairs[:, 1]]
    drawn = draw_recombinations(one.table, other.table, rng, morphology=BUILDABLE)
    assert keeps_to_it(drawn.designs)
    hopeless = drawn.n_draws > MAX_RECOMBINATIONS
    assert hopeless.any()
    for name in (*BODY, "motor_on"):
        np.testing.assert_array_equal(getattr(drawn.designs, name)[hopeless], getattr(one, name)[hopeless])
    for name in ("phase", "motion_range", "frequency"):
        np.testing.assert_array_equal(getattr(drawn.designs, name)[hopeless], getattr(other, name)[hopeless])


def test_draws_are_counted() -> None:
    wanted = np.array([True, False, True, False])
    drawn = draw_random(wanted, np.random.default_rng(32), morphology=BUILDABLE)
    assert links_apart(drawn.designs)[wanted].all()
    # About one random design in 1,100 is apart: one that is found within three draws is a matter of 0.3 %.
    assert (drawn.n_draws[wanted] > 3).all()
    assert (drawn.n_draws[~wanted] == 1).all()
