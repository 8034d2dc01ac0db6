"""Genes: their bounds and units, and designs as arrays of them. Paper, "Evolutionary Design".

A design is a kinematic tree of six rectangular links in topological order (parent < child), one frequency, and one
motor per joint. Link 0 is the root. Joint i connects link i to its parent, so the root has no joint: its joint genes
are ignored, and always zero, so that equal designs have equal arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from tasks.arrays import ArrayData, Bools, Float64, Int64
from tasks.compiled import compiled

N_LINKS = 6  # links of a design, including the root; tasks/simulation/trees/step.py lists its joints
N_JOINTS = N_LINKS - 1

ROOT_PARENT = -1  # parent of the root

DesignTable = Float64  # (n_designs, N_COLUMNS) table of designs, which variation and selection operate on

GenePart = Literal["body", "control"]
Kind = Literal["interval", "angle", "flag"]


@dataclass(frozen=True)
class Gene:
    """One row of the table of genes.

    An ``interval`` is clipped to [low, high]; an ``angle`` wraps around at high, where it equals low; a ``flag`` is
    False or True.
    """

    name: str
    part: GenePart
    kind: Kind
    low: float
    high: float
    unit: str
    of_root: bool  # whether the root has this gene too
    per_link: bool = True  # whether each link has one; otherwise the design has one


GENES: tuple[Gene, ...] = (
    #    name                 part       kind        low     high         unit             of_root
    Gene("length_scale", "body", "interval", 1.0, 3.0, "m", True),
    Gene("parent_attachment", "body", "interval", -1.0, 1.0, "half heights", False),
    Gene("child_attachment", "body", "interval", -1.0, 1.0, "half heights", False),
    Gene("rest_angle", "body", "angle", -np.pi, np.pi, "rad", False),
    Gene("phase", "control", "angle", 0.0, 2.0 * np.pi, "rad", False),
    Gene("motion_range", "control", "interval", 0.2, np.pi / 2.0, "rad", False),
    Gene("motor_on", "control", "flag", 0.0, 1.0, "", False),
    Gene("frequency", "control", "interval", 0.0, 0.3, "Hz", True, per_link=False),
)
"""All genes except the tree (``parent``), which :func:`tasks.design.variation.mutate` rewires."""

PER_DESIGN = tuple(gene.name for gene in GENES if not gene.per_link)  # fields with one number per design


class DesignError(ValueError):
    """An invalid design; the message names design and gene, the expected and the received value."""


@dataclass(frozen=True, eq=False, repr=False)
class Designs(ArrayData):
    """Designs as a struct of arrays, (n_designs, n_links) except for the frequency.

    Designs with the same genes are equal, so that they can be members of a set and keys of a dictionary.

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

    def __len__(self) -> int:
        return int(self.frequency.shape[0])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Designs) and np.array_equal(self.table, other.table)

    def __hash__(self) -> int:
        return hash((self.table + 0.0).tobytes())  # -0.0 and 0.0 are equal

    def __getitem__(self, index: npt.ArrayLike | slice) -> Designs:
        """Select designs by a slice, indices or a mask; a single index selects one design."""
        if isinstance(index, slice):
            return Designs(**{name: array[index] for name, array in self.arrays()})
        chosen = np.atleast_1d(np.asarray(index))
        if chosen.dtype == np.bool_:
            chosen = np.arange(len(self))[chosen]  # also rejects a mask of another length
        # take is several times faster than indexing with an array.
        return Designs(**{name: array.take(chosen, axis=0) for name, array in self.arrays()})

    def arrays(self) -> Iterator[tuple[str, npt.NDArray[Any]]]:
        """Iterate over the fields' names and arrays, in the order of declaration."""
        for name in DTYPES:
            yield name, getattr(self, name)

    @staticmethod
    def from_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> Designs:
        """Create designs from their fields; other arrays in the mapping are ignored."""
        return Designs(**{name: arrays[name] for name in DTYPES})

    @cached_property
    def table(self) -> DesignTable:
        """(n_designs, N_COLUMNS) exact, read-only table of all numbers, at COLUMNS."""
        several = [array[:, None] if name in PER_DESIGN else array for name, array in self.arrays()]
        table = np.ascontiguousarray(np.concatenate(several, axis=1, dtype=np.float64))
        table.flags.writeable = False
        return table

    @staticmethod
    def from_table(table: DesignTable) -> Designs:
        """Create designs that share the memory of a table, which must not be changed any more.

        Raises:
            DesignError: the table is not (n_designs, N_COLUMNS) of float64.
        """
        if table.shape[1:] != (N_COLUMNS,) or table.dtype != np.float64:
            raise DesignError(
                f"designs: expected a table (n_designs, {N_COLUMNS}) float64, got {table.shape} {table.dtype}"
            )
        view = table.view()
        view.flags.writeable = False
        designs = object.__new__(Designs)
        designs.__dict__["table"] = view
        return designs

    if not TYPE_CHECKING:  # a type checker would accept any attribute

        def __getattr__(self, name: str) -> npt.NDArray[Any]:
            """Read a field from the table when first used: evolution makes many designs and uses few fields."""
            if name not in COLUMNS or "table" not in self.__dict__:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            columns = COLUMNS[name]
            field = self.table[:, columns.start if name in PER_DESIGN else columns]
            if DTYPES[name] is not np.float64:
                field = field.astype(DTYPES[name])
                field.flags.writeable = False
            self.__dict__[name] = field
            return field

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle the fields alone."""
        return Designs, tuple(array for _, array in self.arrays())

    def to_vector(self) -> Float64:
        """Return (n_designs, N_REALS) numbers in [0, 1], for optimisers of real vectors; see :meth:`from_vector`."""
        shown: Float64 = (self.table[:, REALS] + IS_PARENT[REALS] / 2 - LOW[REALS]) / REAL_SPAN
        return shown

    @staticmethod
    def from_vector(vector: npt.ArrayLike) -> Designs:
        """Return the designs of (n_designs, N_REALS) numbers in [0, 1]; every such vector is a valid design.

        Intervals and angles are scaled from their bounds, a motor is on from 1/2, and the parent of link i is link
        ⌊i u⌋, with u the number. The order is that of the fields, link by link, without what a root ignores.

        Args:
            vector: (n_designs, N_REALS), or (N_REALS,) of one design.

        Raises:
            DesignError: the shape is another one, or a number is not in [0, 1].
        """
        given = np.atleast_2d(np.asarray(vector, dtype=np.float64))
        if given.ndim != 2 or given.shape[1] != N_REALS:
            raise DesignError(f"vector: expected shape (n_designs, {N_REALS}), got {np.shape(vector)}")
        if (outside := np.argwhere(~((given >= 0) & (given <= 1)))).size:
            design, place = outside[0]
            name, link = next(n for n, at in COLUMNS.items() if REALS[place] < at.stop), LINK_OF_COLUMN[REALS[place]]
            where = "" if name in PER_DESIGN else f" of link {link}"
            raise DesignError(f"vector: [{design}, {place}], {name}{where}, is {given[design, place]}, expected 0 to 1")
        numbers = np.minimum(LOW[REALS] + given * REAL_SPAN, HIGH[REALS])
        numbers[:, IS_PARENT[REALS]] = np.floor(numbers[:, IS_PARENT[REALS]])
        numbers[:, IS_FLAG[REALS]] = given[:, IS_FLAG[REALS]] >= 0.5
        table = np.zeros((len(given), N_COLUMNS))
        table[:, PARENT_COLUMN] = ROOT_PARENT
        table[:, REALS] = numbers
        return Designs.from_table(table)

    @staticmethod
    def concatenate(several: Sequence[Designs]) -> Designs:
        """Join designs, at least one of them, in the given order."""
        return Designs.from_table(np.concatenate([part.table for part in several]))

    def _repr_html_(self) -> str | None:
        from tasks.design.drawing import drawn  # it builds on bodies, which build on designs

        return None if _find_fault(self.table)[0] >= 0 else drawn(self)


DTYPES: dict[str, type[np.generic]] = {
    field.name: {"parent": np.int64, **{gene.name: np.bool_ for gene in GENES if gene.kind == "flag"}}.get(
        field.name, np.float64
    )
    for field in fields(Designs)
}
"""Dtype of each field of Designs, in the order of declaration."""


_ENDS = np.cumsum([1 if name in PER_DESIGN else N_LINKS for name in DTYPES]).tolist()
COLUMNS = dict(zip(DTYPES, map(slice, [0, *_ENDS], _ENDS), strict=True))  # columns of each field, link by link
N_COLUMNS = _ENDS[-1]  # columns of a table of designs: 49, including the ignored genes of roots
PARENT_COLUMN = COLUMNS["parent"].start  # column of the root's parent, followed by those of the other links
LINK_OF_COLUMN = np.concatenate([[N_LINKS] if name in PER_DESIGN else np.arange(N_LINKS) for name in COLUMNS])
"""(N_COLUMNS,) link of each column; N_LINKS for columns of the whole design."""


def _converted(name: str, values: npt.ArrayLike, dtype: type[np.generic]) -> npt.NDArray[Any]:
    """Convert to a field's dtype, unless that would change values."""
    given = np.asarray(values)
    array = given.astype(dtype)
    if dtype is not np.float64 and not np.array_equal(array, given):
        raise DesignError(f"designs: {name}: expected values of type {np.dtype(dtype).name}, got {given.tolist()}")
    return array


