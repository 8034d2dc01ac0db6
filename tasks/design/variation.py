"""Variation: random designs, mutated copies and recombinations. Paper, "Evolutionary Design".

Every function takes valid designs and a generator and gives valid designs. With ``body`` given, the bodies stay as they
are and the controllers alone vary: that is the paper's controller adaptation.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.random import Generator
from pydantic import Field

from tasks.design.genes import GENES, N_GENES, N_LINKS, ROOT_PARENT, Designs, Gene, Part, canonical
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


def random_designs(n_designs: int, rng: Generator, *, body: Designs | None = None) -> Designs:
    """Draw designs uniformly within the genes' bounds; a motor is on with probability 1/2.

    Args:
        n_designs: how many.
        rng: source of randomness.
        body: one design whose body all get; only their controllers are drawn then.
    """
    drawn: dict[str, npt.NDArray[Any]] = {gene.name: _draw(gene, n_designs, rng) for gene in GENES}
    parent = np.full((n_designs, N_LINKS), ROOT_PARENT, dtype=np.int64)
    for link in range(1, N_LINKS):
        parent[:, link] = rng.integers(0, link, n_designs)
    designs = canonical(Designs(parent=parent, **drawn))
    return designs if body is None else _with_body(designs, body)


def _draw(gene: Gene, n_designs: int, rng: Generator) -> npt.NDArray[Any]:
    shape = (n_designs, N_LINKS) if gene.per_link else (n_designs,)
    if gene.kind == "flag":
        return rng.random(shape) < 0.5
    return rng.uniform(gene.low, gene.high, shape)


def _with_body(designs: Designs, body: Designs) -> Designs:
    """Give every design the body of one."""
    n_designs = len(designs)
    repeated = {
        name: np.repeat(getattr(body, name), n_designs, axis=0)
        for name in ("parent", *(gene.name for gene in GENES if gene.part == "body"))
    }
    return replace(designs, **repeated)


def mutate(
    designs: Designs, rng: Generator, *, mutation: Mutation = MUTATION, parts: tuple[Part, ...] = ("body", "control")
) -> Designs:
    """Copy designs with some genes changed, at least one each.

    An interval's gene takes a Gaussian step and is clipped, an angle's wraps around, a flag flips. Rewiring hangs one
    link from another parent and leaves its other genes as they are.

    Args:
        designs: n_designs parents.
        rng: source of randomness.
        mutation: rates and steps.
        parts: what may change; ("control",) leaves bodies alone.
    """
    genes = [gene for gene in GENES if gene.part in parts]
    table = np.concatenate([_columns(gene, getattr(designs, gene.name)) for gene in genes], axis=1)
    varied = table
    changes = rng.random(table.shape) < mutation.genes_changed / N_GENES
    while True:
        steps = rng.standard_normal(table.shape) * mutation.step
        varied = np.where(changes, _stepped(_limits(parts), table, steps), varied)
        same = (varied == table).all(axis=1)
        if not same.any():
            break
        # No gene was drawn, or a bound held those that were: draw one until it moves.
        drawn = rng.integers(0, table.shape[1], len(designs))
        changes = same[:, None] & (np.arange(table.shape[1]) == drawn[:, None])

    changed = {name: array.copy() for name, array in designs.arrays()}
    first = 0
    for gene in genes:
        columns = _columns(gene, changed[gene.name])
        columns[:] = varied[:, first : first + columns.shape[1]]
        first += columns.shape[1]
    if "body" in parts:
        _rewire(changed["parent"], rng, mutation.rewiring)
    return Designs(**changed)


def _columns(gene: Gene, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """View a gene's numbers, what a root ignores left out, as (n_designs, numbers of this gene)."""
    return array[:, gene.first_link :] if gene.per_link else array[:, None]


class _Limits(NamedTuple):
    """Of every number in a table of genes."""

    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    is_angle: npt.NDArray[np.bool_]
    is_flag: npt.NDArray[np.bool_]


@cache
def _limits(parts: tuple[Part, ...]) -> _Limits:
    numbers = [gene for gene in GENES if gene.part in parts for _ in range(gene.n_numbers)]
    return _Limits(
        low=np.array([gene.low for gene in numbers]),
        high=np.array([gene.high for gene in numbers]),
        is_angle=np.array([gene.kind == "angle" for gene in numbers]),
        is_flag=np.array([gene.kind == "flag" for gene in numbers]),
    )


def _stepped(
    limits: _Limits, table: npt.NDArray[np.float64], steps: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Move every number of a table of genes by a share of its gene's range, and back within its bounds."""
    low, high, is_angle, is_flag = limits
    moved = table + steps * (high - low)
    wrapped = low + np.mod(moved - low, high - low)
    # The clip also catches the rounding of a remainder just below an angle's end.
    within = np.clip(np.where(is_angle, wrapped, moved), low, high)
    return np.where(is_flag, 1.0 - table, within)


def _rewire(parent: npt.NDArray[np.int64], rng: Generator, probability: float) -> None:
    """Hang one link of some designs from another of the links before it, in place. Link 1 has the root alone."""
    n_designs = len(parent)
    chosen = np.flatnonzero(rng.random(n_designs) < probability)
    link = rng.integers(2, N_LINKS, n_designs)[chosen]
    other = np.floor(rng.random(n_designs)[chosen] * (link - 1)).astype(np.int64)
    parent[chosen, link] = other + (other >= parent[chosen, link])  # skips the present parent


def crossover(one: Designs, other: Designs, rng: Generator) -> Designs:
    """Recombine pairs of designs: each link's genes, its parent's index among them, come from one or the other.

    A link's parent always comes before it, so the result is a tree whatever the choice. The frequency is one more
    choice. At least one link comes from each parent.

    Args:
        one: n_designs designs.
        other: as many.
        rng: source of randomness.
    """
    n_designs = len(one)
    from_one = rng.random((n_designs, N_LINKS)) < 0.5
    same = np.flatnonzero(from_one.all(axis=1) | ~from_one.any(axis=1))
    flipped = rng.integers(0, N_LINKS, n_designs)[same]
    from_one[same, flipped] ^= True
    frequency_from_one = rng.random(n_designs) < 0.5
    return Designs(
        **{
            name: np.where(frequency_from_one if array.ndim == 1 else from_one, array, getattr(other, name))
            for name, array in one.arrays()
        }
    )
