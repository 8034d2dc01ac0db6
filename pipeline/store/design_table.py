"""Tables of designs: Parquet with a column per gene, as histories have, or design files line by line."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import PuddleError
from pipeline.store.design_file import design_from, read_design
from pipeline.store.encoding import decode_json
from tasks.design import N_LINKS, DesignError, Designs, check
from tasks.design.genes import DTYPES, PER_DESIGN, concatenate

_DESIGN_JSON = "design_json"  # column of the table of champions


def read_designs(path: Path) -> Designs:
    """Read the designs of a table.

    A Parquet file has a column for each gene, as ``study.table("histories")`` has, or the column ``design_json`` of the
    table of champions; further columns are ignored. A file that ends in .json is a design file. Any other file has a
    design file in each line.

    Raises:
        PuddleError: the file can't be read, holds no design, or a design is invalid; it names the row or line.
    """
    try:
        if path.suffix == ".parquet":
            with path.open("rb") as file:
                table = read_parquet(file)
            if _DESIGN_JSON in table.column_names:
                return _of_documents(path, table[_DESIGN_JSON].to_pylist())
            return _of_columns(path, table)
        if path.suffix == ".json":
            return read_design(path)
        return _of_documents(path, path.read_text(encoding="utf-8").splitlines())
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        expected = "Expected a Parquet file, a design file, or a text file with a design in each line"
        raise PuddleError(f"{path}: cannot be read: {why}. {expected}.") from None


def read_parquet(file: Any) -> pa.Table:
    """Read a table without threads of Arrow's, with which a process that ends at once may abort with exit code 134."""
    return pq.ParquetFile(file).read(use_threads=False)


def _of_documents(path: Path, documents: list[Any]) -> Designs:
    lines = [(number, line) for number, line in enumerate(documents, 1) if line and line.strip()]
    if not lines:
        raise PuddleError(f"{path}: expected at least one design, got none")
    named = [(f"{path}, line {number}", line.encode()) for number, line in lines]
    return concatenate([design_from(decode_json(line, name), name) for name, line in named])


def _of_columns(path: Path, table: pa.Table) -> Designs:
    missing = sorted(DTYPES.keys() - set(table.column_names))
    if missing:
        raise PuddleError(f"{path}: expected a column for each gene, got none for {', '.join(missing)}")
    if not len(table):
        raise PuddleError(f"{path}: expected at least one design, got none")
    designs = Designs(**{name: _gene(path, name, table[name]) for name in DTYPES})
    try:
        check(designs)
    except DesignError as error:
        raise PuddleError(f"{path}: {error}") from None
    return designs


def _gene(path: Path, name: str, column: pa.ChunkedArray) -> npt.NDArray[Any]:
    shape = (len(column),) if name in PER_DESIGN else (len(column), N_LINKS)
    try:
        values = np.array(column.to_pylist())
        if values.dtype.kind not in "bif" or values.shape != shape:
            raise ValueError
        genes = values.astype(DTYPES[name])
        if not (genes == values).all():
            raise ValueError
    except ValueError:
        expected = "a number" if name in PER_DESIGN else f"{N_LINKS} numbers"
        raise PuddleError(f"{path}: column {name}: expected {expected} in every row, got {column.type}") from None
    return genes
