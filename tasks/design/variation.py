"""Variation: random designs, mutated copies and recombinations. Paper, "Evolutionary Design".

Every function takes valid designs and a generator and gives valid designs. With ``body`` given, the bodies stay as they
are and the controllers alone vary: that is the paper's controller adaptation.

A morphology that asks for something makes operators draw again what it refuses. The functions whose names begin with
``draw`` tell how often, too.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.random import Generator
from pydantic import Field

from tasks.design.genes import GENES, N_GENES, N_LINKS, ROOT_PARENT, Designs, Gene, Part
from tasks.design.morphology import ANY_BODY, Drawn, Floats, Ints, Morphology, until_apart
from tasks.parameters import Parameters


class Mutation(Parameters):
    """How far and how often a mutant departs from its parent."""

    genes_changed: float = Field(default=3.0, ge=0.0, le=37.0)
    """Genes that change on average, of the 37 of a whole design."""
    step: float = Field(default=0.1, gt=0.0, le=1.0)
    """Deviation of the Gaussian step, as a share of the gene's range. 0.2 is faster over few generations."""
    rewiring: float = Field(default=0.05, ge=0.0, le=1.0)
    """Probability that one link of a mutant is hung from another parent."""


MUTATION = Mutation()


def random_designs(
    n_designs: int, rng: Generator, *, body: Designs | None = None, morphology: Morphology = ANY_BODY
) -> Designs:
    """Draw designs uniformly within the genes' bounds; a motor is on with probability 1/2.

    Args:
        n_designs: how many.
        rng: source of randomness.
        body: one design whose body all get; only their controllers are drawn then.
        morphology: what bodies keep to; they are uniform among those that do.

    Raises:
        DesignError: the morphology can't be satisfied.
    """
    return draw_random(np.ones(n_designs, dtype=bool), rng, body=body, morphology=morphology).designs


def draw_random(
    wanted: npt.NDArray[np.bool_], rng: Generator, *, body: Designs | None = None, morphology: Morphology = ANY_BODY
) -> Drawn:
    """Draw random designs as :func:`random_designs` does, and count the draws.

    Args:
        wanted: (n_designs,) which must keep to the morphology; the others are spared the draws that it may take.
        rng: source of randomness.
        body: one design whose body all get.
        morphology: what bodies keep to.
    """
    if body is not None or morphology.unjoined_links == "may_overlap":
        return _drawn_once(_random(len(wanted), rng, body, morphology))
    return until_apart(lambda which: _random(len(which), rng, body, morphology), wanted)


def _drawn_once(designs: Designs) -> Drawn:
    return Drawn(designs, np.ones(len(designs), dtype=np.int64))


def _random(n_designs: int, rng: Generator, body: Designs | None, morphology: Morphology) -> Designs:
    drawn: dict[str, npt.NDArray[Any]] = {gene.name: _draw(gene, n_designs, rng) for gene in GENES}
    parent = np.full((n_designs, N_LINKS), ROOT_PARENT, dtype=np.int64)
    for link in range(1, N_LINKS):
        parent[:, link] = rng.integers(0, link, n_designs)
    if morphology.n_actuated is not None:
        drawn["motor_on"][:, 1:] = _highest(rng.random((n_designs, N_LINKS - 1)), morphology.n_actuated)
    designs = Designs(parent=parent, **drawn)
    return designs if body is None else _with_body(designs, body, morphology)


def _draw(gene: Gene, n_designs: int, rng: Generator) -> npt.NDArray[Any]:
    shape = (n_designs, N_LINKS) if gene.per_link else (n_designs,)
    drawn = rng.random(shape) < 0.5 if gene.kind == "flag" else rng.uniform(gene.low, gene.high, shape)
    if not gene.of_root:
        drawn[:, 0] = 0  # so that designs that behave alike are equal
    return drawn


def _highest(score: Floats, n: int) -> npt.NDArray[np.bool_]:
    """Mark the n highest scores of each row."""
    rank = np.argsort(np.argsort(-score, axis=1, kind="stable"), axis=1, kind="stable")
    return np.asarray(rank < n)


def _part_of(gene: Gene, morphology: Morphology) -> Part:
    """Tell what a gene is of: with a given number of actuated joints, which they are belongs to the body.

    Motors are built in; and where passive joints are locked, another set of motors is another set of rigid bodies.
    """
    return "body" if gene.kind == "flag" and morphology.n_actuated is not None else gene.part


