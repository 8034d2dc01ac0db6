"""The tables of the analysis: against the paper, tests, exploiters, champions tried again, a champion's line."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby
from math import isfinite

from pipeline.report.findings import Findings, TankTest
from pipeline.report.lineage import main_line
from pipeline.report.wording import NONE, absent, interval, number, p_value
from tasks.analysis import Contrast, Crossing, Row, SignificanceTest, Tank
from tasks.analysis.paper import Verdict, name_of

MOST_SUSPECTS = 15
"""Designs of the ranking that the page lists; the table of the study has all."""
LINE_ENDS = 12
"""Ancestors listed from each end of a champion's line."""


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]], label: str, *, kind: str) -> str:
    """Put cells, which are HTML, into a table that scrolls sideways where the page is narrow."""
    head = "".join(f"<th>{column}</th>" for column in columns)
    # The column's name stands with each cell, since where a page is narrow a wordy row becomes a card.
    body = "".join(
        "<tr>"
        + "".join(f'<td data-column="{name}">{cell}</td>' for name, cell in zip(columns, row, strict=True))
        + "</tr>"
        for row in rows
    )
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(label)}">'
        f'<table class="{kind}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


# -- against the paper ------------------------------------------------------------------------------------------------

MARKS: dict[Verdict, str] = {"agrees": "✓", "differs": "≠", "not comparable": "?"}
"""So that colour is never the only difference."""


def against_paper(findings: Findings) -> str:
    """Tabulate every number and statement of the paper beside this run's."""
    rows = findings.against_paper
    title = "The table against the paper"
    if not rows:
        return absent(title, findings.why("against_paper", "the study has not been analysed yet"))
    columns = ("What", "Paper", "This run", "Verdict", "Why")
    unmeasured = [row for row in rows if row.this_run == "-"]
    tests = [row for row in rows if row.what.startswith("Student") and row not in unmeasured]
    numbers = [row for row in rows if row not in tests and row not in unmeasured]
    table = _table(columns, (_paper_cells(row) for row in numbers), title, kind="wordy") if numbers else ""
    for folded, name in ((tests, "t tests of the paper"), (unmeasured, "more that this run has nothing for")):
        if folded:
            rest = _table(columns, (_paper_cells(row) for row in folded), name, kind="wordy")
            gist = f" <small>{_verdicts(folded)}</small>" if folded is tests else ""
            table += f"<details><summary>{len(folded)} {name}{gist}</summary>{rest}</details>"
    return (
        f'<div id="against_paper"><h3>Against the paper: {_verdicts(rows)}</h3>{table}'
        '<p class="small">Under this run’s number stands its 95 % interval: how well these trials or designs know it '
        "(of means Student’s t, of ratios and regressions the bootstrap, which draws whole trials; of a range over "
        "members those of its two ends, for these members and other trials; of a t test that of the difference of the "
        "means). A number agrees "
        "where the paper’s lies in the wider 95 % prediction interval, under “Why”: the range into which a repeat of "
        "this run with as many trials as the paper’s would fall. What the paper gives as a range over members agrees "
        "where this run’s median member is in it; the ratio of deviations where its whole interval is above 1. A t "
        "test agrees where its p is on the paper’s side of the paper’s "
        "threshold; fewer trials than the paper’s make large p-values easy and small ones hard, so what they fail to "
        "show is not comparable.</p></div>"
    )


def _verdicts(rows: Sequence[Row]) -> str:
    counts = Counter(row.verdict for row in rows)
    return ", ".join(f"{counts[verdict]} {_PLURAL[verdict]}" for verdict in MARKS if counts[verdict])


_PLURAL: dict[Verdict, str] = {"agrees": "agree", "differs": "differ", "not comparable": "not comparable"}


def _paper_cells(row: Row) -> list[str]:
    kind = row.verdict.replace(" ", "-")
    return [
        f"{_minus(escape(row.what))}<small>{escape(row.source)}</small>",
        _minus(escape(row.paper)),
        _minus(escape(row.this_run) + (f"<small>{escape(row.interval)}</small>" if row.interval else "")),
        f'<span class="verdict {kind}"><span aria-hidden="true">{MARKS[row.verdict]}</span> {row.verdict}</span>',
        _minus(escape(row.why)),
    ]


def _minus(text: str) -> str:
    """Write the minus of numbers as such, and keep a number and its metres on one line."""
    return re.sub(r"(?<=\d) m\b", "\u00a0m", re.sub(r"(?<![\w.])-(?=\d)", "−", text))


# -- tests ------------------------------------------------------------------------------------------------------------


