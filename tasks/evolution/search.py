"""What a search is: it asks for designs and is told how they did. Each search is one file in this folder.

A search is a group of settings with two methods. It has no memory: what it knows is a :class:`Population`, a plain
value, and all randomness comes from the generator that is passed in. So a trial can stop after any generation and
resume on another machine, and its result does not depend on the trials that are batched with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from tasks.arrays import Float64, Int64
from tasks.design import ANY_BODY, OPEN_LOOP, Designs, Morphology
from tasks.design.genes import DesignTable, table_of
from tasks.design.morphology import Drawn
from tasks.discovery import register
from tasks.evolution.objectives import Evaluation
from tasks.parameters import Parameters

NO_PARENT = -1  # identity of a parent that a child does not have

Arrays = Mapping[str, npt.NDArray[Any]]


class Population(NamedTuple):
    """What a search knows after a generation; axis 0 is the design."""

    table: DesignTable  # genes of the designs that it keeps
    fitness: Float64  # (n_designs,) in the unit of the objective, finite
    identity: Int64  # (n_designs,) running number within the trial, in order of evaluation
    n_evaluated: int  # designs evaluated in the trial so far
    extra: Arrays = MappingProxyType({})  # whatever else the search needs to go on, of any shape
    controller: str = OPEN_LOOP  # of the designs; a trial sees to it, whatever a search returns

    @property
    def designs(self) -> Designs:
        """The n_designs designs."""
        return Designs.from_table(self.table, self.controller)

    def champion(self) -> int:
        """Return the index of the fittest design, the first among equals."""
        return int(np.argmax(self.fitness))

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the state as named arrays; the inverse of :meth:`from_arrays`."""
        return {
            **dict(self.designs.arrays()),
            "fitness": self.fitness,
            **self.extra,
            "identity": self.identity,
            "n_evaluated": np.array([self.n_evaluated], dtype=np.int64),
        }

    @staticmethod
    def from_arrays(arrays: Arrays) -> Population:
        """Restore a state from its named arrays."""
        designs = Designs.from_arrays(arrays)
        own = {*dict(designs.arrays()), "fitness", "identity", "n_evaluated"}
        return Population(
            table=designs.table,
            fitness=arrays["fitness"],
            identity=arrays["identity"],
            n_evaluated=int(arrays["n_evaluated"][0]),
            extra={name: array for name, array in arrays.items() if name not in own},
            controller=designs.controller,
        )


def empty_population(controller: str) -> Population:
    """Return the population before the first generation of designs with a controller."""
    table = np.zeros((0, len(table_of(controller).gene_of_column)))
    return Population(table, np.zeros(0), np.zeros(0, dtype=np.int64), n_evaluated=0, controller=controller)


EMPTY_POPULATION = empty_population(OPEN_LOOP)


class Children(NamedTuple):
    """Designs that wait to be evaluated; axis 0 is the child."""

    table: DesignTable  # genes (n_children, n_columns)
    identity: Int64  # (n_children,) running number within the trial
    operator: Int64  # (n_children,) index into the search's operators
    parents: Int64  # (n_children, 2) identities of the parents, or NO_PARENT
    n_draws: Int64  # (n_children,) draws of the operator until the morphology allowed the design
    extra: Arrays = MappingProxyType({})  # further columns of the history, those that the search names
    controller: str = OPEN_LOOP  # of the designs; as in a population

    @property
    def designs(self) -> Designs:
        """The n_children designs."""
        return Designs.from_table(self.table, self.controller)


def without_parents(population: Population, drawn: Drawn, operator: int = 0) -> Children:
    """Return drawn designs as children without parents, all made by one operator."""
    n_children = len(drawn.table)
    return Children(
        table=drawn.table,
        identity=np.arange(population.n_evaluated, population.n_evaluated + n_children),
        operator=np.full(n_children, operator),
        parents=np.full((n_children, 2), NO_PARENT),
        n_draws=drawn.n_draws,
        controller=population.controller,
    )


class Optimiser(Protocol):
    """A search by ask and tell; its settings are its fields."""

    operators: ClassVar[tuple[str, ...]]  # what makes a child, in the order of the codes in histories
    columns: ClassVar[Mapping[str, str]]  # columns that its children add to histories, with their units

    @property
    def population_size(self) -> int:
        """Designs of a generation."""

    def ask(
        self, population: Population, rng: Generator, *, body: Designs | None = None, morphology: Morphology = ANY_BODY
    ) -> Children:
        """Return a generation of children, numbered from ``population.n_evaluated``.

        Args:
            population: what it knows so far; it begins if this has no designs. New ones get its controller.
            rng: source of randomness.
            body: one design whose body all children get; only controllers vary then.
            morphology: constraints on designs.
        """

    def tell(self, population: Population, children: Children, evaluation: Evaluation, rng: Generator) -> Population:
        """Return what it knows once its children are evaluated; a design that diverged has a fitness of -inf."""


@dataclass(frozen=True)
class Search:
    """A search as settings name it: ``evolution.search`` chooses it, ``evolution.NAME`` are its settings."""

    name: str
    settings: type[Parameters]  # an Optimiser
    package: str = ""  # that it imports and that only the extra `search` installs


SEARCHES: dict[str, Search] = {}  # searches by name

PAPERS_SEARCH = "afpo"

SearchName: TypeAlias = str  # name of a registered search


def register_search(search: Search) -> None:
    """Add a search to the registry; raise ValueError if the name is taken."""
    register(SEARCHES, "search", search.name, search)


def require_search(name: SearchName) -> None:
    """Raise ValueError if the package of a search is not installed."""
    package = SEARCHES[name].package
    if package and find_spec(package) is None:
        raise ValueError(
            f"search is {name}, expected the package {package} that it needs, which is not installed: run "
            "`make setup EXTRAS=search` in the checkout; without a checkout, `pip install 'puddle[search]'`"
        )
