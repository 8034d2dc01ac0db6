"""Tables for a reader: rows of a registered dataclass as HTML, terminal text, Markdown, LaTeX, CSV or JSON.

The fields of the dataclass say how each value is written (tasks/analysis/registry.py). Estimates are written with their
interval, means with their deviation. Columns without any value are left out.
"""

import json
import re
import textwrap
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from itertools import zip_longest
from typing import Any

from markupsafe import Markup

from pipeline.report.document import TEMPLATES
from pipeline.store.tables import columns_of, csv_of, described
from tasks.analysis.columns import environment_name, scored_by
from tasks.analysis.comparison import VERDICTS
from tasks.analysis.estimates import Estimate, Mean, between
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
class WrittenColumn:
    """A column of text."""

    name: str  # of the field
    heading: str
    meaning: str
    cells: list[Cell]

    @cached_property
    def is_number(self) -> bool:
        """Whether it holds numbers, which are aligned to the right."""
        return all(re.match(r"[−+<±\d–]", cell.main) for cell in self.cells)


def written(
    kind: type, rows: Sequence[Any], without: Sequence[str] = (), learners: Mapping[str, Learner] = NO_LEARNERS
) -> list[WrittenColumn]:
    """Write the columns that readers of a study with these learners see, without some that are said elsewhere."""
    columns = []
    for field in fields(kind):
        about, values = field.metadata, [getattr(row, field.name) for row in rows]
        if about["shown"] and field.name not in without and not all(map(_is_absent, values)):
            form, heading = about["form"], f"{about['label']} [{about['unit']}]" if about["unit"] else about["label"]
            if form in (environment_name, ensemble_name):
                form = partial(form, learners=learners)
            columns.append(
                WrittenColumn(field.name, heading, about["meaning"], [_cell(value, form) for value in values])
            )
    return columns


def _is_absent(value: Any) -> bool:
    return value in (None, "", Estimate(None), Mean(None)) or value != value  # NaN


def _cell(value: Any, form: str | Callable[[Any], str]) -> Cell:
    if _is_absent(value):
        return Cell()
    if isinstance(value, Estimate):
        return Cell(_write(value.value, form), between(*(_write(end, form) for end in value.interval or ())))
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
    columns = written(kind, rows, without, learners)
    table = [(row, zip(columns, cells, strict=True)) for row, cells in zip(rows, _by_row(columns), strict=True)]
    template = TEMPLATES.get_template("table.html")
    return Markup(template.render(columns=columns, rows=table, label=label, address=address))


def _by_row(columns: Sequence[WrittenColumn]) -> Iterator[tuple[Cell, ...]]:
    return zip(*(column.cells for column in columns), strict=True)


def as_text(
    kind: type,
    rows: Sequence[Any],
    without: Sequence[str] = (),
    *,
    width: int = _WIDTH,
    learners: Mapping[str, Learner] = NO_LEARNERS,
) -> list[str]:
    """Return lines for a terminal of a width [characters], with words wrapped and numbers aligned to the right."""
    columns = written(kind, rows, without, learners)
    for most in _MOST_CHARACTERS:
        laid_out = [_laid_out(column, most) for column in columns]
        widths = [len(cells[0][0]) for cells in laid_out]
        if sum(widths) + 2 * (len(widths) - 1) <= width:
            break
    lines = (parts for cells in zip(*laid_out, strict=True) for parts in zip_longest(*cells, fillvalue=""))
    return ["  ".join(map(str.ljust, parts, widths)).rstrip() for parts in lines]


def _laid_out(column: WrittenColumn, most: int) -> list[list[str]]:
    """Return the lines of a heading and each cell, of equal width; in narrow lines, intervals are below numbers."""
    below = "\n" if column.is_number and most < _MOST_CHARACTERS[0] else " "
    texts = [cell.text.replace(" (", f"{below}(", 1).replace("\u00a0", " ") for cell in column.cells]
    longest = max((len(line) for text in texts for line in text.split("\n")), default=0)
    width = max(longest if column.is_number else min(longest, most), *map(len, column.heading.split()))
    align = str.rjust if column.is_number else str.ljust
    wrapped = [
        [part for line in text.split("\n") for part in textwrap.wrap(line, width, break_on_hyphens=False)]
        for text in (column.heading, *texts)
    ]
    return [[align(line, width) for line in lines] for lines in wrapped]


def as_markdown(kind: type, rows: Sequence[Any]) -> str:
    """Return a table in Markdown."""
    columns = written(kind, rows)
    rules = ["--:" if column.is_number else "---" for column in columns]
    cells = [[cell.text for cell in row] for row in _by_row(columns)]
    lines = [[column.heading for column in columns], rules, *cells]
    return "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)


def as_latex(kind: type, rows: Sequence[Any], caption: str, learners: Mapping[str, Learner] = NO_LEARNERS) -> str:
    """Return a ``tabular``, which a paper reads with the command input; it needs the package booktabs."""
    columns = written(kind, rows, learners=learners)
    aligned = "".join("r" if column.is_number else "l" for column in columns)
    lines = [[column.heading for column in columns], *([cell.text for cell in row] for row in _by_row(columns))]
    head, *body = (" & ".join(map(_latex, line)) + r" \\" for line in lines)
    meanings = [f"% {column.heading}: {column.meaning}" for column in columns if column.meaning]
    begin, end = [rf"\begin{{tabular}}{{{aligned}}}", r"\toprule"], [r"\bottomrule", r"\end{tabular}", ""]
    return "\n".join([f"% {caption}", *meanings, *begin, head, r"\midrule", *body, *end])


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
    return [
        {name: None if value != value else value for name, value in zip(columns, row, strict=True)} for row in values
    ]


WRITERS: dict[str, Callable[[type, Sequence[Any], str], str]] = {
    ".md": lambda kind, rows, caption: as_markdown(kind, rows),
    ".tex": as_latex,
    ".csv": lambda kind, rows, caption: as_csv(kind, rows).decode(),
    ".json": lambda kind, rows, caption: json.dumps(as_json(kind, rows), indent=1, ensure_ascii=False) + "\n",
}
"""Writers of a table, by the suffix of the file."""


@dataclass(frozen=True)
class ColumnNote:
    """What a table or, where it names one, a column holds."""

    table: str
    column: str
    unit: str
    meaning: str


def tables_of(
    tables: Mapping[str, Sequence[Any]], objective: Objective = OBJECTIVES[PAPERS_OBJECTIVE]
) -> dict[str, bytes]:
    """Return a study's tables of readable size as CSV, by file name, and the unit and meaning of every column."""
    readable = {name: rows for name, rows in tables.items() if 0 < len(rows) <= _MOST_ROWS_OF_CSV}
    notes = [
        ColumnNote(name, column, about.get("unit", ""), about.get("meaning") or about.get("label", ""))
        for name in readable
        for column, about in described(scored_by(objective, ANALYSES[name].row)).items()
    ]
    files = {f"{name}.csv": as_csv(ANALYSES[name].row, rows) for name, rows in readable.items()}
    return {"columns.csv": as_csv(ColumnNote, notes), **files} if files else {}
