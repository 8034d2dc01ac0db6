"""Genes: their bounds and units, and designs as arrays of them. Paper, "Evolutionary Design".

A design is a kinematic tree of 2 to 12 rectangular links in topological order (parent < child), one frequency, and one
motor per joint; the paper's have six links. Link 0 is the root. Joint i connects link i to its parent, so the root has
no joint: its joint genes are ignored, and always zero, so that equal designs have equal arrays. Arrays have room for
the largest design: links that another lacks come last, have the parent -1, and zero for every gene.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tasks.arrays import ArrayData, Bools, Float64, Int64
from tasks.compiled import compiled, inline
from tasks.design.controllers import OPEN_LOOP, controller_named
from tasks.design.gene import GENES, PER_DESIGN, DesignError, Gene

N_LINKS = 6  # links of the paper's designs, including the root
LEAST_LINKS, MOST_LINKS = 2, 12

NO_LINK = -1  # parent of the root, and of a link that a design lacks

DesignTable = Float64  # (n_designs, n_columns) table of designs, which variation and selection operate on


@dataclass(frozen=True, eq=False, repr=False)
class Designs(ArrayData):
    """Designs as a struct of arrays, (n_designs, n_links) except for the frequency.

    All have one controller, whose own genes are their gains. Designs with the same genes are equal, so that they can be
    members of a set and keys of a dictionary.

    Raises:
        DesignError: the shapes do not agree. :func:`check` checks values.
    """

    length_scale: Float64  # long axis of a link, its height [m]; the width is the reciprocal
    parent: Int64  # index of the parent link, less than the link's own; -1 for the root
    parent_attachment: Float64  # position of the joint on the parent's long axis [half heights]
    child_attachment: Float64  # position of the joint on the link's own long axis [half heights]
    rest_angle: Float64  # angle relative to the parent at rest [rad]
    phase: Float64  # phase of the joint's oscillation [rad]
    motion_range: Float64  # amplitude of the joint's oscillation [rad]
    motor_on: Bools  # whether the joint's motor is on; otherwise the joint is passive
    frequency: Float64  # (n_designs,) frequency of all joints' oscillations [Hz]
    controller: str = OPEN_LOOP  # name of the controller
    gains: Float64 = field(default_factory=lambda: np.zeros((0, 0, 0)))
    """(n_designs, n_gains, n_links) the controller's own genes; 0 if not given."""

    def __post_init__(self) -> None:
        for name, dtype in DTYPES.items():
            array = getattr(self, name)
            if type(array) is not np.ndarray or array.dtype != dtype:
                object.__setattr__(self, name, _converted(name, array, dtype))
        widths = [np.atleast_2d(getattr(self, name)).shape[1] for name in DTYPES if name not in PER_DESIGN]
        room = min(max(statistics.mode(widths), LEAST_LINKS), MOST_LINKS)
        n_designs = self.frequency.size
        shapes = (n_designs, room), (n_designs,)
        for name in ("frequency", *DTYPES):  # frequency first: it defines n_designs
            shape = getattr(self, name).shape
            if shape != shapes[name in PER_DESIGN]:
                raise DesignError(
                    f"designs: {name} has shape {shape}, expected (n_designs, {room}) "
                    f"and {', '.join(PER_DESIGN)} (n_designs,), with the same n_designs throughout, "
                    f"and room for {LEAST_LINKS} to {MOST_LINKS} links"
                )
        expected = n_designs, len(controller_named(self.controller).genes), room
        gains = _converted("gains", self.gains, np.float64) if np.size(self.gains) else np.zeros(expected)
        if gains.shape != expected:
            raise DesignError(f"designs: gains of {self.controller} have shape {gains.shape}, expected {expected}")
        object.__setattr__(self, "gains", gains)

    def __len__(self) -> int:
        return int(self.frequency.shape[0])

    @property
    def room(self) -> int:
        """Links that the arrays have room for."""
        return int(self.parent.shape[1])

    @property
    def n_links(self) -> Int64:
        """(n_designs,) number of links of each design."""
        return np.asarray(1 + (self.parent >= 0).sum(axis=1))

    def with_room(self, room: int) -> Designs:
        """Return the designs with room for a number of links, which none exceeds."""
        kept, added = min(room, self.room), max(room - self.room, 0)
        if not added and kept == self.room:
            return self
        stored: dict[str, Any] = {}
        for name, array in self._stored():
            beyond = ((0, 0),) * (array.ndim - 1) + ((0, added),)
            fill = NO_LINK if name == "parent" else 0
            stored[name] = array if name in PER_DESIGN else np.pad(array[..., :kept], beyond, constant_values=fill)
        return self._of(stored)

    def by_number_of_links(self) -> list[tuple[Int64, Designs]]:
        """Split into designs with equally many links, and just the room for them; with the indices of each."""
        n_links = self.n_links
        if (n_links == self.room).all():
            return [(np.arange(len(self)), self)]
        groups = [(np.flatnonzero(n_links == number), int(number)) for number in np.unique(n_links)]
        return [
            (which, (self if len(which) == len(self) else self[which]).with_room(number)) for which, number in groups
        ]

    def __repr__(self) -> str:
        return super().__repr__() + (f" of controller {self.controller}" if self.controller != OPEN_LOOP else "")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Designs) or self.controller != other.controller:
            return False
        return np.array_equal(self.compact().table, other.compact().table)

    def __hash__(self) -> int:
        return hash((self.compact().table + 0.0).tobytes())  # -0.0 and 0.0 are equal

    def compact(self) -> Designs:
        """Return the designs with no more room than the largest needs."""
        return self.with_room(int(self.n_links.max(initial=LEAST_LINKS)))

    def __getitem__(self, index: npt.ArrayLike | slice) -> Designs:
        """Select designs by a slice, indices or a mask; a single index selects one design."""
        if isinstance(index, slice):
            return self._of({name: array[index] for name, array in self._stored()})
        chosen = np.atleast_1d(np.asarray(index))
        if chosen.dtype == np.bool_:
            chosen = np.arange(len(self))[chosen]  # also rejects a mask of another length
        # take is several times faster than indexing with an array.
        return self._of({name: array.take(chosen, axis=0) for name, array in self._stored()})

    def _stored(self) -> Iterator[tuple[str, npt.NDArray[Any]]]:
        return ((name, getattr(self, name)) for name in (*DTYPES, "gains"))

    def _of(self, stored: dict[str, Any]) -> Designs:
        return Designs(**stored, controller=self.controller)

    def arrays(self) -> Iterator[tuple[str, npt.NDArray[Any]]]:
        """Iterate over the genes' names and arrays: the fields in the order of declaration, and the gains."""
        for name in DTYPES:
            yield name, getattr(self, name)
        for number, gene in enumerate(controller_named(self.controller).genes):
            yield gene.name, self.gains[:, number]

    @staticmethod
    def from_arrays(arrays: Mapping[str, npt.ArrayLike]) -> Designs:
        """Create designs from their genes by name; other arrays in the mapping are ignored.

        Raises:
            DesignError: they have genes of two controllers, or lack some.
        """
        names = sorted({name.partition(".")[0] for name in arrays if "." in name})
        if len(names) > 1:
            raise DesignError(f"designs: genes of the controllers {' and '.join(names)}, expected those of one")
        genes = controller_named(*names).genes if names else ()
        if missing := [name for name in (*DTYPES, *(gene.name for gene in genes)) if name not in arrays]:
            raise DesignError(f"expected every gene, got none for {', '.join(missing)}")
        stored: dict[str, Any] = {name: arrays[name] for name in DTYPES}
        if genes:
            of_genes = {gene.name: _converted(gene.name, arrays[gene.name], np.float64) for gene in genes}
            for name, array in of_genes.items():
                if array.shape != np.shape(stored["phase"]):
                    raise DesignError(f"designs: {name} has shape {array.shape}, expected that of phase")
            stored |= {"gains": np.stack(list(of_genes.values()), axis=1), "controller": names[0]}
        return Designs(**stored)

    @cached_property
    def table(self) -> DesignTable:
        """(n_designs, n_columns) exact, read-only table of all numbers: at COLUMNS, and the gains, gene by gene."""
        several = [array[:, None] if name in PER_DESIGN else array for name, array in self.arrays()]
        table = np.ascontiguousarray(np.concatenate(several, axis=1, dtype=np.float64))
        table.flags.writeable = False
        return table

    @staticmethod
    def from_table(table: DesignTable, controller: str = OPEN_LOOP) -> Designs:
        """Create designs that share the memory of a table, which must not be changed any more."""
        of_link = N_PER_LINK + len(controller_named(controller).genes)
        room, left = divmod(table.shape[-1] - len(PER_DESIGN), of_link)
        if table.ndim != 2 or left or not LEAST_LINKS <= room <= MOST_LINKS or table.dtype != np.float64:
            raise DesignError(
                f"designs: expected a table (n_designs, n_links · {of_link} + {len(PER_DESIGN)}) float64, of "
                f"{LEAST_LINKS} to {MOST_LINKS} links, got {table.shape} {table.dtype}"
            )
        view = table.view()
        view.flags.writeable = False
        designs = object.__new__(Designs)
        designs.__dict__.update(table=view, controller=controller)
        return designs

    if not TYPE_CHECKING:  # a type checker would accept any attribute

        def __getattr__(self, name: str) -> npt.NDArray[Any]:
            """Read a field from the table when first used: evolution makes many designs and uses few fields."""
            if (name not in DTYPES and name != "gains") or "table" not in self.__dict__:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            n_gains = len(controller_named(self.controller).genes)
            room = self.table.shape[1] // (N_PER_LINK + n_gains)
            if name == "gains":
                array = self.table[:, room * N_PER_LINK + len(PER_DESIGN) :].reshape(len(self.table), n_gains, room)
            else:
                columns = columns_of(room)[name]
                array = self.table[:, columns.start if name in PER_DESIGN else columns]
            if DTYPES.get(name, np.float64) is not np.float64:
                array = array.astype(DTYPES[name])
                array.flags.writeable = False
            self.__dict__[name] = array
            return array

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle the fields alone."""
        return Designs, tuple(getattr(self, declared.name) for declared in fields(Designs))

    def to_vector(self) -> Float64:
        """Return (n_designs, n_reals) numbers in [0, 1], for optimisers of real vectors; see :meth:`from_vector`."""
        if (self.n_links < self.room).any():
            raise DesignError(f"designs: links are {set(self.n_links.tolist())}, expected equally many of all designs")
        of = table_of(self.controller, self.room)
        low, is_parent = of.columns.low[of.reals], of.columns.is_parent[of.reals]
        shown: Float64 = (self.table[:, of.reals] + is_parent / 2 - low) / of.real_span
        return shown

    @staticmethod
    def from_vector(vector: npt.ArrayLike, controller: str = OPEN_LOOP) -> Designs:
        """Return the designs of (n_designs, n_reals) numbers in [0, 1]; every such vector is a valid design.

        Intervals, angles and gains are scaled from their bounds, a motor is on from 1/2, and the parent of link i is
        link ⌊i u⌋, with u the number. The order is that of the table, link by link, without what a root ignores.

        Args:
            vector: (n_designs, n_reals), or (n_reals,) of one design; 41 of six links with the paper's controller.
            controller: of the designs.

        Raises:
            DesignError: the shape is another one, or a number is not in [0, 1].
        """
        given = np.atleast_2d(np.asarray(vector, dtype=np.float64))
        tables = {len(of.reals): of for of in (table_of(controller, n) for n in range(LEAST_LINKS, MOST_LINKS + 1))}
        if given.ndim != 2 or given.shape[1] not in tables:
            expected = " or ".join(map(str, tables))
            raise DesignError(f"vector: expected shape (n_designs, {expected}), got {np.shape(vector)}")
        of = tables[given.shape[1]]
        reals = of.reals
        if (outside := np.argwhere(~((given >= 0) & (given <= 1)))).size:
            design, place = outside[0]
            gene, link = of.gene_of_column[reals[place]], of.columns.link[reals[place]]
            name = gene.name if gene else "parent"
            where = "" if name in PER_DESIGN else f" of link {link}"
            raise DesignError(f"vector: [{design}, {place}], {name}{where}, is {given[design, place]}, expected 0 to 1")
        is_parent, is_flag = of.columns.is_parent[reals], of.columns.is_flag[reals]
        numbers = np.minimum(of.columns.low[reals] + given * of.real_span, of.columns.high[reals])
        numbers[:, is_parent] = np.floor(numbers[:, is_parent])
        numbers[:, is_flag] = given[:, is_flag] >= 0.5
        table = np.zeros((len(given), len(of.gene_of_column)))
        table[:, of.columns.parent] = NO_LINK
        table[:, reals] = numbers
        return Designs.from_table(table, controller)

    @staticmethod
    def concatenate(several: Sequence[Designs]) -> Designs:
        """Join designs, at least one of them, in the given order, with room for the largest.

        Raises:
            DesignError: their controllers differ.
        """
        (controller, *others) = sorted({part.controller for part in several})
        if others:
            raise DesignError(f"designs: controllers {', '.join((controller, *others))}, expected one of all designs")
        room = max(part.room for part in several)
        return Designs.from_table(np.concatenate([part.with_room(room).table for part in several]), controller)

    def _repr_html_(self) -> str | None:
        from tasks.design.drawing import drawn  # it builds on bodies, which build on designs

        return None if _find_fault(self.table, table_of(self.controller, self.room).columns)[0] >= 0 else drawn(self)


DTYPES: dict[str, type[np.generic]] = {
    name: {"parent": np.int64, **{gene.name: np.bool_ for gene in GENES if gene.kind == "flag"}}.get(name, np.float64)
    for name in (declared.name for declared in fields(Designs))
    if name not in ("controller", "gains")
}
"""Dtype of each field of Designs that is a gene, in the order of declaration."""


N_PER_LINK = len(DTYPES) - len(PER_DESIGN)  # columns of each link, but its gains
FIRST = {name: number for number, name in enumerate(DTYPES)}
"""First column of each field, over the number of links that a table has room for: fields of the design come last."""


@cache
def columns_of(room: int) -> dict[str, slice]:
    """Return the columns of each field in a table with room for a number of links; those of the gains follow."""
    ends = np.cumsum([1 if name in PER_DESIGN else room for name in DTYPES]).tolist()
    return dict(zip(DTYPES, map(slice, [0, *ends], ends), strict=True))


def _converted(name: str, values: npt.ArrayLike, dtype: type[np.generic]) -> npt.NDArray[Any]:
    """Convert to a field's dtype, unless that would change values."""
    given = np.asarray(values)
    array = given.astype(dtype)
    if dtype is not np.float64 and not np.array_equal(array, given):
        raise DesignError(f"designs: {name}: expected values of type {np.dtype(dtype).name}, got {given.tolist()}")
    return array


