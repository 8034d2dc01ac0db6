"""Genes: their bounds and units, and designs as arrays of them. Paper, "Evolutionary Design".

A design is a kinematic tree of six rectangular links in topological order (parent < child), one frequency, and one
motor per joint. Link 0 is the root. Joint i connects link i to its parent, so the root has no joint: its joint genes
are ignored, and always zero, so that equal designs have equal arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tasks.arrays import ArrayData, Bools, Float64, Int64
from tasks.compiled import compiled
from tasks.design.controllers import OPEN_LOOP, controller_named
from tasks.design.gene import GENES, PER_DESIGN, DesignError, Gene

N_LINKS = 6  # links of a design, including the root; tasks/simulation/trees/step.py lists its joints
N_JOINTS = N_LINKS - 1

ROOT_PARENT = -1  # parent of the root

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
    gains: Float64 = field(default_factory=lambda: np.zeros((0, 0, N_LINKS)))
    """(n_designs, n_gains, n_links) the controller's own genes; 0 if not given."""

    def __post_init__(self) -> None:
        for name, dtype in DTYPES.items():
            array = getattr(self, name)
            if type(array) is not np.ndarray or array.dtype != dtype:
                object.__setattr__(self, name, _converted(name, array, dtype))
        n_designs = self.frequency.size
        shapes = (n_designs, N_LINKS), (n_designs,)
        for name in ("frequency", *DTYPES):  # frequency first: it defines n_designs
            shape = getattr(self, name).shape
            if shape != shapes[name in PER_DESIGN]:
                raise DesignError(
                    f"designs: {name} has shape {shape}, expected (n_designs, {N_LINKS}) "
                    f"and {', '.join(PER_DESIGN)} (n_designs,), with the same n_designs throughout"
                )
        expected = n_designs, len(controller_named(self.controller).genes), N_LINKS
        gains = _converted("gains", self.gains, np.float64) if np.size(self.gains) else np.zeros(expected)
        if gains.shape != expected:
            raise DesignError(f"designs: gains of {self.controller} have shape {gains.shape}, expected {expected}")
        object.__setattr__(self, "gains", gains)

    def __len__(self) -> int:
        return int(self.frequency.shape[0])

    def __repr__(self) -> str:
        return super().__repr__() + (f" of controller {self.controller}" if self.controller != OPEN_LOOP else "")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Designs) or self.controller != other.controller:
            return False
        return np.array_equal(self.table, other.table)

    def __hash__(self) -> int:
        return hash((self.table + 0.0).tobytes())  # -0.0 and 0.0 are equal

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
            of_genes = [_converted(gene.name, arrays[gene.name], np.float64) for gene in genes]
            stored |= {"gains": np.stack(of_genes, axis=1), "controller": names[0]}
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
        """Create designs that share the memory of a table, which must not be changed any more.

        Raises:
            DesignError: the table is not (n_designs, n_columns) of float64.
        """
        n_columns = N_COLUMNS + N_LINKS * len(controller_named(controller).genes)
        if table.shape[1:] != (n_columns,) or table.dtype != np.float64:
            raise DesignError(
                f"designs: expected a table (n_designs, {n_columns}) float64, got {table.shape} {table.dtype}"
            )
        view = table.view()
        view.flags.writeable = False
        designs = object.__new__(Designs)
        designs.__dict__.update(table=view, controller=controller)
        return designs

    if not TYPE_CHECKING:  # a type checker would accept any attribute

        def __getattr__(self, name: str) -> npt.NDArray[Any]:
            """Read a field from the table when first used: evolution makes many designs and uses few fields."""
            if (name not in COLUMNS and name != "gains") or "table" not in self.__dict__:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            if name == "gains":
                of_design = self.table.shape[1] // N_LINKS - N_COLUMNS // N_LINKS, N_LINKS
                array = self.table[:, N_COLUMNS:].reshape(len(self.table), *of_design)
            else:
                columns = COLUMNS[name]
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
        of = table_of(self.controller)
        low, is_parent = of.columns.low[of.reals], of.columns.is_parent[of.reals]
        shown: Float64 = (self.table[:, of.reals] + is_parent / 2 - low) / of.real_span
        return shown

    @staticmethod
    def from_vector(vector: npt.ArrayLike, controller: str = OPEN_LOOP) -> Designs:
        """Return the designs of (n_designs, n_reals) numbers in [0, 1]; every such vector is a valid design.

        Intervals, angles and gains are scaled from their bounds, a motor is on from 1/2, and the parent of link i is
        link ⌊i u⌋, with u the number. The order is that of the table, link by link, without what a root ignores.

        Args:
            vector: (n_designs, n_reals), or (n_reals,) of one design; 41 with the paper's controller.
            controller: of the designs.

        Raises:
            DesignError: the shape is another one, or a number is not in [0, 1].
        """
        of = table_of(controller)
        reals, given = of.reals, np.atleast_2d(np.asarray(vector, dtype=np.float64))
        if given.ndim != 2 or given.shape[1] != len(reals):
            raise DesignError(f"vector: expected shape (n_designs, {len(reals)}), got {np.shape(vector)}")
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
        table[:, PARENT_COLUMN] = ROOT_PARENT
        table[:, reals] = numbers
        return Designs.from_table(table, controller)

    @staticmethod
    def concatenate(several: Sequence[Designs]) -> Designs:
        """Join designs, at least one of them, in the given order; raise DesignError if their controllers differ."""
        (controller, *others) = sorted({part.controller for part in several})
        if others:
            raise DesignError(f"designs: controllers {', '.join((controller, *others))}, expected one of all designs")
        return Designs.from_table(np.concatenate([part.table for part in several]), controller)

    def _repr_html_(self) -> str | None:
        from tasks.design.drawing import drawn  # it builds on bodies, which build on designs

        return None if _find_fault(self.table, table_of(self.controller).columns)[0] >= 0 else drawn(self)


