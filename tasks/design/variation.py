"""Variation: random designs, mutated copies and recombinations. Paper, "Evolutionary Design".

Every function takes valid designs and a generator and gives valid designs. With ``body`` given, the bodies stay as they
are and the controllers alone vary: that is the paper's controller adaptation.

A morphology that asks for something makes operators draw again what it refuses. The functions whose names begin with
``draw`` tell how often, too.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.random import Generator
from pydantic import Field

from tasks.design.genes import (
    COLUMNS,
    GENES,
    LINK_OF_COLUMN,
    N_COLUMNS,
    N_GENES,
    N_LINKS,
    ROOT_PARENT,
    Designs,
    Gene,
    Part,
    Table,
)
from tasks.design.morphology import ANY_BODY, Drawn, Floats, Ints, Morphology, until_apart
from tasks.parameters import Parameters


class Mutation(Parameters):
    """How far and how often a mutant departs from its parent."""

    genes_changed: float = Field(default=3.0, ge=0.0, le=N_GENES)
    """Genes that change on average, of all the numbers that describe a design: 37 in the paper's table."""
    step: float = Field(default=0.1, gt=0.0, le=1.0)
    """Deviation of the Gaussian step, as a share of the gene's range. 0.2 is faster over few generations."""
    rewiring: float = Field(default=0.05, ge=0.0, le=1.0)
    """Probability that one link of a mutant is hung from another parent."""


MUTATION = Mutation()

PARENT = COLUMNS["parent"]
MOTOR = "motor_on"
MOTORS = slice(COLUMNS[MOTOR].start + 1, COLUMNS[MOTOR].stop)
"""Columns of the joints' motors; a root has none."""


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


def _drawn_once(table: Table) -> Drawn:
    return Drawn(table, np.ones(len(table), dtype=np.int64))


def _random(n_designs: int, rng: Generator, body: Designs | None, morphology: Morphology) -> Table:
    table = np.empty((n_designs, N_COLUMNS))
    for gene in GENES:
        table[:, COLUMNS[gene.name]] = _draw(gene, n_designs, rng)
    table[:, PARENT.start] = ROOT_PARENT
    for link in range(1, N_LINKS):
        table[:, PARENT.start + link] = rng.integers(0, link, n_designs)
    if morphology.n_actuated is not None:
        table[:, MOTORS] = _highest(rng.random((n_designs, N_LINKS - 1)), morphology.n_actuated)
    return table if body is None else _with_body(table, body.table, morphology)


def _draw(gene: Gene, n_designs: int, rng: Generator) -> npt.NDArray[Any]:
    shape = (n_designs, N_LINKS if gene.per_link else 1)
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
    return "body" if gene.name == MOTOR and morphology.n_actuated is not None else gene.part


def _with_body(table: Table, bodies: Table, morphology: Morphology) -> Table:
    """Give every design the body of another, or all of them the body of one."""
    changed = table.copy()
    for name in ("parent", *(gene.name for gene in GENES if _part_of(gene, morphology) == "body")):
        changed[:, COLUMNS[name]] = bodies[:, COLUMNS[name]]
    return changed


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
    return draw_mutants(designs.table, rng, mutation=mutation, parts=parts, morphology=morphology).designs


def draw_mutants(
    table: Table,
    rng: Generator,
    *,
    mutation: Mutation = MUTATION,
    parts: tuple[Part, ...] = ("body", "control"),
    morphology: Morphology = ANY_BODY,
) -> Drawn:
    """Mutate designs, given as their table, as :func:`mutate` does, and count the draws."""
    if "body" not in parts or morphology.unjoined_links == "may_overlap":
        return _drawn_once(_mutant(table, rng, mutation, parts, morphology))
    everybody = np.ones(len(table), dtype=bool)
    return until_apart(lambda which: _mutant(table[which], rng, mutation, parts, morphology), everybody)


def _mutant(table: Table, rng: Generator, mutation: Mutation, parts: tuple[Part, ...], morphology: Morphology) -> Table:
    limits = _limits(tuple(gene for gene in GENES if _part_of(gene, morphology) in parts))
    old = table.take(limits.columns, axis=1)
    new = old.copy()
    changes = rng.random(old.shape) < mutation.genes_changed / N_GENES
    while True:
        steps = rng.standard_normal(old.shape) * mutation.step
        if morphology.n_actuated is not None:
            motors = old[:, limits.is_motor]
            moved = _moved(motors, changes[:, limits.is_motor], rng)
            new[:, limits.is_motor] = np.where(moved == motors, new[:, limits.is_motor], moved)
            changes &= ~limits.is_motor  # a motor that moved took the place of another
        rows, numbers = changes.nonzero()  # a few in a hundred
        new[rows, numbers] = _stepped(limits, numbers, old[rows, numbers], steps[rows, numbers])
        same = (new == old).all(axis=1)
        if not same.any():
            break
        # No gene was drawn, or a bound held those that were: draw one until it moves.
        drawn = rng.integers(0, old.shape[1], len(old))
        changes = same[:, None] & (np.arange(old.shape[1]) == drawn[:, None])

    mutants = table.copy()
    mutants[:, limits.columns] = new
    if "body" in parts:
        _rewire(mutants[:, PARENT], rng, mutation.rewiring)
    return mutants


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


