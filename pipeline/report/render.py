"""Tables for a reader: rows of a registered dataclass as HTML, terminal text, Markdown, LaTeX, CSV or JSON.

The fields of the dataclass say how each value is written (tasks/analysis/registry.py). Estimates are written with their
interval, means with their deviation. Columns without any value are left out.
"""

import json
import re
import textwrap
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from html import escape
from itertools import zip_longest
from typing import Any

from markupsafe import Markup

from pipeline.store.tables import columns_of, csv_of, described, text
from tasks.analysis.columns import environment_name, scored_by
from tasks.analysis.comparison import VERDICTS
from tasks.analysis.estimates import Estimate, Mean
from tasks.analysis.tables import ANALYSES
from tasks.analysis.tables.regressions import ensemble_name
from tasks.evolution import OBJECTIVES, PAPERS_OBJECTIVE, Objective
from tasks.residual import NO_LEARNERS, Learner

_MOST_ROWS_OF_CSV = 20_000  # that a spreadsheet opens at once

_WIDTH = 78  # usual width of a terminal, which a table exceeds where its words can't be broken so far
_MOST_CHARACTERS = (34, 28, 22, 16, 12)  # of a line of words there; the first that fits
NONE = "–"  # stands where there is no value
MARKS = dict(zip((*VERDICTS, "identical"), "✓≠?=", strict=True))  # so that colour is not the only difference


@dataclass(frozen=True)
class Cell:
    """A written value: what is read first, and its interval."""

    main: str = NONE
    below: str = ""

    @property
    def text(self) -> str:
        """All of it in a line."""
        return f"{self.main} ({self.below})" if self.below else self.main


@dataclass(frozen=True)
class Written:
    """A table of text: headings, cells by row, and which columns hold numbers."""

    names: list[str]
    headings: list[str]
    meanings: list[str]
    rows: list[list[Cell]]

    def is_number(self, column: int) -> bool:
        """Return whether a column holds numbers, which are aligned to the right."""
        return all(re.match(r"[−+<±\d–]", row[column].main) for row in self.rows)


def written(
    kind: type, rows: Sequence[Any], without: Sequence[str] = (), learners: Mapping[str, Learner] = NO_LEARNERS
) -> Written:
    """Write the columns that readers of a study with these learners see, without some that are said elsewhere."""
    shown = [one for one in fields(kind) if one.metadata["shown"] and one.name not in without]
    shown = [one for one in shown if not all(_is_absent(getattr(row, one.name)) for row in rows)]
    units = [one.metadata["unit"] for one in shown]
    forms = [one.metadata["form"] for one in shown]
    forms = [partial(form, learners=learners) if form in (environment_name, ensemble_name) else form for form in forms]
    labels = [one.metadata["label"] for one in shown]
    return Written(
        [one.name for one in shown],
        [f"{label} [{unit}]" if unit else label for label, unit in zip(labels, units, strict=True)],
        [one.metadata["meaning"] for one in shown],
        [[_cell(getattr(row, one.name), form) for one, form in zip(shown, forms, strict=True)] for row in rows],
    )


def _is_absent(value: Any) -> bool:
    return value in (None, "", Estimate(None), Mean(None)) or value != value  # NaN


def _cell(value: Any, form: str | Callable[[Any], str]) -> Cell:
    if _is_absent(value):
        return Cell()
    if isinstance(value, Estimate):
        ends = [_write(end, form) for end in value.interval or ()]
        return Cell(_write(value.value, form), " to ".join(ends))
    if isinstance(value, Mean):
        main = _write(value.value, form)
        return Cell(main if value.sd is None else f"{main} ± {_write(value.sd, form)}")
    if value in MARKS:
        return Cell(f"{MARKS[value]} {value}")
    return Cell(_write(value, form))


def _write(value: Any, form: str | Callable[[Any], str]) -> str:
    return typeset(form.format(value) if isinstance(form, str) else form(value))