class GeneColumns(NamedTuple):
    """What the columns of a table hold, as kernels take it, each (n_columns,) unless it says otherwise."""

    low: Float64  # a parent is a whole number: -1 of the root, else a link before
    high: Float64
    is_parent: Bools
    is_flag: Bools
    is_angle: Bools
    is_gain: Bools
    is_ignored: Bools  # genes of the root's joint
    link: Int64  # link of each column; -1 for columns of the whole design
    first: Int64  # (n_genes,) column of each gene's first number, including the root's
    end: Int64  # (n_genes,) column after each gene's last number
    room: int  # links that the table has room for
    parent: int  # column of the root's parent, followed by those of the other links


@dataclass(frozen=True, eq=False)
class GeneTable:
    """The genes of all designs with one controller, and what the columns of their tables hold."""

    genes: tuple[Gene, ...]  # those of every design, and the controller's own
    gene_of_column: tuple[Gene | None, ...]  # None of parents
    columns: GeneColumns
    n_genes: int  # numbers of a design without its tree: 37 with the paper's controller
    reals: Int64  # columns of the numbers that tell designs apart; the parent of link 1 is always the root
    real_span: Float64  # (n_reals,) range of each; link i has i possible parents


def table_of(controller: str, room: int = N_LINKS) -> GeneTable:
    """Return the table of genes of designs with a controller, and room for a number of links."""
    return _table(controller_named(controller).genes, room)


