"""Tracks files: tracked throws of bars as CSV or Parquet, and the bars, in the same file or one of their own.

Nothing is guessed: a file of another program or in another notation is recognised by foreign_tracks.py and refused with
the lines that convert it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.csv

from pipeline.errors import PuddleError
from pipeline.store.design_table import read_parquet
from pipeline.store.foreign_tracks import conversion_of_parquet, conversion_of_text
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
    kind = "Parquet" if content[:4] == _PARQUET else "CSV"
    if kind == "CSV" and (conversion := conversion_of_text(content, name, _KNOWN)):
        raise PuddleError(conversion)
    try:
        table = read_parquet(pa.BufferReader(content)) if kind == "Parquet" else _read_csv(content, name)
        if conversion := conversion_of_parquet({field.name: str(field.type) for field in table.schema}, name):
            raise PuddleError(conversion)
        known = [column for column in table.column_names if column in _KNOWN]
        if repeated := sorted({column for column in known if known.count(column) > 1}):
            raise PuddleError(f"{name}: the column {repeated[0]} appears twice, expected each once")
        columns = {column: table[column].cast(pa.float64()).to_numpy() for column in known}
    except (pa.ArrowException, OSError) as error:
        raise PuddleError(f"{name}: cannot be read as {kind}: {error}. Expected CSV (UTF-8) or Parquet") from None
    if not len(table):
        raise PuddleError(f"{name}: expected a row for each frame, got none")
    if not columns:
        raise PuddleError(
            f"{name}: expected columns named {', '.join(TRACK_COLUMNS)}, got {', '.join(table.column_names)[:80]}"
        )
    return columns


_KNOWN = (*TRACK_COLUMNS, *DEVIATION_COLUMNS, *BAR_COLUMNS)


def _read_csv(content: bytes, name: str) -> pa.Table:
    """Read CSV; the columns that count are numbers, and a message names the cell that is none."""
    if not content.strip():
        raise PuddleError(f"{name}: expected a row for each frame, got none")
    heading = content.partition(b"\n")[0].removeprefix(b"\xef\xbb\xbf").decode(errors="replace").split(",")
    numbers = {column: pa.float64() for column in heading if column.strip() in _KNOWN}
    table = pa.csv.read_csv(
        pa.BufferReader(content),
        pa.csv.ReadOptions(use_threads=False),  # a message then names the row
        convert_options=pa.csv.ConvertOptions(column_types=numbers),
    )
    return table.rename_columns([column.strip() for column in table.column_names])


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
