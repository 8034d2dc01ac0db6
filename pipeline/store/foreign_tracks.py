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


def _poses(time: str, pose: str) -> str:
    """Return a table of poses, without the frames in which the bar or a point of it was lost."""
    return f"pandas.DataFrame({{'throw': 0, 'time': {time}, {pose}}}).dropna()"


def _of_points(what: str, name: str, read: str, time: str, points: Sequence[tuple[object, object]]) -> str | None:
    """Return a message whose lines give the pose of a bar from the columns x and y of a lower and an upper point."""
    if not points:
        return None
    if len(points) == 1:
        return (
            f"{name}: recognised {what} with one point, which has no angle: track a lower and an upper point of a bar"
        )
    (x_low, y_low), (x_up, y_up) = [(f"t[{x!r}]", f"t[{y!r}]") for x, y in points[:2]]
    centre = f"'x': ({x_low} + {x_up}) / 2, 'y': ({y_low} + {y_up}) / 2"
    write = _poses(time, f"{centre}, 'angle': numpy.arctan2({x_low} - {x_up}, {y_up} - {y_low})")
    return _message(what, name, read, write)


def _of_program(lines: Sequence[str], name: str) -> str | None:
    """Recognise the exports of Motive, DeepLabCut, SLEAP and Tracker."""
    rows = [[cell.strip() for cell in re.split(r"[,;\t]", line)] for line in lines[:12]]
    heads = [cell.lower() for cell in rows[0]]
    if heads[0] == "format version":
        return _of_motive(rows, name)
    if heads[0] == "scorer":
        n = next((i for i, row in enumerate(rows) if row[0] == "coords"), 2)  # after individuals, if there are several
        points = dict.fromkeys(zip(*(row[1:] for row in rows[1:n]), strict=False))
        columns = [((*point, "x"), (*point, "y")) for point in points]
        read = f"t = pandas.read_csv({name!r}, header={[*range(1, n + 1)]}, index_col=0)"
        return _of_points("a file of DeepLabCut", name, read, "t.index / 60", columns)
    if "frame_idx" in heads:
        nodes = [cell[:-2] for cell in rows[0] if cell.endswith(".x")]
        read = f"t = pandas.read_csv({name!r})"
        columns = [(f"{node}.x", f"{node}.y") for node in nodes]
        return _of_points("a file of SLEAP", name, read, "t['frame_idx'] / 60", columns)
    for at in (i for i, row in enumerate(rows[:3]) if row[0] == "t" and {"x", "y"} <= {*row}):
        decimal = ", decimal=','" if "," in "".join(lines[at + 1 :][:1]) and "," not in lines[at] else ""
        options = f"skiprows={at}, sep={_separator(lines[at])!r}, index_col=False{decimal}"
        read = f"t = pandas.read_csv({name!r}, {options})"
        return _of_points("a file of Tracker", name, read, "t['t']", _repeated("x", "y", rows[at]))
    return None


def _of_motive(rows: Sequence[Sequence[str]], name: str) -> str | None:
    """Recognise a rigid body, whose rotation comes first, or markers."""
    at = next((i for i, row in enumerate(rows) if row[0] == "Frame"), 6)
    heading = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    read = f"t = pandas.read_csv({name!r}, skiprows={at}, skip_blank_lines=False)"
    what = f"a file of Motive in {heading.get('Length Units', 'Meters').lower()}"
    if "Rotation" not in rows[at - 1]:
        return _of_points(what, name, read, "t.iloc[:, 1]", _repeated("X", "Y", rows[at]))
    # A turn about z by θ is the quaternion z = sin θ/2, w = cos θ/2, or an angle of Euler's in degrees.
    angle = "2 * numpy.arctan2(t['Z'], t['W'])" if "W" in rows[at] else "numpy.radians(t['Z'])"
    return _message(what, name, read, _poses("t.iloc[:, 1]", f"'x': t['X.1'], 'y': t['Y.1'], 'angle': {angle}"))


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
    return _message(", ".join(found), name, f"t = pandas.read_csv({', '.join([repr(name), *options])})", write)
