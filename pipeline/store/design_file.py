"""Designs in files: one as JSON, design.json, and many as Parquet."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.encoding import decode_document, encode_document
from tasks.design import DesignError, Designs, check
from tasks.design.genes import DTYPES

DESIGN_SCHEMA, DESIGN_VERSION = "puddle.design", 1

_DESIGN_JSON = "design_json"  # column of the table of champions


def design_json(design: Designs) -> bytes:
    """Return the design file of one design."""
    fields = {name: array[0].tolist() for name, array in design.compact().arrays()}
    return encode_document(fields, schema=DESIGN_SCHEMA, version=DESIGN_VERSION)


def design_from(data: bytes, source: str) -> Designs:
    """Return the design in a design file, which messages call ``source``; the error names the faulty gene."""
    document = decode_document(data, schema=DESIGN_SCHEMA, version=DESIGN_VERSION, source=source)
    genes = {name: [value] for name, value in document.items() if name not in ("schema", "version")}
    designs = _designs(genes, source)
    known = dict(designs.arrays())
    if unknown := [name for name in genes if name not in known]:
        raise PuddleError(f"{source}: expected the genes {', '.join(known)}, got {', '.join(unknown)}, too")
    return designs


def load_design(path: str | Path) -> Designs:
    """Read a design file, such as those of `puddle export`; raise PuddleError if it is none.

    >>> puddle.save_design(puddle.random_designs(1, np.random.default_rng(seed=1)), "design.json")
    >>> len(puddle.load_design("design.json"))
    1
    """
    return design_from(disk.read(Path(path)), str(path))


def save_design(design: Designs, path: str | Path) -> None:
    """Write one design to a file that every command takes; raise PuddleError if it is not one valid design.

    >>> designs = puddle.random_designs(64, np.random.default_rng(seed=1))
    >>> puddle.save_design(designs[puddle.simulate(designs, "true_slush").displacement.argmax()], "best.json")
    """
    if len(design) != 1:
        raise PuddleError(f"{path}: expected one design, got {len(design)}: choose one, such as designs[0]")
    data = design_json(design)
    design_from(data, str(path))
    disk.write(Path(path), data)


def open_designs(path: str | Path) -> Designs:
    """Read the designs of a table, such as docs/champions.parquet.

    A Parquet file has a column for each gene, as ``study.table("histories")`` has, or the column ``design_json`` of the
    table of champions; further columns are ignored. A file that ends in .json is a design file.

    >>> designs = puddle.open_designs("docs/champions.parquet")
    >>> designs.length_scale.shape[1]  # links of each
    6

    Raises:
        PuddleError: the file can't be read, holds no design, or a design is invalid; it names the row or column.
    """
    path = Path(path)
    if path.suffix == ".json":
        return load_design(path)
    try:
        table = read_parquet(path.read_bytes())
    except pa.ArrowException as error:
        raise PuddleError(f"{path}: expected a Parquet file or a design file: {error}") from None
    if not len(table):
        raise PuddleError(f"{path}: expected at least one design, got none")
    if _DESIGN_JSON in table.column_names:
        texts = table[_DESIGN_JSON].to_pylist()
        each = [design_from(text.encode(), f"{path}, row {row}") for row, text in enumerate(texts)]
        try:
            return Designs.concatenate(each)
        except DesignError as error:
            raise PuddleError(f"{path}: {error}") from None
    is_gain = {field.name for field in table.schema if "." in field.name and pa.types.is_nested(field.type)}
    names = [name for name in table.column_names if name in DTYPES or name in is_gain]
    return _designs({name: table[name].to_pylist() for name in names}, str(path))


def columns_of_designs(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Read all columns of a table of designs; what is neither a number nor equally many in each row becomes text."""
    columns = {}
    table = read_parquet(path.read_bytes()) if path.suffix != ".json" else pa.table({})
    for name in table.column_names:
        values, column = table[name].to_pylist(), table[name].to_numpy()
        with contextlib.suppress(ValueError):  # lists of different lengths
            column = column if column.dtype.kind in "biuf" else np.array(values)
        is_text = column.dtype.kind not in "biuf"
        columns[name] = np.array(["" if value is None else str(value) for value in values]) if is_text else column
    return columns


def _designs(genes: Mapping[str, Any], source: str) -> Designs:
    try:
        designs = Designs.from_arrays({name: _numbers(name, values) for name, values in genes.items()})
        check(designs)
    except ValueError as error:  # DesignError is one
        raise PuddleError(f"{source}: {str(error).removeprefix('design 0: ')}") from None
    return designs


def _numbers(name: str, values: Any) -> npt.NDArray[Any]:
    try:
        numbers = np.array(values)
    except ValueError:  # lists of different lengths
        numbers = np.array(None)
    if numbers.dtype.kind not in "biuf":
        raise ValueError(f"{name}: expected numbers, equally many of each design, got {str(values)[:100]}")
    return numbers


def read_parquet(content: bytes) -> pa.Table:
    """Read a table without threads of Arrow's, with which a process that ends at once may abort with exit code 134."""
    return pq.ParquetFile(pa.BufferReader(content)).read(use_threads=False)
