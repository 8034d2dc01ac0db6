"""The tables of the analysis on the page: against the paper, tests, exploiters, luck, the tank, a champion's line."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from math import isfinite

from pipeline.report.data import MOST_EXPLOITERS, StudyReport, arm_words, robot_address
from pipeline.report.downloads import links
from pipeline.report.findings import ExploiterRow, Findings, TankRow
from pipeline.report.lineage import main_line
from pipeline.report.wording import NONE, absent, folded, interval, number, p_value, table
from pipeline.text import escape
from tasks.analysis.against_paper import Row
from tasks.analysis.comparison import Contrast, SignificanceTest
from tasks.analysis.equivalence import Verdict
from tasks.analysis.paper import NEGLIGIBLE_WORDS, is_t_test, name_of, t_test_words
from tasks.analysis.tank import Crossing, Tank, TankTrials
from tasks.evolution import OBJECTIVES

LINE_ENDS = 12  # ancestors listed from each end of a champion's line

RobotsOnPage = Mapping[tuple[str, int, int], str]  # address by arm in words, trial and identity (-1 for the champion)

VERDICT_MARKS: dict[Verdict, str] = {"agrees": "✓", "differs": "≠", "cannot tell": "?", "not comparable": "–"}
"""Marks of verdicts, so that colour is not the only difference."""
_PLURAL: dict[Verdict, str] = {"agrees": "agree", "differs": "differ"}


def robots_on(report: StudyReport) -> RobotsOnPage:
    """Return the addresses of the champions and exploiters that the viewer shows."""
    shown = {replay.robot for replay in report.replays if replay.robot}
    who = [(trial.environment, trial.depth, trial.trial, -1) for trial in report.trials]
    who += [(row.environment, row.depth, row.trial, row.identity) for row in report.findings.exploiters]
    addresses = {
        (arm_words(environment, depth), trial, identity): robot_address(environment, depth, trial, identity)
        for environment, depth, trial, identity in who
    }
    return {key: address for key, address in addresses.items() if address in shown}


def _linked(words: str, robots: RobotsOnPage, key: tuple[str, int, int], *, predicted: bool = False) -> str:
    """Link words to a robot, seen in True Slush or as predicted, if the viewer shows it."""
    address = robots.get(key)
    return f'<a href="#{address}{":predicted" if predicted else ""}">{words}</a>' if address else words


def against_paper(findings: Findings) -> str:
    """Tabulate every number of the paper beside this run's; nothing where none can be compared."""
    title = "The comparison with the paper"
    if not findings.against_paper:
        return absent(title, findings.why("against_paper", "the study has not been analysed yet"))
    if all(row.this_run == "-" for row in findings.against_paper):
        return ""
    of_numbers = [row for row in findings.against_paper if not is_t_test(row.what)]
    shown = [row for row in of_numbers if row.this_run != "-"]
    n_left_out = len(of_numbers) - len(shown)
    left_out = f" {n_left_out} numbers that this study does not measure are left out." if n_left_out else ""
    columns = ("What", "Paper", "This run", "Verdict", "Why")
    content = table(columns, (_paper_cells(row) for row in shown), title, kind="wordy") + links("paper.csv")
    return (
        f'<div id="against_paper"><h3>{count_verdicts(row.verdict for row in shown)}</h3>{content if shown else ""}'
        '<p class="small">Below each number of this run is its 95 % interval: Student’s t for means, the bootstrap '
        "over whole trials for ratios and regressions, and the intervals of both ends for a range over members."
        f"{_REPLICATES if findings.replicated else ''} A "
        "number agrees if the 95 % interval of its difference from the paper’s lies within the bounds given under "
        "“Why”, and differs if it lies outside; that interval includes the uncertainty of the paper’s own trials. A "
        "range over members agrees if it contains the interval of this run’s median member, and the ratio of "
        "deviations if its whole interval is above 1. Each verdict is of its row alone, without a correction for the "
        f"number of rows.{left_out}</p></div>"
    )


_REPLICATES = (
    " With several replicates, the intervals of means, ratios and regressions include the variance between these, and "
    "so does the variance of the paper’s own numbers, which come from a single replicate."
)


def count_verdicts(verdicts: Iterable[Verdict]) -> str:
    """Count each verdict, in words."""
    counts = Counter(verdicts)
    return ", ".join(
        f"{counts[verdict]} {verdict if counts[verdict] == 1 else _PLURAL.get(verdict, verdict)}"
        for verdict in VERDICT_MARKS
        if counts[verdict]
    )


def _paper_cells(row: Row) -> list[str]:
    return [
        f"{typeset(row.what[:1].upper() + row.what[1:])}<small>{typeset(row.source)}</small>",
        typeset(row.paper),
        typeset(row.this_run) + (f"<small>{typeset(row.interval)}</small>" if row.interval else ""),
        verdict_mark(row.verdict),
        typeset(row.why),
    ]


