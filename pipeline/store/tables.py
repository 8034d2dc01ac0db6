"""Tables: rows of a frozen dataclass as columns, for Parquet and CSV, and columns as rows again.

The Parquet files of this project hold no nulls. A missing number is NaN, a missing text is empty, and a column beside
it gives the reason. A nested dataclass, such as an Estimate, is laid out flat: ``slope``, ``slope_low``, and so on.
"""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import Field, dataclass, fields, is_dataclass
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np
import numpy.typing as npt

from pipeline.store.encoding import decode_table, encode_table

Columns = dict[str, npt.NDArray[Any]]
Row = TypeVar("Row")


@dataclass(frozen=True)
class TableFile:
    """The Parquet file of a schema, which several items may have a part of."""

    schema: str
    version: int = 1

    @property
    def name(self) -> str:
        """Name of the file."""
        return f"{self.schema}.parquet"

    def encode(self, columns: Mapping[str, npt.NDArray[Any]], units: Mapping[str, str] | None = None) -> bytes:
        """Return the file's content; columns whose unit is not named are in SI."""
        return encode_table(columns, schema=self.schema, version=self.version, units=units)

    def read(self, parts: Sequence[Mapping[str, bytes]], source: str = "") -> Columns:
        """Decode the parts among the files of one or more items, and join them; messages call them ``source``."""
        tables = [
            decode_table(part[self.name], schema=self.schema, version=self.version, source=source or self.name)
            for part in parts
        ]
        return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def columns_of(kind: type[Row], rows: Sequence[Row]) -> Columns:
    """Lay out rows of numbers, flags, texts and dataclasses of these, with the right types even if there are none."""
    columns: Columns = {}
    for field, field_type in _typed_fields(kind):
        values = [getattr(row, field.name) for row in rows]
        if _is_nested(field_type):
            columns |= {_column_name(field, name): column for name, column in columns_of(field_type, values).items()}
        else:
            columns[field.name] = _column(field_type, values)
    return columns


def rows_of(kind: type[Row], columns: Mapping[str, npt.NDArray[Any]]) -> list[Row]:
    """Undo :func:`columns_of`; columns that are not of the dataclass are ignored.

    The inverse is exact, except where a field that may be None holds NaN or an empty text: both become None.
    """
    made: list[list[Any]] = []
    for field, field_type in _typed_fields(kind):
        if _is_nested(field_type):
            inner = {name: columns[_column_name(field, name)] for name in columns_of(field_type, ())}
            made.append(rows_of(field_type, inner))
        else:
            made.append([_value(field_type, value) for value in columns[field.name].tolist()])
    return [kind(*row) for row in zip(*made, strict=True)]


def described(kind: type) -> dict[str, Mapping[str, Any]]:
    """Return what a dataclass says of its fields, by the name of the column; parts of a nested one share it."""
    return {
        _column_name(field, inner) if _is_nested(field_type) else field.name: field.metadata
        for field, field_type in _typed_fields(kind)
        for inner in (columns_of(field_type, ()) if _is_nested(field_type) else ("",))
    }


def _typed_fields(kind: type) -> Iterator[tuple[Field[Any], Any]]:
    types = get_type_hints(kind)
    return ((field, types[field.name]) for field in fields(kind))


def _is_nested(field_type: Any) -> bool:  # not a TypeGuard, as is_dataclass is
    return is_dataclass(field_type)


def _column_name(field: Field[Any], name: str) -> str:
    return field.name if name == "value" else f"{field.name}_{name}"


def _column(field_type: Any, values: Sequence[Any]) -> npt.NDArray[Any]:
    choices = {field_type, *get_args(field_type)}
    if float in choices:
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    if bool in choices or int in choices:
        return np.array(values, dtype=bool if bool in choices else np.int64)
    return text(["" if value is None else value for value in values])


def _value(field_type: Any, value: Any) -> Any:
    missing = value == "" or value != value
    return None if missing and type(None) in get_args(field_type) else value


def text(values: Sequence[str]) -> npt.NDArray[np.str_]:
    """Make a column of text."""
    return np.array(values, dtype=np.str_)


def csv_of(columns: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """Write columns as CSV; a column of k numbers per row becomes k columns, and NaN an empty field."""
    flat: dict[str, list[Any]] = {}
    for name, column in columns.items():
        parts = {name: column} if column.ndim == 1 else {f"{name}_{i}": part for i, part in enumerate(column.T)}
        flat |= {
            part: [None if value != value else value for value in values.tolist()] for part, values in parts.items()
        }
    sheet = io.StringIO()
    writer = csv.writer(sheet, lineterminator="\n")
    writer.writerow(flat)
    writer.writerows(zip(*flat.values(), strict=True))
    return sheet.getvalue().encode()