FIRST = np.array([COLUMNS[gene.name].start for gene in GENES])
"""(n_genes,) column of each gene's first number in a table of designs, including the root's."""
END = np.array([COLUMNS[gene.name].stop for gene in GENES])  # (n_genes,) column after each gene's last number

# What the columns of a table hold, each (N_COLUMNS,). A parent is a whole number: -1 of the root, else a link before.
GENE_OF_COLUMN = [
    next((g for g in GENES if g.name == name), None) for name in COLUMNS for _ in range(N_COLUMNS)[COLUMNS[name]]
]
IS_PARENT = np.array([gene is None for gene in GENE_OF_COLUMN])
IS_FLAG, IS_ANGLE = (
    np.array([gene is not None and gene.kind == kind for gene in GENE_OF_COLUMN]) for kind in ("flag", "angle")
)
IS_IGNORED = (LINK_OF_COLUMN == 0) & [gene is not None and not gene.of_root for gene in GENE_OF_COLUMN]
LOW = np.array(
    [gene.low if gene else min(link - 1, 0) for gene, link in zip(GENE_OF_COLUMN, LINK_OF_COLUMN, strict=True)]
)
HIGH = np.array([gene.high if gene else link - 1 for gene, link in zip(GENE_OF_COLUMN, LINK_OF_COLUMN, strict=True)])
N_GENES = int((~IS_PARENT & ~IS_IGNORED).sum())  # numbers of a design without its tree: 37