def verdict_mark(verdict: Verdict) -> str:
    """Write a verdict with its mark and its colour."""
    kind = verdict.replace(" ", "-")
    return f'<span class="verdict {kind}"><span aria-hidden="true">{VERDICT_MARKS[verdict]}</span> {verdict}</span>'


def typeset(text: str) -> str:
    """Set plain text as the page does: minus signs, curly quotes, and a number and its unit on one line; as HTML."""
    for plain, typeset in (
        (r"(?<![\w.])-(?= ?\d)", "−"),
        (r"(?<=\d) m\b", "\u00a0m"),
        (r"(?<=\d)%", "\u00a0%"),
        (r'"([^"]*)"', r"“\1”"),
        ("'", "’"),
    ):
        text = re.sub(plain, typeset, text)
    return escape(text)


def contrasts(findings: Findings) -> str:
    """Tabulate every contrast at every depth in one table, ranked by the p-value of the paper's test."""
    title = "The table of tests"
    if not findings.contrasts:
        return absent(title, findings.why("contrasts", "no two arms have champions at the same depth yet"))
    paper = {row.what: row for row in findings.against_paper if is_t_test(row.what) and row.verdict != "not comparable"}
    ranked = sorted(findings.contrasts, key=_by_p)
    judged = [
        (row, paper.get(t_test_words(row.depth, row.a, row.b)) or paper.get(t_test_words(row.depth, row.b, row.a)))
        for row in ranked
    ]
    beside_paper = any(statement for _, statement in judged)
    columns = ("Arms", "Means [m]", "Ratio", "Student’s p", "Other p-values", "Hedges’ g", "Paper")
    cells = [[*_contrast_cells(row), _statement_cell(statement)] for row, statement in judged]
    n_columns = len(columns) if beside_paper else len(columns) - 1
    content = table(columns[:n_columns], (row[:n_columns] for row in cells), title, kind="tests")
    replicated = any(side.n_replicates > 1 for row in ranked for side in (row.comparison.a, row.comparison.b))
    stated = [statement for _, statement in judged if statement]
    verdicts = f": {count_verdicts(row.verdict for row in stated)}" if stated else ""
    rule = (
        " “Less” and “greater” agree with the paper if the whole interval of the difference has that direction. "
        f"“No difference” agrees if that interval lies within {NEGLIGIBLE_WORDS} of the displacement of the designs "
        "evolved in True Slush: a large p-value shows nothing. The paper’s tests are one family, judged by Holm’s "
        "procedure, so that with a probability of about 95 % none is misjudged; the interval that judged each is in "
        "brackets."
    )
    return (
        f'<div id="contrasts"><h3>{len(ranked)} t tests, by p-value{verdicts}</h3>{content}{links("contrasts.csv")}'
        '<p class="small">Two-sided p-values, and below them the p-value after Holm’s correction over all of these '
        "tests. The paper uses Student’s t test. Welch’s test does not assume equal variances, and "
        "Mann–Whitney’s (M–W) does not assume normality either. Ratios of means have 95 % bootstrap intervals. Hedges’ "
        f"g is the difference in standard deviations.{_CLUSTERED if replicated else ''}{rule if stated else ''}</p>"
        "</div>"
    )


_CLUSTERED = (
    " These three tests treat trials as independent, as the paper does, but trials of one replicate share their throws "
    "and networks. The clustered test is Welch’s with errors that include the variance between replicates; so do the "
    "intervals of the ratios of such arms (delta method). Arms that share networks count as independent, which makes "
    "the test cautious."
)


def _by_p(row: Contrast) -> tuple[float, float]:
    """Rank tests with a p-value before those without, and ties by the size of the effect."""
    p, g = row.comparison.student.p, row.comparison.hedges_g.value
    return 2.0 if p is None else p, -abs(g or 0.0)


def _statement_cell(row: Row | None) -> str:
    if row is None:
        return NONE
    return f"{verdict_mark(row.verdict)}<small>{typeset(row.paper)}</small><small>{typeset(row.why)}</small>"


def _contrast_cells(row: Contrast) -> list[str]:
    made = row.comparison
    sides = (made.a, made.b)
    means = "<br>".join(
        number(side.mean.value) + ("" if side.sd is None else f" ± {number(side.sd)}") for side in sides
    )
    means += f"<small>n\u00a0=\u00a0{made.a.n}, {made.b.n}</small>"
    replicated = max(side.n_replicates for side in sides) > 1
    if replicated:
        means += f"<small>in {made.a.n_replicates}, {made.b.n_replicates} replicates</small>"
    other = "".join(
        f"<small>{name} {escape(p_value(test.p))}, Holm {escape(p_value(holm))}</small>"
        for name, test, holm in (
            ("Welch", made.welch, row.welch_holm),
            ("M–W", made.mann_whitney, row.mann_whitney_holm),
            ("Clustered", made.clustered, row.clustered_holm),
        )
        if test.p is not None and (replicated or name != "Clustered")
    )
    return [
        f"{escape(name_of(row.a))} against {escape(name_of(row.b))}<small>{row.depth:g}\u00a0m</small>",
        means,
        interval(made.ratio, "{:.2f}"),
        _test_cell(made.student, row.student_holm),
        other or NONE,
        interval(made.hedges_g),
    ]


