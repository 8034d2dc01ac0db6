"""Designs in files: one as JSON, design.json, and many as Parquet."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ConfigDict, ValidationError, conlist, create_model

from pipeline.errors import PuddleError
from pipeline.store.encoding import check_format, decode_json, encode_json
from tasks.design import N_LINKS, DesignError, Designs, check
from tasks.design.genes import DTYPES, PER_DESIGN, concatenate

DESIGN_SCHEMA, DESIGN_VERSION = "puddle.design", 1

_DESIGN_JSON = "design_json"  # column of the table of champions


def _field_type(name: str) -> Any:
    kind = {np.bool_: bool, np.int64: int}.get(DTYPES[name], float)
    return kind if name in PER_DESIGN else conlist(kind, min_length=N_LINKS, max_length=N_LINKS)


_FIELDS: dict[str, Any] = {name: (_field_type(name), ...) for name in DTYPES}
_Document = create_model("_Document", __config__=ConfigDict(extra="forbid", strict=True), **_FIELDS)


def design_document(design: Designs) -> dict[str, Any]:
    """Return one design as plain values."""
    fields = {name: array[0].tolist() for name, array in design.arrays()}
    return {"schema": DESIGN_SCHEMA, "version": DESIGN_VERSION, **fields}


def design_from(document: Any, source: str) -> Designs:
    """Return the design in a parsed design file, which messages call ``source``; the error names the faulty field."""
    check_format(document, schema=DESIGN_SCHEMA, version=DESIGN_VERSION, source=source)
    try:
        fields = _Document(**{name: value for name, value in document.items() if name not in ("schema", "version")})
        design = Designs(**{name: np.array([getattr(fields, name)], dtype) for name, dtype in DTYPES.items()})
        check(design)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(map(str, first["loc"]))
        raise PuddleError(f"{source}: {name}: {first['msg']}, got {str(first['input'])[:100]}") from None
    except (DesignError, OverflowError) as error:
        raise PuddleError(f"{source}: {str(error).removeprefix('design 0: ')}") from None
    return design


def read_design(path: Path) -> Designs:
    """Read a design file."""
    return design_from(decode_json(path.read_bytes(), str(path)), str(path))


def write_design(design: Designs, path: Path) -> None:
    """Write a design file; raise PuddleError if there is not one design, or it is not valid."""
    if len(design) != 1:
        raise PuddleError(f"{path}: expected one design, got {len(design)}: choose one, such as designs[0]")
    try:
        check(design)
    except DesignError as error:
        raise PuddleError(f"{path}: {str(error).removeprefix('design 0: ')}") from None
    path.write_bytes(encode_json(design_document(design)))


def read_designs(path: Path) -> Designs:
    """Read the designs of a table.

    A Parquet file has a column for each gene, as ``study.table("histories")`` has, or the column ``design_json`` of the
    table of champions; further columns are ignored. A file that ends in .json is a design file.

    Raises:
        PuddleError: the file can't be read, holds no design, or a design is invalid; it names the row or column.
    """
    if path.suffix == ".json":
        return read_design(path)
    try:
        table = read_parquet(path.read_bytes())
    except pa.ArrowException as error:
        raise PuddleError(f"{path}: expected a Parquet file or a design file: {error}") from None
    if not len(table):
        raise PuddleError(f"{path}: expected at least one design, got none")
    if _DESIGN_JSON in table.column_names:
        named = [(f"{path}, row {row}", text) for row, text in enumerate(table[_DESIGN_JSON].to_pylist())]
        return concatenate([design_from(decode_json(text.encode(), name), name) for name, text in named])
    if missing := sorted(DTYPES.keys() - set(table.column_names)):
        raise PuddleError(f"{path}: expected a column for each gene, got none for {', '.join(missing)}")
    try:
        designs = Designs(**{name: _gene(name, table[name]) for name in DTYPES})
        check(designs)
    except ValueError as error:  # DesignError is one
        raise PuddleError(f"{path}: {error}") from None
    return designs


def _gene(name: str, column: pa.ChunkedArray) -> npt.NDArray[Any]:
    number = pa.from_numpy_dtype(DTYPES[name])
    kind = number if name in PER_DESIGN else pa.list_(number, N_LINKS)
    try:
        return np.array(column.cast(kind).to_pylist(), DTYPES[name])
    except (pa.ArrowException, TypeError):
        raise ValueError(f"column {name}: expected {kind} in every row, got {column.type}") from None


def read_parquet(content: bytes) -> pa.Table:
    """Read a table without threads of Arrow's, with which a process that ends at once may abort with exit code 134."""
    return pq.ParquetFile(pa.BufferReader(content)).read(use_threads=False)
