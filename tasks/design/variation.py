"""Variation: random designs, mutated copies and recombinations. Paper, "Evolutionary Design".

Every operator takes valid designs and a generator and gives valid designs. With ``body`` given, the bodies stay as they
are and the controllers alone vary: that is the paper's controller adaptation.

A morphology that asks for something makes operators draw again what it refuses. The functions whose names begin with
``draw`` tell how often, too. What is done to the numbers is compiled: operators.py.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.random import Generator
from pydantic import Field

from tasks.arrays import Int64
from tasks.compiled import compiled
from tasks.design import genes, variation_kernels
from tasks.design.genes import COLUMNS, GENES, N_COLUMNS, N_GENES, Designs, DesignTable, Gene, GenePart
from tasks.design.morphology import ANY_BODY, MAX_DRAWS, Drawn, Morphology, until_apart
from tasks.design.variation_kernels import ANY_NUMBER, BODY_STAYS, MOTOR, Numbers, Variation
from tasks.parameters import Parameters


class Mutation(Parameters):
    """How far and how often a mutant departs from its parent."""

    genes_changed: float = Field(default=3.0, ge=0.0, le=N_GENES)
    """Genes that change on average, of all the numbers that describe a design: 37 in the paper's table."""
    step: float = Field(default=0.1, ge=1e-6, le=1.0)
    """Deviation of the Gaussian step, as a share of the gene's range. 0.2 is faster over few generations."""
    rewiring: float = Field(default=0.05, ge=0.0, le=1.0)
    """Probability that one link of a mutant is hung from another parent."""


_MUTATION = Mutation()

VARIATION_SOURCES = [genes, variation_kernels]
"""Modules that go into the operators' kernels."""
random_kernel = compiled(variation_kernels.random_table, VARIATION_SOURCES, seconds=3)
mutate_kernel = compiled(variation_kernels.mutate_table, VARIATION_SOURCES, seconds=6)
recombine_kernel = compiled(variation_kernels.recombine_tables, VARIATION_SOURCES, seconds=3)

NO_DESIGNS = Designs.from_table(np.zeros((0, N_COLUMNS)))


def variation_of(
    morphology: Morphology,
    *,
    mutation: Mutation = _MUTATION,
    parts: tuple[GenePart, ...] = ("body", "control"),
    body: Designs | None = None,
) -> Variation:
    """Tell the kernels what may vary, and how.

    Args:
        morphology: what bodies keep to.
        mutation: rates and steps.
        parts: what mutation may change; ("control",) leaves bodies alone.
        body: one design whose body all designs get that are drawn.
    """
    variation = _variation(morphology.n_actuated, mutation, parts)
    return variation if body is None else variation._replace(body=body.table)


@cache
def _variation(n_actuated: int | None, mutation: Mutation, parts: tuple[GenePart, ...]) -> Variation:
    return Variation(
        body=NO_DESIGNS.table,
        body_columns=_body_columns(n_actuated),
        n_actuated=ANY_NUMBER if n_actuated is None else n_actuated,
        numbers=_numbers(parts, n_actuated),
        change=mutation.genes_changed / N_GENES,
        step=mutation.step,
        rewiring=mutation.rewiring if "body" in parts else BODY_STAYS,
    )


def _part_of(gene: Gene, n_actuated: int | None) -> GenePart:
    """Tell what a gene is of: with a given number of actuated joints, which they are belongs to the body.

    Motors are built in; and where passive joints are locked, another set of motors is another set of rigid bodies.
    """
    return "body" if gene.name == MOTOR and n_actuated is not None else gene.part


def _body_columns(n_actuated: int | None) -> Int64:
    names = ["parent", *(gene.name for gene in GENES if _part_of(gene, n_actuated) == "body")]
    return np.concatenate([np.arange(N_COLUMNS)[COLUMNS[name]] for name in names])