def typeset(text: str) -> str:
    """Set minus signs, and a number with its sign and its unit on one line."""
    text = re.sub(r"(?<=\d)%", " %", re.sub(r"(?<![\w.])-(?= ?\d)", "−", text))
    return re.sub(r"(?<=\d) (?=(m|%|cm|mm/s)\b|%)|(?<=within ±) ", "\u00a0", text)


def as_html(
    kind: type,
    rows: Sequence[Any],
    label: str,
    *,
    address: Callable[[Any], str] = lambda row: "",
    without: Sequence[str] = (),
    learners: Mapping[str, Learner] = NO_LEARNERS,
) -> Markup:
    """Return a table that scrolls sideways on a narrow page, or one of verdicts, whose rows become cards there.

    Args:
        kind: dataclass of the rows.
        rows: the rows.
        label: name of the table for screen readers.
        address: returns where on the page a row's robot is; "" if nowhere.
        without: fields that are said elsewhere.
        learners: those of the study, by which arms are called.
    """
    table = written(kind, rows, without, learners)
    numbers = [table.is_number(column) for column in range(len(table.names))]
    head = "".join(
        f'<th{"" if number else " class=words"} title="{escape(meaning)}">{escape(heading)}</th>'
        for heading, meaning, number in zip(table.headings, table.meanings, numbers, strict=True)
    )
    body = ""
    for row, cells in zip(rows, table.rows, strict=True):
        body += "<tr>"
        for name, heading, cell, number in zip(table.names, table.headings, cells, numbers, strict=True):
            main = escape(cell.main)
            if name == "environment":
                color = f"var(--arm-{escape(row.environment)}, var(--unknown))"
                main = f'<span class="swatch" style="background: {color}"></span>{main}'
                main = f'<a href="#{escape(to)}">{main}</a>' if (to := address(row)) else main
            kinds = "number" if number else "words"
            kinds += f" verdict {getattr(row, name).replace(' ', '-')}" if name == "verdict" else ""
            below = f"<small>{escape(cell.below)}</small>" if cell.below else ""
            body += f'<td class="{kinds}" data-column="{escape(heading)}">{main}{below}</td>'
        body += "</tr>"
    cards = ' class="cards"' if "verdict" in table.names else ""
    content = f"<table{cards}><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return Markup(f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(label)}">{content}</div>')


def as_text(
    kind: type,
    rows: Sequence[Any],
    without: Sequence[str] = (),
    *,
    width: int = _WIDTH,
    learners: Mapping[str, Learner] = NO_LEARNERS,
) -> list[str]:
    """Return lines for a terminal of a width [characters], with words wrapped and numbers aligned to the right."""
    table = written(kind, rows, without, learners)
    for most in _MOST_CHARACTERS:
        columns = [_laid_out(table, column, most) for column in range(len(table.names))]
        if sum(len(column[0][0]) + 2 for column in columns) <= width + 2:
            break
    lines = []
    for cells in zip(*columns, strict=True):
        for parts in zip_longest(*cells):
            blank = (" " * len(column[0][0]) for column in columns)
            lines.append("  ".join(part or space for part, space in zip(parts, blank, strict=True)).rstrip())
    return lines


def _laid_out(table: Written, column: int, most: int) -> list[list[str]]:
    """Return the lines of each cell of a column."""
    heading, texts = table.headings[column], [row[column].text.replace("\u00a0", " ") for row in table.rows]
    number, longest = table.is_number(column), max(map(len, texts), default=0)
    width = max(longest if number else min(longest, most), *map(len, heading.split()))
    laid = [textwrap.wrap(text, width, break_on_hyphens=False) for text in (heading, *texts)]
    return [[f"{line:>{width}}" if number else f"{line:<{width}}" for line in cell] for cell in laid]


def as_markdown(kind: type, rows: Sequence[Any]) -> str:
    """Return a table in Markdown."""
    table = written(kind, rows)
    rules = ["--:" if table.is_number(column) else "---" for column in range(len(table.names))]
    lines = [table.headings, rules, *([cell.text for cell in row] for row in table.rows)]
    return "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)


