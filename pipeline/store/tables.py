"""Tables: rows of frozen data as columns, for Parquet and for CSV.

Parquet here knows no null: a number that is not there is NaN, a text is empty, and a column beside it says why. A row
that holds another, such as an Estimate, is laid out flat: ``slope``, ``slope_low``, ``slope_high``, ``slope_reason``.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

Columns = dict[str, npt.NDArray[Any]]


def columns_of(kind: type, rows: Sequence[Any]) -> Columns:
    """Lay out rows of a dataclass as columns, of the right types even if there are no rows.

    Args:
        kind: the dataclass; its fields are numbers, flags, texts, tuples of texts and such dataclasses in turn.
        rows: instances of it.
    """
    types = get_type_hints(kind)
    columns: Columns = {}
    for field in fields(kind):
        values, of = [getattr(row, field.name) for row in rows], types[field.name]
        if isinstance(of, type) and is_dataclass(of):
            for name, column in columns_of(of, values).items():
                columns[field.name if name == "value" else f"{field.name}_{name}"] = column
        else:
            columns[field.name] = _column(of, values)
    return columns


def _column(of: Any, values: Sequence[Any]) -> npt.NDArray[Any]:
    choices = {of, *get_args(of)}
    if get_origin(of) is tuple:
        return text(["/".join(value) for value in values])
    if float in choices:
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    if bool in choices or int in choices:
        return np.array(values, dtype=bool if bool in choices else np.int64)
    return text(["" if value is None else value for value in values])


def text(values: Sequence[str]) -> npt.NDArray[np.str_]:
    """Make a column of text."""
    return np.array(values, dtype=np.str_)


def csv_of(columns: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """Write columns as CSV; those of several numbers a row become as many columns, and NaN becomes nothing."""
    flat: dict[str, list[Any]] = {}
    for name, column in columns.items():
        parts = {name: column} if column.ndim == 1 else {f"{name}_{i}": part for i, part in enumerate(column.T)}
        flat |= {part: [None if value != value else value for value in of.tolist()] for part, of in parts.items()}
    sheet = io.StringIO()
    writer = csv.writer(sheet, lineterminator="\n")
    writer.writerow(flat)
    writer.writerows(zip(*flat.values(), strict=True))
    return sheet.getvalue().encode()
