"""The tables of the analysis on the page: against the paper, tests, exploiters, luck, the tank, a champion's line."""

import re
from collections import Counter
from collections.abc import Sequence
from html import escape
from itertools import groupby
from math import isfinite

from pipeline.report.data import arm_words
from pipeline.report.findings import ExploiterRow, Findings, TankRow
from pipeline.report.lineage import main_line
from pipeline.report.wording import NONE, absent, folded, interval, number, p_value, signed, table
from tasks.analysis.comparison import Contrast, SignificanceTest
from tasks.analysis.paper import Row, Verdict, name_of
from tasks.analysis.tank import Crossing, Tank

MOST_EXPLOITERS = 15  # designs listed on the page; the table of the study has all
LINE_ENDS = 12  # ancestors listed from each end of a champion's line


_MARKS: dict[Verdict, str] = {"agrees": "✓", "differs": "≠", "not comparable": "?"}  # not by colour alone
_PLURAL: dict[Verdict, str] = {"agrees": "agree", "differs": "differ", "not comparable": "not comparable"}


def against_paper(findings: Findings) -> str:
    """Tabulate every number and statement of the paper beside this run's."""
    rows = findings.against_paper
    title = "The comparison with the paper"
    if not rows:
        return absent(title, findings.why("against_paper", "the study has not been analysed yet"))
    columns = ("What", "Paper", "This run", "Verdict", "Why")
    unmeasured = [row for row in rows if row.this_run == "-"]
    tests = [row for row in rows if row.what.startswith("Student") and row not in unmeasured]
    numbers = [row for row in rows if row not in tests and row not in unmeasured]
    content = table(columns, (_paper_cells(row) for row in numbers), title, kind="wordy") if numbers else ""
    for hidden, name in ((tests, "t tests of the paper"), (unmeasured, "numbers that this run did not measure")):
        if hidden:
            gist = f" <small>{_verdicts(hidden)}</small>" if hidden is tests else ""
            rest = table(columns, (_paper_cells(row) for row in hidden), name, kind="wordy")
            content += folded(f"{len(hidden)} {name}{gist}", rest)
    return (
        f'<div id="against_paper"><h3>Comparison with the paper: {_verdicts(rows)}</h3>{content}'
        '<p class="small">Below each number of this run is its 95 % interval: Student’s t for means, the bootstrap '
        "over whole trials for ratios and regressions, the intervals of both ends for a range over members, and the "
        "difference of the means for a t test. A number agrees if the paper’s value lies in the 95 % prediction "
        "interval given under “Why”. That interval is wider: it is where a repeat of this run with the paper’s number "
        "of trials would fall. A range over members agrees if it contains this run’s median member, and the ratio of "
        "deviations if its whole interval is above 1. A t test agrees if its p-value is on the same side of the "
        "paper’s threshold. With fewer trials than the paper, large p-values are easy to get and small ones hard, so "
        "a difference that such a test fails to show is not comparable.</p></div>"
    )


def _verdicts(rows: Sequence[Row]) -> str:
    counts = Counter(row.verdict for row in rows)
    return ", ".join(f"{counts[verdict]} {_PLURAL[verdict]}" for verdict in _MARKS if counts[verdict])


def _paper_cells(row: Row) -> list[str]:
    kind = row.verdict.replace(" ", "-")
    return [
        f"{_minus(escape(row.what))}<small>{escape(row.source)}</small>",
        _minus(escape(row.paper)),
        _minus(escape(row.this_run) + (f"<small>{escape(row.interval)}</small>" if row.interval else "")),
        f'<span class="verdict {kind}"><span aria-hidden="true">{_MARKS[row.verdict]}</span> {row.verdict}</span>',
        _minus(escape(row.why)),
    ]


def _minus(text: str) -> str:
    """Replace hyphens before numbers by minus signs, and keep a number and its unit on one line."""
    return re.sub(r"(?<=\d) m\b", "\u00a0m", re.sub(r"(?<![\w.])-(?=\d)", "−", text))