REALS = np.flatnonzero(~IS_IGNORED & (LOW < HIGH))
"""(N_REALS,) columns of the numbers that tell designs apart; the parent of link 1 is always the root."""
N_REALS = len(REALS)  # 41
REAL_SPAN = HIGH[REALS] + IS_PARENT[REALS] - LOW[REALS]  # link i has i possible parents


def find_fault(table: DesignTable) -> tuple[int, int]:
    """Return row and column of the first invalid number; -1 and -1 if there is none."""
    for design in range(len(table)):
        for column in range(N_COLUMNS):
            value, whole = table[design, column], IS_PARENT[column] or IS_FLAG[column]
            if not IS_IGNORED[column] and (
                not LOW[column] <= value <= HIGH[column] or (whole and value != np.floor(value))  # NaN too
            ):
                return design, column
    return -1, -1


_find_fault = compiled(find_fault, seconds=1)


def check(designs: Designs) -> None:
    """Check that trees are valid and genes within their bounds.

    Raises:
        DesignError: names the first invalid number by the design's index, gene and link.
    """
    design, column = _find_fault(designs.table)
    if design < 0:
        return
    value, link = designs.table[design, column], LINK_OF_COLUMN[column]
    gene = GENE_OF_COLUMN[column]
    if gene is None:
        expected = "-1 (it is the root)" if link == 0 else f"a link before it, 0 to {link - 1}"
        raise DesignError(f"design {design}: parent of link {link} is {value:g}, expected {expected}")
    where = f" of link {link}" if gene.per_link else ""
    bounds = f"{gene.low:.6g} {'or' if gene.kind == 'flag' else 'to'} {gene.high:.6g} {gene.unit}".rstrip()
    raise DesignError(f"design {design}: {gene.name}{where} is {value}, expected {bounds}")
