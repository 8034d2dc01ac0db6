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
            since = "" if kind.startswith("duration") else f" - t[{column!r}].min()"
            seconds = f"; t[{column!r}] = (t[{column!r}]{since}).dt.total_seconds()"
            return _message(f"{column} is a {kind}", name, "", "t", "parquet", seconds)
    return None


def conversion_of_text(content: bytes, name: str, known: Collection[str]) -> str | None:
    """Return a message if a text file is not CSV with the ``known`` columns in UTF-8, but is recognised otherwise."""
    encoding = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        encoding = "cp1252"  # as Windows writes it
    if encoding != "utf-8-sig":
        return _message(f"text in {encoding}", name, f"encoding={encoding!r}, sep=None, engine='python'", "t")
    lines = text[:_HEAD].splitlines() or [""]
    return _of_program(lines, name) or _of_notation(lines, name, known)


def _message(what: str, name: str, options: str, write: str, kind: str = "csv", then: str = "") -> str:
    """Return a message with two lines of Python: one that reads a file with ``options``, and one that writes CSV."""
    return (
        f"{name}: recognised {what}; expected CSV in UTF-8 with the columns throw, time, x, y, angle, commas between "
        f"cells and points in numbers, or Parquet. These lines of Python (import numpy, pandas) convert it:\n"
        f"  t = pandas.read_{kind}({', '.join(word for word in (repr(name), options) if word)}){then}\n"
        f"  {write}.to_csv('converted.csv', index=False)"
    )


def _of_program(lines: Sequence[str], name: str) -> str | None:
    """Recognise the exports of Motive, DeepLabCut, SLEAP and Tracker: a rigid body, or two points of a bar."""
    rows = [[cell.strip() for cell in re.split(r"[,;\t]", line)] for line in lines[:12]]
    angle, points = "", list[tuple[object, object]]()
    if rows[0][0] == "Format Version":
        at = next((i for i, row in enumerate(rows) if row[0] == "Frame"), 6)
        units = dict(zip(rows[0][::2], rows[0][1::2], strict=False)).get("Length Units", "Meters").lower()
        what, options, time = f"Motive in {units}", f"skiprows={at}, skip_blank_lines=False", "t.iloc[:, 1]"
        points += _repeated("X", "Y", rows[at])
        if "Rotation" in rows[at - 1]:  # of a rigid body comes first: a quaternion, or Euler's angles in degrees
            angle = "2 * numpy.arctan2(t['Z'], t['W'])" if "W" in rows[at] else "numpy.radians(t['Z'])"
            points = points[1:2]
    elif rows[0][0] == "scorer":
        n = next((i for i, row in enumerate(rows) if row[0] == "coords"), 2)  # after individuals, if there are several
        what, options, time = "DeepLabCut", f"header={[*range(1, n + 1)]}, index_col=0", "t.index / 60"
        names = dict.fromkeys(zip(*(row[1:] for row in rows[1:n]), strict=False))
        points += [((*point, "x"), (*point, "y")) for point in names]
    elif "frame_idx" in rows[0]:
        what, options, time = "SLEAP", "", "t['frame_idx'] / 60"
        points += [(cell, f"{cell[:-2]}.y") for cell in rows[0] if cell.endswith(".x")]
    elif tables := [i for i, row in enumerate(rows[:3]) if row[0] == "t" and {"x", "y"} <= {*row}]:
        at = tables[0]
        decimal = ", decimal=','" if "," in "".join(lines[at + 1 :][:1]) and "," not in lines[at] else ""
        options = f"skiprows={at}, sep={_separator(lines[at])!r}, index_col=False{decimal}"
        what, time = "Tracker", "t['t']"
        points += _repeated("x", "y", rows[at])
    else:
        return None
    if len(points) < 2 and not angle:
        return f"{name}: recognised a file of {what} with one point, which has no angle: track two points of each bar"
    x, y = ([f"t[{point[axis]!r}]" for point in points[:2]] for axis in (0, 1))
    angle = angle or f"numpy.arctan2({x[0]} - {x[1]}, {y[1]} - {y[0]})"  # the lower point first
    centre = f"'x': numpy.mean([{', '.join(x)}], axis=0), 'y': numpy.mean([{', '.join(y)}], axis=0)"
    # Without the frames in which a bar, or a point of it, was lost.
    write = f"pandas.DataFrame({{'throw': 0, 'time': {time}, {centre}, 'angle': {angle}}}).dropna()"
    return _message(f"a file of {what}", name, options, write)


def _repeated(x: str, y: str, heading: Sequence[str]) -> list[tuple[str, str]]:
    """Return the names that pandas gives to columns of the same name."""
    return [(x + mark, y + mark) for mark in ("", *(f".{i}" for i in range(1, heading.count(x))))]


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
    return _message(", ".join(found), name, ", ".join(options), write)