def _with_body(designs: Designs, bodies: Designs, morphology: Morphology) -> Designs:
    """Give every design the body of another, or all of them the body of one."""
    names = ("parent", *(gene.name for gene in GENES if _part_of(gene, morphology) == "body"))
    shape = (len(designs), N_LINKS)
    return replace(designs, **{name: np.broadcast_to(getattr(bodies, name), shape).copy() for name in names})


def mutate(
    designs: Designs,
    rng: Generator,
    *,
    mutation: Mutation = MUTATION,
    parts: tuple[Part, ...] = ("body", "control"),
    morphology: Morphology = ANY_BODY,
) -> Designs:
    """Copy designs with some genes changed, at least one each.

    An interval's gene takes a Gaussian step and is clipped, an angle's wraps around, a flag flips. Rewiring hangs one
    link from another parent and leaves its other genes as they are. With a given number of actuated joints, a flag that
    would flip changes places with an opposite one instead: a motor moves to another joint.

    Args:
        designs: n_designs parents, which keep to the morphology.
        rng: source of randomness.
        mutation: rates and steps.
        parts: what may change; ("control",) leaves bodies alone.
        morphology: what bodies keep to; a mutant that does not is drawn again.

    Raises:
        DesignError: a parent has no mutant that keeps to the morphology.
    """
    return draw_mutants(designs, rng, mutation=mutation, parts=parts, morphology=morphology).designs


def draw_mutants(
    designs: Designs,
    rng: Generator,
    *,
    mutation: Mutation = MUTATION,
    parts: tuple[Part, ...] = ("body", "control"),
    morphology: Morphology = ANY_BODY,
) -> Drawn:
    """Mutate designs as :func:`mutate` does, and count the draws."""
    if "body" not in parts or morphology.unjoined_links == "may_overlap":
        return _drawn_once(_mutant(designs, rng, mutation, parts, morphology))
    everybody = np.ones(len(designs), dtype=bool)
    return until_apart(lambda which: _mutant(designs[which], rng, mutation, parts, morphology), everybody)


def _mutant(
    designs: Designs, rng: Generator, mutation: Mutation, parts: tuple[Part, ...], morphology: Morphology
) -> Designs:
    genes = tuple(gene for gene in GENES if _part_of(gene, morphology) in parts)
    limits = _limits(genes)
    table = np.concatenate([_columns(gene, getattr(designs, gene.name)) for gene in genes], axis=1)
    varied = table.copy()
    changes = rng.random(table.shape) < mutation.genes_changed / N_GENES
    while True:
        steps = rng.standard_normal(table.shape) * mutation.step
        if morphology.n_actuated is not None:
            flags = table[:, limits.is_flag]
            moved = _moved(flags, changes[:, limits.is_flag], rng)
            varied[:, limits.is_flag] = np.where(moved == flags, varied[:, limits.is_flag], moved)
            changes &= ~limits.is_flag  # a flag that moved took the place of another
        rows, columns = changes.nonzero()  # a few in a hundred
        varied[rows, columns] = _stepped(limits, columns, table[rows, columns], steps[rows, columns])
        same = (varied == table).all(axis=1)
        if not same.any():
            break
        # No gene was drawn, or a bound held those that were: draw one until it moves.
        drawn = rng.integers(0, table.shape[1], len(designs))
        changes = same[:, None] & (np.arange(table.shape[1]) == drawn[:, None])

    changed = {name: array.copy() for name, array in designs.arrays()}
    first = 0
    for gene in genes:
        numbers = _columns(gene, changed[gene.name])
        numbers[:] = varied[:, first : first + gene.n_numbers]
        first += gene.n_numbers
    if "body" in parts:
        _rewire(changed["parent"], rng, mutation.rewiring)
    return Designs(**changed)


def _moved(flags: Floats, moves: npt.NDArray[np.bool_], rng: Generator) -> Floats:
    """Let each flag that is to move change places with one that is its opposite, drawn uniformly.

    Args:
        flags: (n_designs, n_flags) 0 or 1.
        moves: (n_designs, n_flags) which of them move.
        rng: source of randomness.
    """
    flags = flags.copy()
    for column in range(flags.shape[1]):
        opposite = (flags != flags[:, column, None]) & moves[:, column, None]
        other = (rng.random(flags.shape) * opposite).argmax(axis=1)
        rows = np.flatnonzero(opposite.any(axis=1))
        flags[rows, column], flags[rows, other[rows]] = flags[rows, other[rows]], flags[rows, column]
    return flags