def _test_cell(test: SignificanceTest, holm: float | None) -> str:
    if test.p is None:
        return f"{NONE}<small>{escape(test.reason or '')}</small>"
    return f"{escape(p_value(test.p))}<small>Holm {escape(p_value(holm))}</small>"


def exploiters(findings: Findings, robots: RobotsOnPage) -> str:
    """Tabulate the designs whose prediction exceeds the truth most, with links to the viewer."""
    title = "The list of exploiters"
    if not findings.exploiters:
        return absent(title, findings.why("exploiters", "no design has been ranked yet"))
    listed = findings.exploiters[:MOST_EXPLOITERS]
    columns = ("Design", "Predicted [m]", "True [m]", "Hallucinated [m]", "σ of members [m]")
    return (
        f'<div id="suspects"><h3>Exploiters: the top {len(listed)} of {len(findings.exploiters)}</h3>'
        f"{table(columns, (_exploiter_cells(row, robots) for row in listed), title, kind='named')}"
        f"{links('exploiters.csv')}"
        '<p class="small">Ranked by the hallucinated displacement, which is the ensemble’s mean prediction minus '
        "displacement in True Slush; where that is unknown, by the standard deviation over the members.</p></div>"
    )


def _exploiter_cells(row: ExploiterRow, robots: RobotsOnPage) -> list[str]:
    which, arm = (
        "champion" if row.kind == "champion" else f"generation {row.generation}",
        arm_words(row.environment, row.depth),
    )
    words = f"{escape(arm)}, trial {row.trial}, {which}"
    return [
        f"{row.rank}. {_linked(words, robots, (arm, row.trial, row.identity), predicted=True)}",
        number(row.predicted),
        number(row.true),
        number(row.excess) + (f"<small>{escape(row.reason)}</small>" if row.reason else ""),
        number(row.disagreement),
    ]


def retried(findings: Findings, robots: RobotsOnPage) -> str:
    """Tabulate what champions lose when they are simulated again, and the reach in their displacement."""
    title = "The table of luck and reach"
    rows = [
        [
            _linked(f"{escape(arm)}, trial {champion.trial}", robots, (arm, champion.trial, -1)),
            number(champion.luck.claimed),
            interval(champion.luck.loss),
            number(champion.slush.reach),
        ]
        for arm, champions in findings.champions.items()
        for champion in champions
    ]
    if not rows:
        return absent(title, findings.why("champions", "no champion has been simulated again yet"))
    unit = OBJECTIVES[findings.objective].unit
    columns = ("Champion", f"Fitness [{unit}]", f"Luck [{unit}]", "Reach [m]")
    note = (
        '<p class="small">Luck: each champion was simulated again where it evolved, with its attachments shifted by '
        "1e-4 of half a link. The mean loss of fitness is luck that no copy of the robot shares. Reach: displacement "
        "of the root minus that of the centre of mass in True Slush, which a robot gains by stretching out.</p>"
    )
    content = table(columns, rows, title, kind="named") + links("luck.csv") + note
    return folded(f"Luck and reach of {len(rows)} champions", content, attributes=' id="retried"')


