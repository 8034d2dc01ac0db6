"""Tracks in the notation of spreadsheets or of other programs, and the two lines of pandas that convert them.

The recipes are those of docs/your-own-tank.md. Positions of two points of a bar, a lower and an upper one, give its
centre and the angle of its long axis from the vertical.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Mapping, Sequence

_HEAD = 100_000  # characters in which a notation is recognised
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?")


def conversion_of_parquet(types: Mapping[str, str], name: str) -> str | None:
    """Return a message if a Parquet file has times that are no numbers; ``types`` are Arrow's, by column."""
    for column, kind in types.items():
        if kind.startswith(("duration", "timestamp")):
            since = "" if kind.startswith("duration") else " - t[{0!r}].min()"
            change = f"t = pandas.read_parquet({name!r}); t[{column!r}] = (t[{column!r}]{since.format(column)})"
            return _message(f"{column} is a {kind}", name, f"{change}.dt.total_seconds()", "t")
    return None


def conversion_of_text(content: bytes, name: str, known: Collection[str]) -> str | None:
    """Return a message if a text file is not CSV with the ``known`` columns in UTF-8, but is recognised otherwise."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        read = f"t = pandas.read_csv({name!r}, encoding='utf-16', sep=None, engine='python')"
        return _message("text in UTF-16", name, read, "t")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        read = f"t = pandas.read_csv({name!r}, encoding='cp1252', sep=None, engine='python')"
        return _message("text that is not UTF-8, as Windows writes it (cp1252)", name, read, "t")
    lines = text[:_HEAD].splitlines()
    if not any(line.strip() for line in lines):
        return None
    return _of_program(lines, name) or _of_notation(lines, name, known)


def _message(what: str, name: str, read: str, write: str) -> str:
    return (
        f"{name}: recognised {what}; expected CSV in UTF-8 with the columns throw, time, x, y, angle, commas between "
        f"cells and points in numbers, or Parquet. These lines of Python (import numpy, pandas) convert it:\n  {read}\n"
        f"  {write}.to_csv('converted.csv', index=False)"
    )


def _two_points(time: str, x: Sequence[str], y: Sequence[str]) -> str:
    """Return a table of the pose of a bar from the coordinates of its lower and its upper point."""
    return (
        f"pandas.DataFrame({{'throw': 0, 'time': {time}, 'x': ({x[0]} + {x[1]}) / 2, 'y': ({y[0]} + {y[1]}) / 2, "
        f"'angle': numpy.arctan2({x[0]} - {x[1]}, {y[1]} - {y[0]})}})"
    )


def _of_program(lines: Sequence[str], name: str) -> str | None:
    """Recognise the exports of Motive, DeepLabCut, SLEAP and Tracker."""
    rows = [[cell.strip() for cell in re.split(r"[,;\t]", line)] for line in lines[:12]]
    heads = [cell.lower() for cell in rows[0]]
    if heads[0] == "format version":
        at = next((i for i, row in enumerate(rows) if row[0] == "Frame"), 6)
        # A rigid body's quaternion X, Y, Z, W comes first; a turn about z by θ has z = sin θ/2 and w = cos θ/2.
        values = "'x': t['X.1'], 'y': t['Y.1'], 'angle': 2 * numpy.arctan2(t['Z'], t['W'])"
        write = f"pandas.DataFrame({{'throw': 0, 'time': t['Time (Seconds)'], {values}}})"
        read = f"t = pandas.read_csv({name!r}, skiprows={at}, skip_blank_lines=False)"
        return _message("a file of Motive", name, read, write)
    if heads[0] == "scorer":
        low, high = [*dict.fromkeys(rows[1][1:]), "", ""][:2]
        x, y = ([f"t[{point!r}][{axis!r}]" for point in (low, high)] for axis in ("x", "y"))
        read = f"t = pandas.read_csv({name!r}, header=[1, 2], index_col=0)"
        return _message("a file of DeepLabCut", name, read, _two_points("t.index / 60", x, y))
    if "frame_idx" in heads:
        low, high = [*dict.fromkeys(cell[:-2] for cell in rows[0] if cell.lower().endswith(".x")), "", ""][:2]
        x, y = ([f"t[{f'{point}.{axis}'!r}]" for point in (low, high)] for axis in ("x", "y"))
        read = f"t = pandas.read_csv({name!r})"
        return _message("a file of SLEAP", name, read, _two_points("t['frame_idx'] / 60", x, y))
    for at in (i for i, row in enumerate(rows[:3]) if row[:3] == ["t", "x", "y"]):
        decimal = ", decimal=','" if "," in "".join(lines[at + 1 :][:1]) and "," not in lines[at] else ""
        read = f"t = pandas.read_csv({name!r}, skiprows={at}, sep={_separator(lines[at])!r}{decimal})"
        n = rows[at].count("x")
        x, y = ([f"t[{name_!r}]" for name_ in (axis, f"{axis}.1" if n > 1 else axis)] for axis in ("x", "y"))
        what = "a file of Tracker" + (" of one point, which has no angle" if n == 1 else "")
        return _message(what, name, read, _two_points("t['t']", x, y))
    return None


def _separator(line: str) -> str:
    return next((mark for mark in ("\t", ";") if mark in line), ",")


def _of_notation(lines: Sequence[str], name: str, known: Collection[str]) -> str | None:
    """Recognise comments, other separators, decimal commas, other spellings of the columns, and a row of units."""
    comments = [line for line in lines if line[:1] in ("#", "%")]
    table = [line for line in lines if line.strip() and line not in comments]
    if not table:
        return None
    separator = _separator(table[0])
    heading, *rows = list(csv.reader(table[:3], delimiter=separator))
    columns = [cell.strip() for cell in heading]
    names = [re.split(r"[\s\[(]", column.lower())[0] for column in columns]
    first = [cell.strip() for cell in rows[0]] if rows else []
    if not set(names) & set(known):
        return None
    found, options, write = [], [], "t"
    if comments:
        found.append("lines of comments")
        options.append(f"comment={comments[0][:1]!r}")
    if separator != ",":
        found.append({";": "semicolons", "\t": "tabs"}[separator] + " between cells")
        options.append(f"sep={separator!r}")
    if any("," in cell and _NUMBER.fullmatch(cell) for cell in first):
        found.append("decimal commas")
        options.append("decimal=','")
    if names != columns and not set(columns) >= set(names) & set(known):
        found.append(f"columns named {', '.join(columns)[:60]}")
        write = f"t.set_axis({names}, axis=1)"
    numbers = [cell for column, cell in zip(names, first, strict=False) if column in known]
    if len(table) > 2 and numbers and not any(_NUMBER.fullmatch(cell) or cell.lower() == "nan" for cell in numbers):
        found.append("a row of units")
        at = next(i for i, line in enumerate(lines) if line == table[1])
        options.append(f"skiprows=[{at}]")
    if not found:
        return None
    return _message(", ".join(found), name, f"t = pandas.read_csv({', '.join([repr(name), *options])})", write)
