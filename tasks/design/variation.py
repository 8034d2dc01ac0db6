"""Variation: random designs, mutation and crossover. Paper, "Evolutionary Design".

Every operator maps valid designs to valid designs. With ``body`` given, only controllers vary: the paper's controller
adaptation.

Designs that a morphology does not allow are rejected and drawn anew. variation_kernels.py has the compiled operators.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.random import Generator
from pydantic import Field

from tasks.arrays import Float64, Int64
from tasks.compiled import compiled
from tasks.design import variation_kernels
from tasks.design.controllers import OPEN_LOOP
from tasks.design.gene import GENES, DesignError, Gene, GenePart
from tasks.design.genes import LEAST_LINKS, N_GENES, Designs, DesignTable, table_of
from tasks.design.morphology import ANY_BODY, MAX_DRAWS, Drawn, LinkLimits, Morphology, sample_allowed
from tasks.design.variation_kernels import ANY_NUMBER, BODY_STAYS, MOTOR, Variation
from tasks.parameters import Parameters


class Mutation(Parameters):
    """Rates and step size of mutation."""

    genes_changed: float = Field(default=3.0, ge=0.0, le=N_GENES)
    """Mean number of changed genes, of all numbers that describe a design: 37 of six links with the paper's
    controller."""
    step: float = Field(default=0.1, ge=1e-6, le=1.0)
    """Standard deviation of the Gaussian step, as a share of the gene's range. 0.2 is faster over few generations."""
    rewiring: float = Field(default=0.05, ge=0.0, le=1.0)
    """Probability that one link of a mutant gets another parent."""
    resizing: float = Field(default=0.1, ge=0.0, le=1.0)
    """Probability that a mutant gains a random leaf or, equally likely, loses one, where design.n_links allows it."""


_MUTATION = Mutation()

random_kernel = compiled(variation_kernels.random_table, seconds=2)
mutate_kernel = compiled(variation_kernels.mutate_table, seconds=3)
recombine_kernel = compiled(variation_kernels.recombine_tables, seconds=1)

MAX_RECOMBINATIONS = 256  # most draws of a child; there are 62 choices of links


def variation_of(
    morphology: Morphology,
    *,
    mutation: Mutation = _MUTATION,
    parts: tuple[GenePart, ...] = ("body", "control"),
    body: Designs | None = None,
    controller: str = OPEN_LOOP,
    room: int | None = None,
) -> Variation:
    """Return the argument of the kernels that describes variation of designs with a controller.

    Mutation may change some parts; ("control",) preserves bodies. All random designs get the body of one, if given.
    Tables have room for as many links as that body, or the given number, which is the most of the morphology otherwise.
    """
    limits = morphology.n_links
    room = body.room if body else room or limits.most
    variation = _variation(morphology.n_actuated, limits, mutation, parts, controller, room)
    return variation if body is None else variation._replace(body=body.table)


@cache
def _variation(
    n_actuated: int | None,
    limits: LinkLimits,
    mutation: Mutation,
    parts: tuple[GenePart, ...],
    controller: str,
    room: int,
) -> Variation:
    of = table_of(controller, room)
    numbers = range(LEAST_LINKS, room + 1)
    part = ["body" if gene is None else _part_of(gene, n_actuated) for gene in of.gene_of_column]
    varies = [of_column in parts for of_column in part]
    no_body = np.zeros((0, len(part)))
    no_body.flags.writeable = False  # as tables of designs are, or the kernels would be compiled once more
    return Variation(
        of=of.columns,
        least=limits.least,
        most=limits.most,
        body=no_body,
        body_columns=np.flatnonzero([of_column == "body" for of_column in part]),
        n_actuated=ANY_NUMBER if n_actuated is None else n_actuated,
        columns=np.flatnonzero(varies & ~of.columns.is_parent & ~of.columns.is_ignored),
        change=np.array(
            [0.0] * LEAST_LINKS + [mutation.genes_changed / table_of(controller, n).n_genes for n in numbers]
        ),
        step=mutation.step,
        rewiring=mutation.rewiring if "body" in parts else BODY_STAYS,
        resizing=mutation.resizing,
    )


def _part_of(gene: Gene, n_actuated: int | None) -> GenePart:
    """Return the part that a gene belongs to: motors belong to the body if their number is given.

    Motors are built in, and if passive joints are locked, another set of motors makes other rigid bodies.
    """
    return "body" if gene.name == MOTOR and n_actuated is not None else gene.part


