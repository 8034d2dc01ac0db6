"""Tracks files: tracked throws of bars as CSV or Parquet, and the bars, in the same file or one of their own.

CSV may be as spreadsheets write it. Nothing is guessed: docs/your-own-tank.md converts the files of other programs.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from pipeline.errors import PuddleError
from pipeline.store.design_file import read_parquet
from tasks.arrays import Labels
from tasks.bench.tracks import Bars, TrackTable

TRACK_COLUMNS = ("throw", "time", "x", "y", "angle")
DEVIATION_COLUMNS = ("x_sd", "y_sd", "angle_sd")
BAR_COLUMNS = ("length", "width", "mass")
_WHOLE = re.compile(r"([+-]?\d+)(\.0*)?")
_NO_LABEL = re.compile(r"(nan|[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?)?", re.IGNORECASE)  # digits are lost, or empty
_NUMBERS = (*TRACK_COLUMNS[1:], *DEVIATION_COLUMNS, *BAR_COLUMNS)


def read_track_table(content: bytes, name: str) -> tuple[TrackTable, Bars | None]:
    """Return the tracks in a file, and the bars if its rows state them.

    Args:
        content: CSV with a line of names, or Parquet.
        name: the file's name in messages.

    Raises:
        PuddleError: it is neither, or a column or a cell is missing or not what it should be; the message names it.
    """
    columns = _read_columns(content, name, TRACK_COLUMNS)
    if any(column in columns for column in DEVIATION_COLUMNS):
        _require(columns, DEVIATION_COLUMNS, name)
    table = TrackTable(
        _throws(columns, name),
        *(columns[column] for column in TRACK_COLUMNS[1:]),
        *(columns.get(column) for column in DEVIATION_COLUMNS),
    )
    return table, _bars(columns, name) if all(column in columns for column in BAR_COLUMNS) else None


def read_bars(content: bytes, name: str) -> Bars:
    """Return the bar of each throw in a file; raise PuddleError as above, or if a throw has several bars."""
    return _bars(_read_columns(content, name, ("throw", *BAR_COLUMNS)), name)


def _read_columns(content: bytes, name: str, needed: Sequence[str]) -> Mapping[str, Any]:
    """Return the known columns: numbers as arrays, throws as Arrow's column of text."""
    try:
        table = read_parquet(content) if content[:4] == b"PAR1" else _read_csv(_text_of(content, name))
        _require(table.column_names, needed, name)
        columns: dict[str, Any] = {
            column: table[column].cast(pa.float64()).to_numpy() for column in table.column_names if column in _NUMBERS
        }
        columns["throw"] = table["throw"].cast(pa.string())
    except (pa.ArrowException, KeyError, OSError) as error:  # KeyError: a column appears twice
        raise PuddleError(f"{name}: expected CSV or Parquet with a row for each frame: {error}") from None
    if not len(table):
        raise PuddleError(f"{name}: expected a row for each frame, got none")
    return columns


def _text_of(content: bytes, name: str) -> str:
    """Return the text of a file, compressed by gzip or not, in UTF-8, UTF-16 or Windows' encoding."""
    if content.startswith(b"\x1f\x8b"):
        content = pa.CompressedInputStream(pa.BufferReader(content), "gzip").read()
    if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return content.decode("utf-16", "replace")
    if b"\0" in content:
        raise PuddleError(
            f"{name}: expected CSV or Parquet, got a binary file: `puddle track` makes tracks of videos, and "
            f"docs/your-own-tank.md converts files of other programs"
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def _read_csv(text: str) -> pa.Table:
    """Read a table whose separator is the one that its first line names (`sep=;`), or that its heading has."""
    text = "\n".join(text.splitlines())
    text = re.sub(r'^[,;\t "]*(\n|$)', "", text, flags=re.MULTILINE)  # a spreadsheet's rows without a cell
    named = re.match(r'"?sep=(.).*\n', text)
    heading, _, rows = text[named.end() if named else 0 :].partition("\n")
    separator = named[1] if named else max(",;\t", key=heading.count)
    names = [column.strip() for column in heading.split(separator)]
    return pa.csv.read_csv(
        pa.BufferReader((separator.join(names) + "\n" + rows).encode()),
        pa.csv.ReadOptions(use_threads=False),  # a message then names the row
        pa.csv.ParseOptions(delimiter=separator),
        pa.csv.ConvertOptions(
            column_types={**dict.fromkeys(_NUMBERS, pa.float64()), "throw": pa.string()},
            decimal_point="," if separator != "," and re.search(r"\d,\d", rows) else ".",
        ),
    )


def _bars(columns: Mapping[str, Any], name: str) -> Bars:
    throw = _throws(columns, name)
    labels, first, throw_of_row = np.unique(throw, return_index=True, return_inverse=True)
    for column in BAR_COLUMNS:
        values, expected = columns[column], columns[column][first][throw_of_row]
        if (differs := np.isfinite(values) & (values != expected)).any():
            row = int(np.argmax(differs))
            raise PuddleError(
                f"{name}: throw {throw[row]}: {column} is {values[row]:g} and {expected[row]:g}: expected one bar for "
                f"each throw"
            )
    return Bars(labels, *(columns[column][first] for column in BAR_COLUMNS))


def _require(columns: Collection[str], names: Sequence[str], name: str) -> None:
    if missing := [column for column in names if column not in columns]:
        raise PuddleError(
            f"{name}: expected the columns {', '.join(names)}, got {', '.join(columns)[:80]}, without "
            f"{', '.join(missing)}. docs/your-own-tank.md converts files of other programs."
        )


def _throws(columns: Mapping[str, Any], name: str) -> Labels:
    """Return the labels of throws: whole numbers if all are, else text. No double rounds them."""
    texts = [(text or "").strip() for text in columns["throw"].to_pylist()]
    whole = {text: _WHOLE.fullmatch(text) for text in set(texts)}
    for row, text in enumerate(texts):
        if not whole[text] and _NO_LABEL.fullmatch(text):
            raise PuddleError(
                f"{name}: row {row + 1}: throw is {text or 'empty'}, expected a whole number with all its digits, "
                f"or text"
            )
    numbers = {text: int(match[1]) for text, match in whole.items() if match}
    if len(numbers) == len(whole) and all(abs(number) < 2**63 for number in numbers.values()):
        return np.array([numbers[text] for text in texts], dtype=np.int64)
    return np.array([str(numbers.get(text, text)) for text in texts])