class _Limits(NamedTuple):
    """Of every number that some genes are."""

    columns: Ints
    """In a table of designs."""
    low: Floats
    high: Floats
    is_angle: npt.NDArray[np.bool_]
    is_flag: npt.NDArray[np.bool_]
    is_motor: npt.NDArray[np.bool_]


@cache
def _limits(genes: tuple[Gene, ...]) -> _Limits:
    numbers = [gene for gene in genes for _ in range(gene.n_numbers)]
    return _Limits(
        columns=np.concatenate([np.arange(N_COLUMNS)[COLUMNS[gene.name]][-gene.n_numbers :] for gene in genes]),
        low=np.array([gene.low for gene in numbers]),
        high=np.array([gene.high for gene in numbers]),
        is_angle=np.array([gene.kind == "angle" for gene in numbers]),
        is_flag=np.array([gene.kind == "flag" for gene in numbers]),
        is_motor=np.array([gene.name == MOTOR for gene in numbers]),
    )


def _stepped(limits: _Limits, numbers: Ints, values: Floats, steps: Floats) -> Floats:
    """Move some numbers by a share of their gene's range, and back within its bounds."""
    _, low, high, is_angle, is_flag, _ = (of_all.take(numbers) for of_all in limits)
    moved = values + steps * (high - low)
    wrapped = low + np.mod(moved - low, high - low)
    # The clip also catches the rounding of a remainder just below an angle's end.
    within = np.clip(np.where(is_angle, wrapped, moved), low, high)
    return np.where(is_flag, 1.0 - values, within)


def _rewire(parent: Floats, rng: Generator, probability: float) -> None:
    """Hang one link of some designs from another of the links before it, in place. Link 1 has the root alone."""
    n_designs = len(parent)
    chosen = (rng.random(n_designs) < probability).nonzero()[0]
    link = rng.integers(2, N_LINKS, n_designs)[chosen]
    other = np.floor(rng.random(n_designs)[chosen] * (link - 1))
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
    return draw_recombinations(one.table, other.table, rng, morphology=morphology).designs


MAX_RECOMBINATIONS = 256
"""Draws of a pair's child before the pair is taken to have none that is allowed: there are 62 choices of links."""


def draw_recombinations(one: Table, other: Table, rng: Generator, *, morphology: Morphology = ANY_BODY) -> Drawn:
    """Recombine designs, given as their tables, as :func:`crossover` does, and count the draws."""
    if morphology.unjoined_links == "may_overlap":
        return _drawn_once(_recombination(one, other, rng, morphology))

    def draw(which: Ints) -> Table:
        return _recombination(one[which], other[which], rng, morphology)

    everybody = np.ones(len(one), dtype=bool)
    otherwise = _with_body(other, one, morphology)
    return until_apart(draw, everybody, max_draws=MAX_RECOMBINATIONS, otherwise=otherwise)


def _recombination(one: Table, other: Table, rng: Generator, morphology: Morphology) -> Table:
    n_designs = len(one)
    from_one = np.empty((n_designs, N_LINKS + 1), dtype=bool)  # each link's genes, and those of the whole design
    links = from_one[:, :N_LINKS]
    links[:] = rng.random(links.shape) < 0.5
    same = np.flatnonzero(links.all(axis=1) | ~links.any(axis=1))
    flipped = rng.integers(0, N_LINKS, n_designs)[same]
    links[same, flipped] ^= True
    from_one[:, N_LINKS] = rng.random(n_designs) < 0.5
    child = np.where(from_one.take(LINK_OF_COLUMN, axis=1), one, other)
    if morphology.n_actuated is not None:
        on_in = one[:, MOTORS] + other[:, MOTORS]
        preference = np.minimum(on_in, 1) + (on_in == 2) + child[:, MOTORS]  # 3 on in both, 2 inherited, 1, 0 in none
        score = preference + rng.random((n_designs, N_LINKS - 1))
        child[:, MOTORS] = _highest(score, morphology.n_actuated)
    return child