def as_latex(kind: type, rows: Sequence[Any], caption: str, learners: Mapping[str, Learner] = NO_LEARNERS) -> str:
    """Return a ``tabular``, which a paper reads with the command input; it needs the package booktabs."""
    table = written(kind, rows, learners=learners)
    aligned = "".join("r" if table.is_number(column) else "l" for column in range(len(table.names)))
    lines = [_latex_row(table.headings), "\\midrule", *(_latex_row([cell.text for cell in row]) for row in table.rows)]
    meanings = [f"% {name}: {meaning}" for name, meaning in zip(table.headings, table.meanings, strict=True) if meaning]
    head, foot = f"\\begin{{tabular}}{{{aligned}}}\n\\toprule", "\\bottomrule\n\\end{tabular}\n"
    return "\n".join([f"% {caption}", *meanings, head, *lines, foot])


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(map(_latex, cells)) + r" \\"


_LATEX = {character: f"\\{character}" for character in "&%$#_{}"}
_LATEX |= {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\u00a0": "~", "−": "$-$"}
_LATEX |= {"±": r"$\pm$", "μ": r"$\mu$", "σ": r"$\sigma$", "′": "$'$", "–": "--", "≠": r"$\neq$", "✓": r"\checkmark{}"}
_LATEX |= {"²": "$^2$", "·": r"$\cdot$"}
_ACCENTS = {"\u0302": r"\^{%s}", "\u0303": r"\~{%s}", "\u0304": r"\={%s}", "\u20d7": r"$\vec{%s}$"}  # combining


def _latex(text: str) -> str:
    out: list[str] = []
    for character in "".join(c if c in _LATEX else unicodedata.normalize("NFD", c) for c in text):
        if character in _ACCENTS and out:
            out.append(_ACCENTS[character] % out.pop())
        elif (parts := unicodedata.decomposition(character)).startswith("<sub> "):
            out.append(f"$_{chr(int(parts.split()[1], 16))}$")
        else:
            out.append(_LATEX.get(character, character))
    return "".join(out)


def as_csv(kind: type, rows: Sequence[Any]) -> bytes:
    """Return every column as comma-separated values."""
    return csv_of(columns_of(kind, rows))


def as_json(kind: type, rows: Sequence[Any]) -> list[dict[str, Any]]:
    """Return rows as JSON values, with every column; what is missing is null."""
    columns = columns_of(kind, rows)
    values = zip(*(column.tolist() for column in columns.values()), strict=True)
    known = ([None if value != value else value for value in row] for row in values)
    return [dict(zip(columns, row, strict=True)) for row in known]


WRITERS: dict[str, Callable[[type, Sequence[Any], str], str]] = {
    ".md": lambda kind, rows, caption: as_markdown(kind, rows),
    ".tex": as_latex,
    ".csv": lambda kind, rows, caption: as_csv(kind, rows).decode(),
    ".json": lambda kind, rows, caption: json.dumps(as_json(kind, rows), indent=1, ensure_ascii=False) + "\n",
}
"""Writers of a table, by the suffix of the file."""


def tables_of(
    tables: Mapping[str, Sequence[Any]], objective: Objective = OBJECTIVES[PAPERS_OBJECTIVE]
) -> dict[str, bytes]:
    """Return a study's tables of readable size as CSV, by file name, and the unit and meaning of every column."""
    readable = {name: rows for name, rows in tables.items() if 0 < len(rows) <= _MOST_ROWS_OF_CSV}
    if not readable:
        return {}
    columns = [
        (name, column, about.get("unit", ""), about.get("meaning", "") or about.get("label", ""))
        for name in readable
        for column, about in described(scored_by(objective, ANALYSES[name].row)).items()
    ]
    sheet = dict(zip(("table", "column", "unit", "meaning"), map(text, zip(*columns, strict=True)), strict=True))
    files = {f"{name}.csv": as_csv(ANALYSES[name].row, rows) for name, rows in readable.items()}
    return {"columns.csv": csv_of(sheet), **files}