DTYPES: dict[str, type[np.generic]] = {
    name: {"parent": np.int64, **{gene.name: np.bool_ for gene in GENES if gene.kind == "flag"}}.get(name, np.float64)
    for name in (declared.name for declared in fields(Designs))
    if name not in ("controller", "gains")
}
"""Dtype of each field of Designs that is a gene, in the order of declaration."""


_ENDS = np.cumsum([1 if name in PER_DESIGN else N_LINKS for name in DTYPES]).tolist()
COLUMNS = dict(zip(DTYPES, map(slice, [0, *_ENDS], _ENDS), strict=True))  # columns of each field, link by link
N_COLUMNS = _ENDS[-1]  # columns of the fields: 49, including the ignored genes of roots; those of the gains follow
PARENT_COLUMN = COLUMNS["parent"].start  # column of the root's parent, followed by those of the other links


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
    link: Int64  # link of each column; N_LINKS for columns of the whole design
    first: Int64  # (n_genes,) column of each gene's first number, including the root's
    end: Int64  # (n_genes,) column after each gene's last number


@dataclass(frozen=True, eq=False)
class GeneTable:
    """The genes of all designs with one controller, and what the columns of their tables hold."""

    genes: tuple[Gene, ...]  # those of every design, and the controller's own
    gene_of_column: tuple[Gene | None, ...]  # None of parents
    columns: GeneColumns
    n_genes: int  # numbers of a design without its tree: 37 with the paper's controller
    reals: Int64  # columns of the numbers that tell designs apart; the parent of link 1 is always the root
    real_span: Float64  # (n_reals,) range of each; link i has i possible parents


def table_of(controller: str) -> GeneTable:
    """Return the table of genes of designs with a controller."""
    return _table(controller_named(controller).genes)


@cache
def _table(gains: tuple[Gene, ...]) -> GeneTable:
    genes = {gene.name: gene for gene in (*GENES, *gains)}
    starts = {gain.name: slice(N_COLUMNS + N_LINKS * k, N_COLUMNS + N_LINKS * (k + 1)) for k, gain in enumerate(gains)}
    slices = COLUMNS | starts
    gene_of = [genes.get(name) for name, columns in slices.items() for _ in range(columns.start, columns.stop)]
    link_of = np.concatenate([[N_LINKS] if name in PER_DESIGN else np.arange(N_LINKS) for name in slices])
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


def find_fault(table: DesignTable, of: GeneColumns) -> tuple[int, int]:
    """Return row and column of the first invalid number; -1 and -1 if there is none."""
    for design in range(len(table)):
        for column in range(table.shape[1]):
            value, whole = table[design, column], of.is_parent[column] or of.is_flag[column]
            if not of.is_ignored[column] and (
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
    of = table_of(designs.controller)
    design, column = _find_fault(designs.table, of.columns)
    if design < 0:
        return
    value, link, gene = designs.table[design, column], of.columns.link[column], of.gene_of_column[column]
    if gene is None:
        expected = "-1 (it is the root)" if link == 0 else f"a link before it, 0 to {link - 1}"
        raise DesignError(f"design {design}: parent of link {link} is {value:g}, expected {expected}")
    where = f" of link {link}" if gene.per_link else ""
    bounds = f"{gene.low:.6g} {'or' if gene.kind == 'flag' else 'to'} {gene.high:.6g} {gene.unit}".rstrip()
    raise DesignError(f"design {design}: {gene.name}{where} is {value}, expected {bounds}")