@cache
def _table(gains: tuple[Gene, ...], room: int) -> GeneTable:
    genes = {gene.name: gene for gene in (*GENES, *gains)}
    slices = dict(columns_of(room))
    for gain in gains:
        end = max(columns.stop for columns in slices.values())
        slices[gain.name] = slice(end, end + room)
    gene_of = [genes.get(name) for name, columns in slices.items() for _ in range(columns.start, columns.stop)]
    link_of = np.concatenate([[-1] if name in PER_DESIGN else np.arange(room) for name in slices])
    is_parent = np.array([gene is None for gene in gene_of])
    is_flag, is_angle, is_gain = (
        np.array([gene is not None and gene.kind == kind for gene in gene_of]) for kind in ("flag", "angle", "gain")
    )
    columns = GeneColumns(
        low=np.array([gene.low if gene else min(k - 1, 0) for gene, k in zip(gene_of, link_of, strict=True)]),
        high=np.array([gene.high if gene else k - 1 for gene, k in zip(gene_of, link_of, strict=True)]),
        is_parent=is_parent,
        is_flag=is_flag,
        is_angle=is_angle,
        is_gain=is_gain,
        is_ignored=(link_of == 0) & [gene is not None and not gene.of_root for gene in gene_of],
        link=link_of,
        first=np.array([slices[name].start for name in genes]),
        end=np.array([slices[name].stop for name in genes]),
        room=room,
        parent=slices["parent"].start,
    )
    reals = np.flatnonzero(~columns.is_ignored & (columns.low < columns.high))
    return GeneTable(
        genes=tuple(genes.values()),
        gene_of_column=tuple(gene_of),
        columns=columns,
        n_genes=int((~is_parent & ~columns.is_ignored).sum()),
        reals=reals,
        real_span=columns.high[reals] + is_parent[reals] - columns.low[reals],
    )