def _numbers(parts: tuple[GenePart, ...], n_actuated: int | None) -> Numbers:
    varying = [gene for gene in GENES if _part_of(gene, n_actuated) in parts]
    of_all = [gene for gene in varying for _ in range(gene.n_numbers)]
    return Numbers(
        column=np.concatenate([np.arange(N_COLUMNS)[COLUMNS[gene.name]][-gene.n_numbers :] for gene in varying]),
        low=np.array([gene.low for gene in of_all]),
        high=np.array([gene.high for gene in of_all]),
        is_angle=np.array([gene.kind == "angle" for gene in of_all]),
        is_flag=np.array([gene.kind == "flag" for gene in of_all]),
        is_motor=np.array([gene.name == MOTOR for gene in of_all]),
    )


def random_designs(
    n_designs: int, rng: Generator, *, body: Designs | None = None, morphology: Morphology = ANY_BODY
) -> Designs:
    """Draw designs uniformly within the genes' bounds; a motor is on with probability 1/2 where their number is free.

    Args:
        n_designs: how many.
        rng: source of randomness.
        body: one design whose body all get; only their controllers are drawn then.
        morphology: what bodies keep to; they are uniform among those that do.

    Raises:
        DesignError: the morphology can't be satisfied.
    """
    return draw_random(n_designs, rng, body=body, morphology=morphology).designs


def draw_random(
    n_designs: int,
    rng: Generator,
    *,
    body: Designs | None = None,
    morphology: Morphology = ANY_BODY,
    first: DesignTable | None = None,
) -> Drawn:
    """Draw random designs as :func:`random_designs` does, and count the draws.

    Args:
        n_designs: how many.
        rng: source of randomness.
        body: one design whose body all get.
        morphology: what bodies keep to.
        first: (n_designs, N_COLUMNS) their first draws, where those were made already.
    """
    variation = variation_of(morphology, body=body)

    def draw(which: Int64) -> DesignTable:
        table: DesignTable = random_kernel(len(which), rng, variation)
        return table

    return _drawn(draw, n_designs, first, body is None and morphology.unjoined_links == "apart")


def _drawn(
    draw: Callable[[Int64], DesignTable],
    n_designs: int,
    first: DesignTable | None,
    apart: bool,
    max_draws: int = MAX_DRAWS,
    otherwise: DesignTable | None = None,
) -> Drawn:
    table = draw(np.arange(n_designs)) if first is None else first
    if apart:
        return until_apart(table, draw, max_draws=max_draws, otherwise=otherwise)
    return Drawn(table, np.ones(n_designs, dtype=np.int64))


def mutate(
    designs: Designs,
    rng: Generator,
    *,
    mutation: Mutation = _MUTATION,
    parts: tuple[GenePart, ...] = ("body", "control"),
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
    table: DesignTable,
    rng: Generator,
    *,
    mutation: Mutation = _MUTATION,
    parts: tuple[GenePart, ...] = ("body", "control"),
    morphology: Morphology = ANY_BODY,
    first: DesignTable | None = None,
) -> Drawn:
    """Mutate designs, given as their table, as :func:`mutate` does, and count the draws; see :func:`draw_random`."""
    variation = variation_of(morphology, mutation=mutation, parts=parts)

    def draw(which: Int64) -> DesignTable:
        mutants = table[which]
        mutate_kernel(mutants, rng, variation)
        return mutants

    return _drawn(draw, len(table), first, "body" in parts and morphology.unjoined_links == "apart")


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


def draw_recombinations(
    one: DesignTable,
    other: DesignTable,
    rng: Generator,
    *,
    morphology: Morphology = ANY_BODY,
    first: DesignTable | None = None,
) -> Drawn:
    """Recombine designs, given as tables, as :func:`crossover` does, and count the draws; see :func:`draw_random`."""
    variation = variation_of(morphology)

    def draw(which: Int64) -> DesignTable:
        child = one[which]
        recombine_kernel(child, other[which], rng, variation)
        return child

    apart, columns = morphology.unjoined_links == "apart", variation.body_columns
    otherwise = other.copy()
    otherwise[:, columns] = one[:, columns]
    return _drawn(draw, len(one), first, apart, MAX_RECOMBINATIONS, otherwise)