def contrasts(findings: Findings) -> str:
    """Tabulate every contrast over depths, each folded under its name."""
    title = "The table of tests"
    if not findings.contrasts:
        return absent(title, findings.why("contrasts", "no two arms have champions at one depth yet"))
    folded = []
    for (a, b), group in groupby(findings.contrasts, key=lambda contrast: (contrast.a, contrast.b)):
        rows = list(group)
        name = f"{name_of(a)} against {name_of(b)}"
        deepest = rows[-1]
        ratio = deepest.comparison.ratio.value
        gist = f"{deepest.depth:g}\u00a0m: " + (_times(ratio) if ratio is not None else "")
        gist += f"p\u00a0{_relation(deepest.comparison.student.p)}"
        table = _table(
            ("Depth", "Means [m]", "Ratio", "Student’s t", "Welch", "Mann–Whitney", "Hedges’ g"),
            (_contrast_cells(row) for row in rows),
            name,
            kind="tests",
        )
        folded.append(f"<details><summary>{escape(name)} <small>{escape(gist)}</small></summary>{table}</details>")
    return (
        f'<div id="contrasts"><h3>Tests</h3>{"".join(folded)}<p class="small">Two-sided p-values; under each the same '
        "after Holm’s correction over the depths. Student’s t is the paper’s; Welch’s does not assume equal variances, "
        "Mann–Whitney no normality either. Ratios of means with 95 % bootstrap intervals; Hedges’ g is the difference "
        "in standard deviations.</p></div>"
    )


def _times(ratio: float) -> str:
    return f"{ratio:.0%} of it, ".replace("-", "−") if ratio < 2 else f"{ratio:.1f} times it, "


def _relation(p: float | None) -> str:
    return p_value(p) if p is not None and p < 1e-4 else f"= {p_value(p)}"


def _contrast_cells(row: Contrast) -> list[str]:
    made = row.comparison
    means = "<br>".join(
        f"{NONE if side.mean.value is None else number(side.mean.value)}"
        f"{f' ± {number(side.sd)}' if side.sd is not None else ''} (n\u00a0=\u00a0{side.n})"
        for side in (made.a, made.b)
    )
    return [
        f"{row.depth:g} m",
        means,
        interval(made.ratio, "{:.2f}"),
        _test_cell(made.student, row.student_holm),
        _test_cell(made.welch, row.welch_holm),
        _test_cell(made.mann_whitney, row.mann_whitney_holm),
        interval(made.hedges_g),
    ]


def _test_cell(test: SignificanceTest, holm: float | None) -> str:
    if test.p is None:
        return f"{NONE}<small>{escape(test.reason or '')}</small>"
    return f"{escape(p_value(test.p))}<small>Holm {escape(p_value(holm))}</small>"


# -- exploiters, and luck ---------------------------------------------------------------------------------------------


def suspects(findings: Findings) -> str:
    """Tabulate the designs that promise most and keep least."""
    title = "The list of exploiters"
    if not findings.suspects:
        return absent(title, findings.why("suspects", "no design has been ranked yet"))
    listed = findings.suspects[:MOST_SUSPECTS]
    rows = []
    for suspect in listed:
        found = suspect.exploiter
        excess = f"<small>{escape(found.reason)}</small>" if found.reason else ""
        rows.append(
            [
                f"{found.rank}. {escape(suspect.label)}",
                _metres(found.predicted),
                _metres(found.true),
                f"{_metres(found.excess)}{excess}",
                _metres(found.disagreement),
            ]
        )
    columns = ("Design", "Predicted [m]", "True [m]", "Imagined [m]", "σ of members [m]")
    return (
        f'<div id="suspects"><h3>Exploiters: the worst {len(listed)} of {len(findings.suspects)}</h3>'
        f'{_table(columns, rows, title, kind="named")}<p class="small">Ranked by how much further the members '
        "together say a design gets than it does in True Slush; where that is not known, by how much they disagree."
        "</p></div>"
    )


def _metres(value: float | None) -> str:
    return NONE if value is None else number(value)


def retried(findings: Findings) -> str:
    """Tabulate what champions lose when they are tried again, and how much of their way is reach."""
    title = "The table of luck and reach"
    if not findings.retried:
        return absent(title, findings.why("retried", "no champion has been tried again yet"))
    rows = [
        [escape(row.label), _metres(row.claimed), interval(row.loss), _metres(row.reach)] for row in findings.retried
    ]
    columns = ("Champion", "Claimed [m]", "Lost when tried again [m]", "Reach [m]")
    return (
        f'<details id="retried"><summary>Luck and reach of {len(rows)} champions</summary>'
        f'{_table(columns, rows, title, kind="named")}<p class="small">Each champion was tried again where it evolved, '
        "with its attachments moved by 1e-4 of half a link: what it loses on average was luck that no copy of it has. "
        "Reach is the root’s displacement less the whole robot’s, in True Slush: gained by "
        "stretching out.</p></details>"
    )