N_GENES = table_of(OPEN_LOOP).n_genes  # 37


@inline
def count_links(parent: Float64) -> int:
    """Count the links of a design by their parents."""
    n_links = 1
    for link in range(1, len(parent)):
        n_links += parent[link] >= 0.0
    return n_links


def find_fault(table: DesignTable, of: GeneColumns) -> tuple[int, int]:
    """Return row and column of the first invalid number; -1 and -1 if there is none."""
    for design in range(len(table)):
        n_links = LEAST_LINKS
        for link in range(LEAST_LINKS, of.room):
            if not table[design, of.parent + link] < 0.0:
                n_links = link + 1
        for column in range(table.shape[1]):
            value, whole = table[design, column], of.is_parent[column] or of.is_flag[column]
            if of.link[column] >= n_links:
                if value != (NO_LINK if of.is_parent[column] else 0.0):
                    return design, column
            elif not of.is_ignored[column] and (
                not of.low[column] <= value <= of.high[column] or (whole and value != np.floor(value))  # NaN too
            ):
                return design, column
    return -1, -1


_find_fault = compiled(find_fault, seconds=1)


def check(designs: Designs) -> None:
    """Check that trees are valid and genes within their bounds.

    Raises:
        DesignError: names the first invalid number by the design's index, gene and link.
    """
    of = table_of(designs.controller, designs.room)
    design, column = _find_fault(designs.table, of.columns)
    if design < 0:
        return
    value, link, gene = designs.table[design, column], of.columns.link[column], of.gene_of_column[column]
    n_links = max(LEAST_LINKS, int(np.flatnonzero(designs.parent[design] >= 0).max(initial=0)) + 1)
    if link >= n_links:
        lacks, name = f"{NO_LINK if gene is None else 0}: it has {n_links} links", gene.name if gene else "parent"
        raise DesignError(f"design {design}: {name} of link {link} is {value:g}, expected {lacks}")
    if gene is None:
        expected = "-1 (it is the root)" if link == 0 else f"a link before it, 0 to {link - 1}"
        raise DesignError(f"design {design}: parent of link {link} is {value:g}, expected {expected}")
    where = f" of link {link}" if gene.per_link else ""
    bounds = f"{gene.low:.6g} {'or' if gene.kind == 'flag' else 'to'} {gene.high:.6g} {gene.unit}".rstrip()
    raise DesignError(f"design {design}: {gene.name}{where} is {value}, expected {bounds}")