def _columns(gene: Gene, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """View a gene's numbers, what a root ignores left out, as (n_designs, numbers of this gene)."""
    return array[:, gene.first_link :] if gene.per_link else array[:, None]


class _Limits(NamedTuple):
    """Of every number in a table of genes."""

    low: Floats
    high: Floats
    is_angle: npt.NDArray[np.bool_]
    is_flag: npt.NDArray[np.bool_]


@cache
def _limits(genes: tuple[Gene, ...]) -> _Limits:
    numbers = [gene for gene in genes for _ in range(gene.n_numbers)]
    return _Limits(
        low=np.array([gene.low for gene in numbers]),
        high=np.array([gene.high for gene in numbers]),
        is_angle=np.array([gene.kind == "angle" for gene in numbers]),
        is_flag=np.array([gene.kind == "flag" for gene in numbers]),
    )


def _stepped(limits: _Limits, columns: Ints, values: Floats, steps: Floats) -> Floats:
    """Move numbers of some columns of a table of genes by a share of their gene's range, and back within its bounds."""
    low, high, is_angle, is_flag = (of_all.take(columns) for of_all in limits)
    moved = values + steps * (high - low)
    wrapped = low + np.mod(moved - low, high - low)
    # The clip also catches the rounding of a remainder just below an angle's end.
    within = np.clip(np.where(is_angle, wrapped, moved), low, high)
    return np.where(is_flag, 1.0 - values, within)


def _rewire(parent: npt.NDArray[np.int64], rng: Generator, probability: float) -> None:
    """Hang one link of some designs from another of the links before it, in place. Link 1 has the root alone."""
    n_designs = len(parent)
    chosen = np.flatnonzero(rng.random(n_designs) < probability)
    link = rng.integers(2, N_LINKS, n_designs)[chosen]
    other = np.floor(rng.random(n_designs)[chosen] * (link - 1)).astype(np.int64)
    parent[chosen, link] = other + (other >= parent[chosen, link])  # skips the present parent


def crossover(one: Designs, other: Designs, rng: Generator, *, morphology: Morphology = ANY_BODY) -> Designs:
    """Recombine pairs of designs: each link's genes, its parent's index among them, come from one or the other.

    A link's parent always comes before it, so the result is a tree whatever the choice. The frequency is one more
    choice. At least one link comes from each parent.

    With a given number of actuated joints, a joint that is actuated in both stays so; of the others that are in one of
    them, those whose link came from that one are preferred, and chance decides among equals. So the flags of a
    few links are not those of the parent that gave the rest.

    Args:
        one: n_designs designs, which keep to the morphology.
        other: as many.
        rng: source of randomness.
        morphology: what bodies keep to; a child that does not is drawn again, MAX_RECOMBINATIONS times at most: then it
            gets the body of one and the controller of the other, which is a recombination that always keeps to it.
    """
    return draw_recombinations(one, other, rng, morphology=morphology).designs


MAX_RECOMBINATIONS = 256
"""Draws of a pair's child before the pair is taken to have none that is allowed: there are 62 choices of links."""


def draw_recombinations(one: Designs, other: Designs, rng: Generator, *, morphology: Morphology = ANY_BODY) -> Drawn:
    """Recombine designs as :func:`crossover` does, and count the draws."""
    if morphology.unjoined_links == "may_overlap":
        return _drawn_once(_recombination(one, other, rng, morphology))

    def draw(which: Ints) -> Designs:
        return _recombination(one[which], other[which], rng, morphology)

    everybody = np.ones(len(one), dtype=bool)
    return until_apart(draw, everybody, max_draws=MAX_RECOMBINATIONS, otherwise=_with_body(other, one, morphology))


def _recombination(one: Designs, other: Designs, rng: Generator, morphology: Morphology) -> Designs:
    n_designs = len(one)
    from_one = rng.random((n_designs, N_LINKS)) < 0.5
    same = np.flatnonzero(from_one.all(axis=1) | ~from_one.any(axis=1))
    flipped = rng.integers(0, N_LINKS, n_designs)[same]
    from_one[same, flipped] ^= True
    frequency_from_one = rng.random(n_designs) < 0.5
    child = {
        name: np.where(frequency_from_one if array.ndim == 1 else from_one, array, getattr(other, name))
        for name, array in one.arrays()
    }
    if morphology.n_actuated is not None:
        on_in = one.motor_on.astype(np.int64) + other.motor_on
        preference = np.minimum(on_in, 1) + (on_in == 2) + child["motor_on"]  # 3 on in both, 2 inherited, 1, 0 in none
        score = preference[:, 1:] + rng.random((n_designs, N_LINKS - 1))
        child["motor_on"][:, 1:] = _highest(score, morphology.n_actuated)
    return Designs(**child)