@dataclass(frozen=True, eq=False)
class Sampler:
    """The operators on tables of designs, with rejection sampling where the morphology does not allow every design.

    An operator accepts the first draws, if they exist already.
    """

    rng: Generator
    variation: Variation
    morphology: Morphology  # constraints; a design that does not meet them is drawn anew
    controller: str = OPEN_LOOP  # of the designs

    def random(self, n_designs: int, first: DesignTable | None = None) -> Drawn:
        """Draw random designs."""

        def draw(which: Int64) -> DesignTable:
            table: DesignTable = random_kernel(len(which), self.rng, self.variation)
            return table

        return self._draw(draw, n_designs, first)

    def mutants(self, parents: DesignTable, first: DesignTable | None = None) -> Drawn:
        """Draw one mutant of each parent."""

        def draw(which: Int64) -> DesignTable:
            mutants = parents[which]
            mutate_kernel(mutants, self.rng, self.variation)
            return mutants

        return self._draw(draw, len(parents), first)

    def recombinations(self, parents: tuple[DesignTable, DesignTable], first: DesignTable | None = None) -> Drawn:
        """Draw one child of each pair; see :func:`crossover` about pairs without a child that is allowed."""
        one, other = parents
        otherwise = one.copy()
        if not self.morphology.constrains_gaits:
            of = self.variation.of
            n_joints = [(table[:, of.parent : of.parent + of.room] >= 0).sum(axis=1) for table in parents]
            in_both = of.link <= np.minimum(*n_joints)[:, None]
            otherwise = np.where(in_both, other, one)
            otherwise[:, self.variation.body_columns] = one[:, self.variation.body_columns]

        def draw(which: Int64) -> DesignTable:
            child = one[which]
            recombine_kernel(child, other[which], self.rng, self.variation)
            return child

        return self._draw(draw, len(one), first, MAX_RECOMBINATIONS, otherwise)

    def _draw(
        self,
        draw: Callable[[Int64], DesignTable],
        n_designs: int,
        first: DesignTable | None,
        max_draws: int = MAX_DRAWS,
        otherwise: DesignTable | None = None,
    ) -> Drawn:
        table = draw(np.arange(n_designs)) if first is None else first
        if self.morphology.rejects:
            of = self.controller
            return sample_allowed(table, draw, self.morphology, max_draws=max_draws, otherwise=otherwise, controller=of)
        return Drawn(table, np.ones(n_designs, dtype=np.int64), self.controller)


def random_designs(
    n_designs: int,
    rng: Generator,
    *,
    body: Designs | None = None,
    morphology: Morphology = ANY_BODY,
    controller: str = OPEN_LOOP,
) -> Designs:
    """Return random designs, uniform within the genes' bounds and the morphology.

    Unless the morphology gives the number of motors, each is on with probability 1/2.

    >>> designs = puddle.random_designs(64, np.random.default_rng(seed=1))
    >>> designs.length_scale.shape  # of six links each
    (64, 6)

    Args:
        n_designs: number of designs.
        rng: source of randomness.
        body: one design whose body all designs get; only controllers are drawn then.
        morphology: constraints on designs.
        controller: name of the designs' controller.

    Raises:
        DesignError: the morphology can't be satisfied, or there is no such controller.
    """
    if not isinstance(n_designs, int | np.integer) or n_designs < 0:
        raise ValueError(f"n_designs: expected a number of designs, got {n_designs!r}")
    _check_source(rng)
    return draw_random(n_designs, rng, body=body, morphology=morphology, controller=controller).designs


def _check_source(rng: Generator) -> None:
    if not isinstance(rng, Generator):
        raise ValueError(f"rng: expected a numpy.random.Generator, such as default_rng(seed=1), got {rng!r}")


def draw_random(
    n_designs: int, rng: Generator, *, body: Designs | None, morphology: Morphology, controller: str = OPEN_LOOP
) -> Drawn:
    """Return random designs, and how many were drawn for each; see :func:`random_designs`."""
    if body is not None and len(body) != 1:
        raise ValueError(f"body: expected one design, got {len(body)}")
    constraints = morphology if body is None else morphology.of_controllers()
    variation = variation_of(morphology, body=body, controller=controller)
    return Sampler(rng, variation, constraints, controller).random(n_designs)