def contrasts(findings: Findings) -> str:
    """Tabulate every contrast by depth, each folded under its name."""
    title = "The table of tests"
    if not findings.contrasts:
        return absent(title, findings.why("contrasts", "no two arms have champions at the same depth yet"))
    content = ""
    for (a, b), group in groupby(findings.contrasts, key=lambda contrast: (contrast.a, contrast.b)):
        rows = list(group)
        name = f"{name_of(a)} against {name_of(b)}"
        deepest = rows[-1]
        ratio, p = deepest.comparison.ratio.value, deepest.comparison.student.p
        gist = f"{deepest.depth:g}\u00a0m: " + ("" if ratio is None else f"ratio {signed('{:.2f}', ratio)}, ")
        gist += f"p\u00a0{'' if p is not None and p < 1e-4 else '= '}{p_value(p)}"
        columns = ("Depth", "Means [m]", "Ratio", "Student’s t", "Welch", "Mann–Whitney", "Hedges’ g")
        rest = table(columns, (_contrast_cells(row) for row in rows), name, kind="tests")
        content += folded(f"{escape(name)} <small>{escape(gist)}</small>", rest)
    return (
        f'<div id="contrasts"><h3>Tests</h3>{content}<p class="small">Two-sided p-values, and below each the p-value '
        "after Holm’s correction over the depths. The paper uses Student’s t test. Welch’s test does not assume equal "
        "variances, and Mann–Whitney’s does not assume normality either. Ratios of means have 95 % bootstrap "
        "intervals. Hedges’ g is the difference in standard deviations.</p></div>"
    )


