"""Tracks files: tracked throws of bars as CSV or Parquet, and the bars, in the same file or one of their own."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.errors import PuddleError
from tasks.arrays import Float64
from tasks.tracks import Bars, TrackTable

TRACK_COLUMNS = ("throw", "time", "x", "y", "angle")
DEVIATION_COLUMNS = ("x_sd", "y_sd", "angle_sd")
BAR_COLUMNS = ("length", "width", "mass")
_MOST_BYTES = 2**30
_PARQUET = b"PAR1"

TrackColumns = Mapping[str, Float64]


def read_track_columns(content: bytes, name: str) -> TrackColumns:
    """Return the columns of a tracks file or a file of bars, as numbers.

    Args:
        content: CSV with a line of names, or Parquet.
        name: the file's name in messages.

    Raises:
        PuddleError: it is neither, or a cell is not a number; the message names the line or the column.
    """
    if len(content) > _MOST_BYTES:
        raise PuddleError(f"{name}: expected at most {_MOST_BYTES:,} bytes, got {len(content):,}. Split the throws")
    columns = _of_parquet(content, name) if content[:4] == _PARQUET else _of_csv(content, name)
    if not columns or not len(next(iter(columns.values()))):
        raise PuddleError(f"{name}: expected a row for each frame, got none")
    return columns


def _of_parquet(content: bytes, name: str) -> dict[str, Float64]:
    try:
        table = pq.read_table(pa.BufferReader(content))
    except (pa.ArrowException, OSError) as error:
        raise PuddleError(f"{name}: cannot be read as Parquet: {error}. Expected CSV or Parquet") from None
    known = [column for column in table.column_names if column in _KNOWN]
    if len(set(known)) < len(known):
        raise PuddleError(f"{name}: a column appears twice in {', '.join(known)}, expected each once")
    try:
        return {column: table[column].cast(pa.float64()).to_numpy() for column in known}
    except pa.ArrowException as error:
        raise PuddleError(f"{name}: expected numbers in {', '.join(known)}: {error}") from None


_KNOWN = (*TRACK_COLUMNS, *DEVIATION_COLUMNS, *BAR_COLUMNS)


def _of_csv(content: bytes, name: str) -> dict[str, Float64]:
    try:
        lines = list(csv.reader(io.StringIO(content.decode("utf-8-sig"))))
    except (UnicodeDecodeError, csv.Error) as error:
        raise PuddleError(f"{name}: cannot be read: {error}. Expected CSV (UTF-8) or Parquet") from None
    heading = [cell.strip() for cell in lines[0]] if lines else []
    if repeated := sorted({column for column in heading if column in _KNOWN and heading.count(column) > 1}):
        raise PuddleError(f"{name}, line 1: the column {repeated[0]} appears twice, expected each once")
    at = {column: heading.index(column) for column in _KNOWN if column in heading}
    if heading and not at:
        raise PuddleError(
            f"{name}, line 1: expected names of columns, {', '.join(TRACK_COLUMNS)}, separated by commas, got "
            f"{','.join(heading)[:80]}"
        )
    rows = [(number, line) for number, line in enumerate(lines[1:], 2) if any(cell.strip() for cell in line)]
    columns = {column: np.empty(len(rows)) for column in at}
    for row, (number, line) in enumerate(rows):
        if len(line) != len(heading):
            raise PuddleError(
                f"{name}, line {number}: expected {len(heading)} cells as in the first line, got {len(line)}"
            )
        for column, index in at.items():
            columns[column][row] = _number(line[index], f"{name}, line {number}: {column}")
    return columns


def _number(cell: str, where: str) -> float:
    try:
        return float(cell) if cell.strip() else float("nan")  # the check of the tracks names throw and frame
    except ValueError:
        raise PuddleError(f"{where}: expected a number, got {cell.strip()!r}") from None


def track_table(columns: TrackColumns, name: str) -> TrackTable:
    """Return the tracks among columns.

    Raises:
        PuddleError: a column is missing.
    """
    _require(columns, TRACK_COLUMNS, name)
    stated = [column for column in DEVIATION_COLUMNS if column in columns]
    if stated and len(stated) < len(DEVIATION_COLUMNS):
        missing = [column for column in DEVIATION_COLUMNS if column not in columns]
        raise PuddleError(f"{name}: has {', '.join(stated)} but no {', '.join(missing)}: expected all three or none")
    return TrackTable(
        _throws(columns["throw"], name),
        *(columns[column] for column in TRACK_COLUMNS[1:]),
        *(columns.get(column) for column in DEVIATION_COLUMNS),
    )


def has_bars(columns: TrackColumns) -> bool:
    """Return whether a tracks file states the bars in its rows."""
    return all(column in columns for column in BAR_COLUMNS)


def bars_of(columns: TrackColumns, name: str) -> Bars:
    """Return the bar of each throw; rows of one throw must agree.

    Raises:
        PuddleError: a column is missing, or a throw has several bars.
    """
    _require(columns, ("throw", *BAR_COLUMNS), name)
    throw = _throws(columns["throw"], name)
    numbers, first = np.unique(throw, return_index=True)
    bar_of_row = first[np.searchsorted(numbers, throw)]
    for column in BAR_COLUMNS:
        differs = np.flatnonzero(columns[column] != columns[column][bar_of_row])
        differs = differs[np.isfinite(columns[column][differs])]
        if len(differs):
            row = differs[0]
            raise PuddleError(
                f"{name}: throw {throw[row]}: {column} is {columns[column][row]:g} and "
                f"{columns[column][bar_of_row[row]]:g}: expected one bar for each throw"
            )
    return Bars(numbers, *(columns[column][first] for column in BAR_COLUMNS))


def _require(columns: TrackColumns, names: Sequence[str], name: str) -> None:
    if missing := [column for column in names if column not in columns]:
        raise PuddleError(
            f"{name}: expected the columns {', '.join(names)}, got none named {', '.join(missing)}: name the columns so"
        )


def _throws(column: Float64, name: str) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    wrong = ~np.isfinite(column) | (column != np.round(column)) | (np.abs(column) > 2**53)
    if wrong.any():
        raise PuddleError(
            f"{name}: row {int(np.argmax(wrong)) + 1}: throw is {column[wrong][0]:g}, expected a whole number"
        )
    return column.astype(np.int64)