def mutate(
    designs: Designs,
    rng: Generator,
    *,
    mutation: Mutation = _MUTATION,
    parts: tuple[GenePart, ...] = ("body", "control"),
    morphology: Morphology = ANY_BODY,
) -> Designs:
    """Return copies of designs with some genes changed, at least one in each.

    Intervals and angles take a Gaussian step; an interval is clipped, an angle wraps around. A gain takes one, too, or
    becomes 0. A flag flips. Rewiring gives one link another parent and keeps its other genes. If the number of motors
    is given, a motor's flag swaps with an opposite one instead: the motor moves to another joint. Where the morphology
    leaves the number of links open, some designs gain or lose a leaf of their tree.

    >>> rng = np.random.default_rng(seed=1)
    >>> parents = puddle.random_designs(16, rng)
    >>> len(puddle.mutate(parents[np.repeat(np.arange(16), 4)], rng))  # four mutants of each
    64

    Args:
        designs: n_designs parents within the morphology.
        rng: source of randomness.
        mutation: rates and step size.
        parts: parts that may change; ("control",) preserves bodies.
        morphology: constraints on designs.

    Raises:
        DesignError: no mutant of a parent is within the morphology.
        ValueError: there is no such part, or none.
    """
    _check_source(rng)
    if not parts or set(parts) - {"body", "control"}:
        raise ValueError(f"parts: expected body, control or both, got {parts!r}")
    limits = morphology.n_links
    room = max(designs.room, limits.most if limits.least < limits.most else 0)
    variation = variation_of(morphology, mutation=mutation, parts=parts, controller=designs.controller, room=room)
    constraints = morphology if "body" in parts else morphology.of_controllers()
    table = designs.with_room(room).table
    return Sampler(rng, variation, constraints, designs.controller).mutants(table).designs


def crossover(one: Designs, other: Designs, rng: Generator, *, morphology: Morphology = ANY_BODY) -> Designs:
    """Return recombinations of pairs: each link's genes, including its parent's index, come from one of two designs.

    A link's parent has a lower index, so every choice makes a tree. The frequency is one more choice, and so are all
    the links that only one of the designs has. At least one link comes from each design.

    If the number of motors is given, joints with a motor in both designs keep it. Then come joints whose link comes
    from the design in which the motor is on, then those with a motor in the other design; ties are random.

    >>> rng = np.random.default_rng(seed=1)
    >>> designs = puddle.random_designs(64, rng)
    >>> len(puddle.crossover(designs[:32], designs[32:], rng))
    32

    Args:
        one: n_designs designs within the morphology.
        other: n_designs designs within the morphology.
        rng: source of randomness.
        morphology: constraints on designs. After MAX_RECOMBINATIONS rejections a child gets the body of one and the
            controller of the other; where gaits are constrained, it is a copy of one. Both are allowed.

    Raises:
        DesignError: the designs have different controllers.
    """
    _check_source(rng)
    if one.controller != other.controller:
        raise DesignError(f"designs: controllers {one.controller} and {other.controller}, expected one of both")
    both = Designs.concatenate([one, other])
    variation = variation_of(morphology, controller=one.controller, room=both.room)
    if (n_links := both.n_links).size:
        variation = variation._replace(least=int(n_links.min()), most=int(n_links.max()))
    tables = both.table[: len(one)], both.table[len(one) :]
    return Sampler(rng, variation, morphology, one.controller).recombinations(tables).designs


def motors_off(designs: Designs) -> Designs:
    """Return designs without control: what they travel is what the world does to their bodies."""
    return replace(designs, motor_on=np.zeros_like(designs.motor_on))


def jittered(designs: Designs, rng: Generator, shifts: Mapping[str, float | Float64]) -> Designs:
    """Return designs with genes of every joint moved up or down, or inwards at a gene's bound.

    Args:
        designs: n_designs designs.
        rng: source of randomness, which decides the way, the same for all designs.
        shifts: how far, by the gene's name, in its unit: one number, or (n_designs, n_links).
    """
    bounds = {gene.name: (gene.low, gene.high) for gene in GENES}
    moved: dict[str, Any] = {}
    for name, shift in shifts.items():
        value, (low, high) = getattr(designs, name), bounds[name]
        step = np.where(rng.random(value.shape[1:]) < 0.5, -1.0, 1.0) * shift
        step = np.where((value + step < low) | (value + step > high), -step, step)
        moved[name] = np.where(designs.parent < 0, value, value + step)  # a root has no joint
    return replace(designs, **moved)
