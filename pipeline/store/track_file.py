"""Tracks files: tracked throws of bars as CSV or Parquet, and the bars, in the same file or one of their own.

Nothing is guessed: docs/your-own-tank.md converts the files of other programs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.csv

from pipeline.errors import PuddleError
from pipeline.store.design_file import read_parquet
from tasks.arrays import Float64, Int64
from tasks.tracks import Bars, TrackTable

TRACK_COLUMNS = ("throw", "time", "x", "y", "angle")
DEVIATION_COLUMNS = ("x_sd", "y_sd", "angle_sd")
BAR_COLUMNS = ("length", "width", "mass")
_KNOWN = (*TRACK_COLUMNS, *DEVIATION_COLUMNS, *BAR_COLUMNS)


def read_track_table(content: bytes, name: str) -> tuple[TrackTable, Bars | None]:
    """Return the tracks in a file, and the bars if its rows state them.

    Args:
        content: CSV with a line of names, or Parquet.
        name: the file's name in messages.

    Raises:
        PuddleError: it is neither, a column is missing, or a cell is not a number; the message names line or column.
    """
    columns = _read_columns(content, name)
    has_deviations = any(column in columns for column in DEVIATION_COLUMNS)
    _require(columns, (*TRACK_COLUMNS, *(DEVIATION_COLUMNS if has_deviations else ())), name)
    table = TrackTable(
        _throws(columns["throw"], name),
        *(columns[column] for column in TRACK_COLUMNS[1:]),
        *(columns.get(column) for column in DEVIATION_COLUMNS),
    )
    return table, _bars(columns, name) if all(column in columns for column in BAR_COLUMNS) else None


def read_bars(content: bytes, name: str) -> Bars:
    """Return the bar of each throw in a file; raise PuddleError as above, or if a throw has several bars."""
    return _bars(_read_columns(content, name), name)


def _read_columns(content: bytes, name: str) -> Mapping[str, Float64]:
    try:
        table = read_parquet(content) if content[:4] == b"PAR1" else _read_csv(content)
        columns = {
            column: table[column].cast(pa.float64()).to_numpy() for column in table.column_names if column in _KNOWN
        }
    except (pa.ArrowException, KeyError, OSError) as error:  # KeyError: a column appears twice
        raise PuddleError(f"{name}: expected CSV (UTF-8) or Parquet with a row for each frame: {error}") from None
    if not len(table):
        raise PuddleError(f"{name}: expected a row for each frame, got none")
    if not columns:
        _require(dict.fromkeys(table.column_names), TRACK_COLUMNS, name)
    return columns


def _read_csv(content: bytes) -> pa.Table:
    heading, _, rows = content.partition(b"\n")
    heading = b",".join(column.strip() for column in heading.split(b","))
    return pa.csv.read_csv(
        pa.BufferReader(heading + b"\n" + rows),
        pa.csv.ReadOptions(use_threads=False),  # a message then names the row
        convert_options=pa.csv.ConvertOptions(column_types=dict.fromkeys(_KNOWN, pa.float64())),
    )


def _bars(columns: Mapping[str, Float64], name: str) -> Bars:
    _require(columns, ("throw", *BAR_COLUMNS), name)
    throw = _throws(columns["throw"], name)
    numbers, first, throw_of_row = np.unique(throw, return_index=True, return_inverse=True)
    for column in BAR_COLUMNS:
        values, expected = columns[column], columns[column][first][throw_of_row]
        if (differs := np.isfinite(values) & (values != expected)).any():
            row = int(np.argmax(differs))
            raise PuddleError(
                f"{name}: throw {throw[row]}: {column} is {values[row]:g} and {expected[row]:g}: expected one bar for "
                f"each throw"
            )
    return Bars(numbers, *(columns[column][first] for column in BAR_COLUMNS))


def _require(columns: Mapping[str, object], names: Sequence[str], name: str) -> None:
    if missing := [column for column in names if column not in columns]:
        raise PuddleError(
            f"{name}: expected the columns {', '.join(names)}, got {', '.join(columns)[:80]}, without "
            f"{', '.join(missing)}. docs/your-own-tank.md converts files of other programs."
        )


def _throws(column: Float64, name: str) -> Int64:
    wrong = ~np.isfinite(column) | (column != np.round(column))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise PuddleError(f"{name}: row {row + 1}: throw is {column[row]:g}, expected a whole number")
    return column.astype(np.int64)