def tank_tests(findings: Findings, robots: RobotsOnPage) -> str:
    """Tabulate the champions in the virtual tank and mark the one proposed for building; nothing without a tank."""
    tank = findings.tank
    if tank is None or not findings.tank_tests:
        return ""
    intro = (
        "<p>In each arm, the champion nearest to the champions’ mean in True Slush is proposed for building (✓). Each "
        f"champion was simulated in a tank of {tank.length:g} m, filled {1000 * tank.depth:g} mm deep, and on the "
        "floor of the drained tank. The simulated tank has no walls; in a real one, a robot that moves backwards stays "
        f"at its end. At a scale of {1000 * tank.scale:g} mm per simulated metre, the tank measures "
        f"{tank.simulated_length:.1f} m by {tank.simulated_depth:.2f} m for the robot. A robot has crossed the tank "
        "when its centre of mass has travelled as far as the distance from its front to the far end at the start, "
        f"within {tank.seconds:g} s. Lengths and times are those of the built robot, in the first trial. By Froude’s "
        "law, which alone preserves the ratios of all forces, a simulated second is "
        f"{tank.built_seconds(1.0):.3f} s. The paper gives no scale of time; the speed of its servos suggests that it "
        "kept the simulation’s frequencies, and then a simulated second is one second, and fewer trials cross in time: "
        "their number is in brackets. Each further trial begins at another moment of the gait, with joints shifted by "
        "1e-4 of half a link.</p>"
        f"<p>The tank is {1000 * tank.width:g} mm wide and {1000 * tank.height:g} mm high. Two pontoons make every "
        f"robot {1000 * tank.robot_width:g} mm wide. Its size is its length × height as built, settled in the filled "
        "tank. Where a robot is too long, too wide or too high for the tank, the table says so. If it is too long or "
        "too wide, it can’t cross. If it is too high, it may, because the tank is open at the top.</p>"
        "<p>The paper’s robot crossed in 8 of 8 trials. On the dry floor it moved a few centimetres in 6 of 6, “due to "
        "insufficient torque”. So the dry floor is tried with two limits of torque: first with the simulation’s, then "
        f"with that of the built robot’s servos, whose {tank.servo_torque:g} N·m are the other number in the table’s "
        f"head, scaled as weight times length. A robot that ends within {100 * tank.immobile:g} cm of its start is "
        "immobile.</p>"
    )
    tables = "".join(_tank_table(arm, rows, tank, robots) for arm, rows in findings.tank_tests.items())
    return f"{intro}{tables}{links('tank.csv')}"


def _tank_table(arm: str, rows: Sequence[TankRow], tank: Tank, robots: RobotsOnPage) -> str:
    label = f"The tank test of {arm}"
    if not rows:
        return absent(label, "no trial has a champion")
    limits = (f"Dry floor, {torque:.0f}\u00a0N·m" for torque in (rows[0].motor_torque, rows[0].servo_torque))
    columns = ("Champion", "True Slush [m]", "Size [cm]", "In the tank", *limits)
    cells = [
        [
            ("✓ " if row.proposed else "") + _linked(f"trial {row.trial}", robots, (arm, row.trial, -1)),
            number(row.zero_shot),
            _built_size(row.wet, tank),
            _crossing(row.wet, tank) + _trials(row.wet_trials),
            _crossing(row.dry, tank) + _trials(row.dry_trials, immobile=True),
            _crossing(row.dry_servo, tank) + _trials(row.dry_servo_trials, immobile=True),
        ]
        for row in rows
    ]
    wet, dry, servo = (sum(getattr(row, test).crossed for row in rows) for test in ("wet", "dry", "dry_servo"))
    misfits = sum(bool(row.wet.misfit or row.dry.misfit) for row in rows)
    counts = f"{wet} of {len(rows)} cross the tank, {dry} the dry floor, {servo} with the servo’s torque"
    fit = f"; {misfits} of them do not fit" if misfits else ""
    return f"<h3>{escape(arm)}: {counts}{fit}</h3>{table(columns, cells, label, kind='named')}"


def _built_size(found: Crossing, tank: Tank) -> str:
    sizes = (100 * tank.scale * metres for metres in (found.length, found.height))
    return NONE if not isfinite(found.length) else " × ".join(f"{size:.0f}" for size in sizes)


def _trials(trials: TankTrials, *, immobile: bool = False) -> str:
    stays = f"<small>immobile {trials.n_immobile}</small>" if immobile else ""
    return f"<small>crosses {trials.n_crossed} of {trials.n} ({trials.n_crossed_at_kept_frequencies})</small>{stays}"


def _crossing(found: Crossing, tank: Tank) -> str:
    """State the time to cross or the distance, and the speed, all as built, and why the robot does not fit."""
    if not isfinite(found.travelled):
        return f"{NONE}<small>diverged</small>"
    misfit = f"<small>{escape(found.misfit)}</small>" if found.misfit else ""
    speed = f"<small>{number(1000 * tank.built_speed(found.speed))} mm/s</small>"
    if found.crossed:
        return f"{tank.built_seconds(found.seconds):.0f} s{speed}{misfit}"
    if not tank.lets_pass(found.distance):
        return f"{NONE}{misfit}"
    if found.travelled < 0:  # the real tank's wall stops it
        return f"0.0 of {number(100 * tank.scale * found.distance)} cm<small>backwards</small>{misfit}"
    travelled, distance = (number(100 * tank.scale * metres) for metres in (found.travelled, found.distance))
    return f"{travelled} of {distance} cm{speed}{misfit}"


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
    columns = ("Generation", "Made by", "Age", "Genes changed", f"Fitness [{OBJECTIVES[findings.objective].unit}]")
    label = "The champion’s line"
    content = table(columns, rows, label, kind="named") + links("lineage.csv")
    return folded(f"{label}: {len(line)} designs", content)