def _contrast_cells(row: Contrast) -> list[str]:
    made = row.comparison
    means = "<br>".join(
        f"{number(side.mean.value)}{f' ± {number(side.sd)}' if side.sd is not None else ''} (n\u00a0=\u00a0{side.n})"
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


def exploiters(findings: Findings) -> str:
    """Tabulate the designs whose prediction exceeds the truth most."""
    title = "The list of exploiters"
    if not findings.exploiters:
        return absent(title, findings.why("exploiters", "no design has been ranked yet"))
    listed = findings.exploiters[:MOST_EXPLOITERS]
    columns = ("Design", "Predicted [m]", "True [m]", "Hallucinated [m]", "σ of members [m]")
    return (
        f'<div id="suspects"><h3>Exploiters: the top {len(listed)} of {len(findings.exploiters)}</h3>'
        f"{table(columns, (_exploiter_cells(row) for row in listed), title, kind='named')}"
        '<p class="small">Ranked by the hallucinated displacement, which is the ensemble’s prediction minus the '
        "displacement in True Slush; where that is unknown, by the standard deviation over the members.</p></div>"
    )


def _exploiter_cells(row: ExploiterRow) -> list[str]:
    which = "champion" if row.kind == "champion" else f"generation {row.generation}"
    return [
        f"{row.rank}. {escape(arm_words(row.environment, row.depth))}, trial {row.trial}, {which}",
        number(row.predicted),
        number(row.true),
        number(row.excess) + (f"<small>{escape(row.reason)}</small>" if row.reason else ""),
        number(row.disagreement),
    ]


def retried(findings: Findings) -> str:
    """Tabulate what champions lose when they are simulated again, and the reach in their displacement."""
    title = "The table of luck and reach"
    rows = [
        [f"{escape(arm)}, trial {of.trial}", number(of.luck.claimed), interval(of.luck.loss), number(of.slush.reach)]
        for arm, champions in findings.champions.items()
        for of in champions
    ]
    if not rows:
        return absent(title, findings.why("champions", "no champion has been simulated again yet"))
    columns = ("Champion", "Fitness [m]", "Luck [m]", "Reach [m]")
    note = (
        '<p class="small">Luck: each champion was simulated again where it evolved, with its attachments shifted by '
        "1e-4 of half a link. The mean loss of fitness is luck that no copy of the robot shares. Reach: displacement "
        "of the root minus that of the centre of mass in True Slush, which a robot gains by stretching out.</p>"
    )
    content = table(columns, rows, title, kind="named") + note
    return folded(f"Luck and reach of {len(rows)} champions", content, attributes=' id="retried"')


def tank_tests(findings: Findings) -> str:
    """Tabulate the champions in the virtual tank and mark the one proposed for building; nothing without a tank."""
    tank = findings.tank
    if tank is None or not findings.tank_tests:
        return ""
    intro = (
        "<p>In each arm, the champion nearest to the champions’ mean in True Slush is proposed for building (✓). Each "
        f"champion was simulated in a tank of {tank.length:g} m, filled {1000 * tank.depth:g} mm deep, and on the "
        f"floor of the drained tank. At a scale of {1000 * tank.scale:g} mm per simulated metre, the tank measures "
        f"{tank.simulated_length:.1f} m by {tank.simulated_depth:.2f} m for the robot. A robot has crossed the tank "
        "when its centre of mass has travelled as far as the distance from its front to the far end at the start, "
        f"within {tank.seconds:g} s. Lengths and times are those of the built robot. By Froude’s law, "
        f"which alone preserves the ratios of all forces, a simulated second is {tank.built_seconds(1.0):.3f} s. The "
        "paper gives no scale of time. Its robot crossed in 8 of 8 trials, and moved a few centimetres on the dry "
        "floor.</p>"
    )
    tables = "".join(_tank_table(arm, rows, tank) for arm, rows in findings.tank_tests.items())
    return f'<section id="tank"><h2>The robot to build</h2>{intro}{tables}</section>'


def _tank_table(arm: str, rows: Sequence[TankRow], tank: Tank) -> str:
    label = f"The tank test of {arm}"
    if not rows:
        return absent(label, "no trial has a champion")
    columns = ("Champion", "True Slush [m]", "Dry Land [m]", "Length [m]", "In the tank", "On its dry floor")
    cells = [
        [
            f"{'✓ ' if row.proposed else ''}trial {row.trial}",
            number(row.zero_shot),
            number(row.dry_land),
            number(row.wet.length if isfinite(row.wet.length) else None),
            _crossing(row.wet, tank),
            _crossing(row.dry, tank),
        ]
        for row in rows
    ]
    wet, dry = sum(row.wet.crossed for row in rows), sum(row.dry.crossed for row in rows)
    heading = f"{escape(arm)}: {wet} of {len(rows)} cross the tank, {dry} the dry floor"
    return f"<h3>{heading}</h3>{table(columns, cells, label, kind='named')}"


def _crossing(found: Crossing, tank: Tank) -> str:
    """State the time to cross or the distance travelled, and the speed, all as built."""
    if not isfinite(found.travelled):
        return f"{NONE}<small>diverged</small>"
    speed = f"<small>{number(1000 * tank.built_speed(found.speed))} mm/s</small>"
    if found.crossed:
        return f"{tank.built_seconds(found.seconds):.0f} s{speed}"
    if found.distance <= 0:
        return f"{NONE}<small>as long as the tank</small>"
    travelled, distance = (number(100 * tank.scale * metres) for metres in (found.travelled, found.distance))
    return f"{travelled} of {distance} cm{speed}"


def lineage(findings: Findings) -> str:
    """Tabulate a champion's line through the fitter parent of each ancestor; the middle of a long line is left out."""
    if findings.family is None or not findings.family.ancestors:
        return ""  # the figure beside it gives the reason
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
    columns = ("Generation", "Made by", "Age", "Genes changed", "Fitness [m]")
    label = "The champion’s line"
    return folded(f"{label}: {len(line)} designs", table(columns, rows, label, kind="named"))