# -- the robot to build -----------------------------------------------------------------------------------------------


def tank_tests(findings: Findings) -> str:
    """Tabulate the champions in the virtual tank, and say which is proposed for building; nothing without a tank."""
    if not findings.tank_tests:
        return ""
    tank = findings.tank_tests[0].tank
    said = (
        "<p>The champion nearest the champions’ mean in True Slush is the one to build (✓). Each was let loose in a "
        f"tank of {tank.length:g} m, filled {1000 * tank.depth:g} mm deep, at {1000 * tank.scale:g} mm for a metre of "
        f"simulation: {tank.simulated_length:.1f} m by {tank.simulated_depth:.2f} m to the robot; and on its dry "
        "floor. It has crossed when its centre of mass has come as far as its front was from the other end, in "
        f"{tank.seconds:g} s at most. What is said of the tank is of the robot as built: lengths by that scale, "
        f"times by Froude’s law, under which a second of simulation is {tank.built_seconds(1.0):.3f} s; it alone keeps "
        "the proportions of all forces. The paper gives no scale of times. Its robot crossed in 8 of 8 trials, and "
        "moved a few centimetres on the dry floor.</p>"
    )
    tables = "".join(_tank_table(test) for test in findings.tank_tests)
    return f'<section id="tank"><h2>The robot to build</h2>{said}{tables}</section>'


def _tank_table(test: TankTest) -> str:
    if not test.candidates:
        return absent(f"The tank test of {test.label}", "no trial has a champion")
    columns = ("Champion", "True Slush [m]", "Dry Land [m]", "Length [m]", "In the tank", "On its dry floor")
    rows = [
        [
            f"{'✓ ' if of.proposed else ''}trial {of.trial}",
            _metres(of.zero_shot),
            _metres(of.dry_land),
            _metres(of.wet.length if isfinite(of.wet.length) else None),
            _crossing(of.wet, test.tank),
            _crossing(of.dry, test.tank),
        ]
        for of in test.candidates
    ]
    n = len(rows)
    wet, dry = (sum(getattr(of, where).crossed for of in test.candidates) for where in ("wet", "dry"))
    return (
        f"<h3>{escape(test.label)}: {wet} of {n} cross, {dry} on the dry floor</h3>"
        f"{_table(columns, rows, f'The tank test of {test.label}', kind='named')}"
    )


def _crossing(found: Crossing, tank: Tank) -> str:
    """Say how long a robot took, or how far it came; and at what speed, both as built."""
    if not isfinite(found.travelled):
        return f"{NONE}<small>it diverged</small>"
    speed = f"{number(1000 * tank.built_speed(found.speed))} mm/s"
    if found.crossed:
        return f"{tank.built_seconds(found.seconds):.0f} s<small>{speed}</small>"
    if found.distance <= 0:
        return f"{NONE}<small>it is as long as the tank</small>"
    travelled, distance = (number(100 * tank.scale * metres) for metres in (found.travelled, found.distance))
    return f"{travelled} of {distance} cm<small>{speed}</small>"


# -- a champion's line ------------------------------------------------------------------------------------------------


def lineage(findings: Findings) -> str:
    """Tabulate a champion's line back through the fitter parent of each ancestor, its middle left out if long."""
    if findings.family is None or not findings.family.ancestors:
        return ""  # the figure beside it says why
    line = main_line(findings.family)
    rows = [
        [
            f"{ancestor.generation}",
            escape(ancestor.operator),
            f"{ancestor.age}",
            NONE if ancestor.n_genes_changed is None else f"{ancestor.n_genes_changed}",
            number(ancestor.fitness),
        ]
        for ancestor in line
    ]
    if len(rows) > 2 * LINE_ENDS:
        left_out = f"… {len(rows) - 2 * LINE_ENDS} more"
        rows = [*rows[:LINE_ENDS], [left_out, "", "", "", ""], *rows[-LINE_ENDS:]]
    table = _table(
        ("Generation", "Made by", "Age", "Genes changed", "Fitness [m]"), rows, "The champion’s line", kind="named"
    )
    return f"<details><summary>The champion’s line: {len(line)} designs</summary>{table}</details>"
