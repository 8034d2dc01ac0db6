"""The page that compares two studies: one HTML file that loads nothing else and looks like a study's page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pipeline.report import data
from pipeline.report.champion_figures import DASHES, draw_curve
from pipeline.report.data import Measure, TrialResult, arm, trial_mean
from pipeline.report.drawing import INK, Missing, NothingToDraw, finish, legend, panel_grid, show_at_least
from pipeline.report.moving import document
from pipeline.report.page import inline_svg
from pipeline.report.page_tables import count_verdicts, typeset, verdict_mark
from pipeline.report.transfer_table import members_line
from pipeline.report.wording import NONE, absent, interval, number, p_value, table
from pipeline.text import escape
from tasks.analysis.equivalence import MOST_TRIALS
from tasks.analysis.paper import NEGLIGIBLE_WORDS
from tasks.analysis.scores import QUANTITY_WORDS
from tasks.analysis.study_differences import StudyDifference
from tasks.evolution import OBJECTIVES, PAPERS_OBJECTIVE, ObjectiveName
from tasks.world import ENVIRONMENTS, EnvironmentName

_POLICY = "script-src 'none'; img-src data:"
_CSS = """
h1, header dd, #settings td { overflow-wrap: anywhere; }
header dl { margin: 0; display: flex; flex-wrap: wrap; gap: 0.5rem 3rem; }
header dt { font-weight: 650; } header dd { margin: 0; }
#settings th, #settings td { text-align: left; } #settings td:first-child { width: 45%; }
#curves svg { margin: 0 auto; }
.tests td small { white-space: nowrap; } .tests td:last-child small { white-space: normal; }
.tests td:last-child { min-width: 9rem; } .scroll:has(> .tests) { max-height: none; }
#tests > p { max-width: 44rem; }
@media (max-width: 760px) { .tests td { text-align: left; } }
"""


@dataclass(frozen=True, eq=False)
class ComparedStudy:
    """One of the two studies."""

    name: str
    store: str  # path of its store; "" where both are in one
    trials: Sequence[TrialResult]
    objective: ObjectiveName = PAPERS_OBJECTIVE
    selected_for: str = "displacement"  # the objective, in words


@dataclass(frozen=True, eq=False)
class StudyPair:
    """Two studies, and how they differ."""

    a: ComparedStudy
    b: ComparedStudy  # the reference
    changes: Sequence[tuple[str, str, str]]  # settings that differ: name, value in A, value in B
    differences: Sequence[StudyDifference]
    made_with: Mapping[str, str]  # version by package, of what compared them

    @property
    def studies(self) -> tuple[tuple[str, ComparedStudy], ...]:
        """Both studies with their letters."""
        return ("A", self.a), ("B", self.b)


NOTE = (
    "A − B is the difference of the means; a positive one means that A’s robots go farther. Its 95 % interval and the "
    "p-values are those of Welch’s test, two-sided, which does not assume equal variances. If a study has several "
    "replicates of its throws and networks, they include the variance between these. Below a p-value is the one "
    "after Holm’s correction over all tests of this page. Hedges’ g is the difference in pooled standard deviations, "
    "with its 95 % interval. A difference is negligible (“agrees”) if its whole 95 % interval lies within "
    f"{NEGLIGIBLE_WORDS} of the displacement of B’s designs evolved in True Slush at that depth, or of B’s mean of the "
    "same arm if there are none. It “differs” if the interval lies outside. Otherwise there are too few trials to "
    "tell, and each study would need the number that is given. A large p-value alone shows nothing. Each verdict is of "
    "its row alone, without a correction for the number of rows."
)
"""How the table of tests is to be read."""

INDEPENDENCE = (
    "The two groups count as independent. With the same seed, trials of the same number start from the same random "
    "numbers and part only where a setting matters; that makes the groups more alike, and the tests cautious. A group "
    "of trials that are the same in both studies is not tested. All trials in Residual Slush share the data set and "
    "the ensemble of their replicate. In a study with one replicate, n there measures the spread of evolution only."
)
"""What the tests assume."""


def render_pair(pair: StudyPair) -> str:
    """Write the page."""
    title = f"{pair.a.name} against {pair.b.name}"
    sections = [
        ("settings", "Settings that differ", _settings(pair)),
        ("evolution", "Fitness by generation", _figure(pair)),
        ("transfer", "Transfer to True Slush", _transfer(pair)),
        ("tests", "Differences", _tests(pair)),
    ]
    contents = "".join(f' <a href="#{name}">{escape(words)}</a>' for name, words, _ in sections)
    body = "\n".join(
        f'<section id="{name}">\n<h2>{words}</h2>\n{content}\n</section>' for name, words, content in sections
    )
    made = ", ".join(f"{name} {version}" for name, version in pair.made_with.items())
    page = (
        f'<main><header id="top"><p class="study">puddle · two studies compared</p><h1>{escape(title)}</h1>'
        f'<p class="finding">{headline(pair)}.</p>{_key(pair)}</header>'
        f'<nav aria-label="Contents"><b>Contents</b>{contents}</nav>{body}'
        f'<p class="small">Made with {escape(made)}.</p></main>'
    )
    return document(title=escape(title), policy=_POLICY, body=page, css=_CSS)


def headline(pair: StudyPair) -> str:
    """Count the comparisons by their verdicts, in words."""
    n = len(pair.differences)
    counts = count_verdicts(row.judgement.verdict for row in pair.differences)
    return f"{n} comparison{'' if n == 1 else 's'} of A with B: {counts}"


def _key(pair: StudyPair) -> str:
    rows = "".join(
        f"<div><dt>{letter}: {escape(study.name)}</dt><dd>{_whereabouts(study)}</dd></div>"
        for letter, study in pair.studies
    )
    return f"<dl>{rows}</dl>"


def _whereabouts(study: ComparedStudy) -> str:
    """Say how many champions a study has, and where it is if the other is elsewhere."""
    where = f", in {escape(study.store)}" if study.store else ""
    return f"{len(study.trials)} champions{where}"


def _settings(pair: StudyPair) -> str:
    rows = [
        [f"<code>{escape(name).replace('.', '.<wbr>')}</code>", escape(of_a), escape(of_b)]
        for name, of_a, of_b in pair.changes
    ]
    return table(("Setting", "A", "B"), rows, "Settings that differ", kind="plain")


# -- fitness by generation -------------------------------------------------------------------------------------------


def _figure(pair: StudyPair) -> str:
    narrow, wide = (
        finish(f"curves-{name}", "Fitness by generation", partial(_curves, pair, n_columns))
        for name, n_columns in (("narrow", 2), ("wide", 5))
    )
    if isinstance(narrow, Missing) or isinstance(wide, Missing):
        return absent("The figure", narrow.reason if isinstance(narrow, Missing) else "")
    content = f'<div class="narrow">{inline_svg(narrow)}</div><div class="wide">{inline_svg(wide)}</div>'
    return f'<figure id="curves">{content}<figcaption>{escape(narrow.description)}</figcaption></figure>'


def _curves(pair: StudyPair, n_columns: int) -> tuple[Figure, str]:
    """Draw a panel for each arm of the greatest common depth."""
    evolved = [[trial for trial in study.trials if np.isfinite(trial.curve).any()] for _, study in pair.studies]
    common = {(trial.environment, trial.depth) for trial in evolved[0]} & {
        (trial.environment, trial.depth) for trial in evolved[1]
    }
    if not common:
        raise NothingToDraw("no arm has fitness curves in both studies")
    depth = max(depth for _, depth in common)
    arms: list[EnvironmentName] = [name for name in ENVIRONMENTS if (name, depth) in common]
    figure, panels = panel_grid(len(arms), n_columns, row_height=2.9 if len(arms) == 1 else 2.1, share_y=False)
    n_of = []
    for panel, environment in zip(panels, arms, strict=True):
        groups = [arm(study_trials, environment, depth) for study_trials in evolved]
        for trials, dashed in zip(groups, (False, True), strict=True):
            draw_curve(panel, trials, ENVIRONMENTS[environment].color, dashed=dashed)
        panel.set_title(ENVIRONMENTS[environment].label)
        panel.grid()
        show_at_least(panel)
        n_of.append(f"{ENVIRONMENTS[environment].label} {len(groups[0])} and {len(groups[1])}")
    panels[0].xaxis.set_major_locator(MaxNLocator(4, integer=True))
    figure.supxlabel("generation")
    units = dict.fromkeys(OBJECTIVES[study.objective].unit for _, study in pair.studies)
    figure.supylabel(f"best fitness [{' and '.join(units)}]")
    handles = [
        Line2D([], [], color=INK, ls=style, label=f"{letter}: {_shortened(study.name)}")
        for (letter, study), style in zip(pair.studies, ("-", DASHES), strict=True)
    ]
    legend(figure, handles, n_columns=1 if n_columns == 2 else 2, above=True)
    return figure, (
        f"Best fitness so far by generation at {depth:g} m, in the environment where the robots evolve: A solid, B "
        f"dashed. Lines are means over trials, bands ± 1 SD. Trials of A and B (n): {'; '.join(n_of)}.{_caution(pair)}"
    )


def _caution(pair: StudyPair) -> str:
    """Warn where the fitness of A and B is not the same quantity."""
    of_a, of_b = (study.selected_for for _, study in pair.studies)
    if of_a != of_b:
        return f" A’s fitness is {of_a}, B’s is {of_b}: their curves can’t be compared."
    if not any(name == "ensemble.disagreement_penalty" for name, _, _ in pair.changes):
        return ""
    return " In an ensemble fitness is μ − kσ, and k differs between A and B: there their curves can’t be compared."


def _shortened(name: str) -> str:
    return name if len(name) <= 28 else f"{name[:27]}…"


# -- transfer --------------------------------------------------------------------------------------------------------


def _transfer(pair: StudyPair) -> str:
    """Tabulate both studies by depth, the greatest first; arms that only one of them has are there too."""
    of_both = [*pair.a.trials, *pair.b.trials]
    columns = ("Evolved in", "Predicted [m]", "Zero-shot [m]", "Adapted [m]")
    tables = [
        f"<h3>Depth {depth:g} m</h3>"
        + table(columns, _transfer_rows(pair, depth), f"Transfer of A and B at {depth:g} m", kind="named")
        for depth in sorted(data.depths(of_both), reverse=True)
    ]
    note = (
        "Displacement of the root link: mean over n trials ± 1 SD. Predicted is where the champion evolved (for an "
        "ensemble, the mean μ over its members, and below it their standard deviation σ and what evolution maximised); "
        "zero-shot in True Slush; adapted in True Slush with a controller that evolved there."
    )
    return f'{"".join(tables)}<p class="small">{note}</p>'


def _transfer_rows(pair: StudyPair, depth: float) -> list[list[str]]:
    rows = []
    for environment, style in ENVIRONMENTS.items():
        for letter, study in pair.studies:
            trials = arm(study.trials, environment, depth)
            if trials:
                name = f"{_swatch(environment)} <i>{escape(style.symbol)}</i>, <b>{letter}</b>"
                head = f"{name}<small>n = {len(trials)}</small>"
                predicted, *others = (_spread(trials, quantity) for quantity in QUANTITY_WORDS)
                rows.append([head, predicted + members_line(trials, OBJECTIVES[study.objective]), *others])
    return rows


def _spread(trials: Sequence[TrialResult], measure: Measure) -> str:
    found = trial_mean(trials, measure)
    if found is None:
        return NONE
    n_known = f"<small>{len(found.values)} of {len(trials)} trials</small>" if len(found.values) < len(trials) else ""
    return _plus_minus(found.mean, found.sd) + n_known


def _plus_minus(mean: float | None, sd: float | None) -> str:
    return number(mean) if sd is None else f"{number(mean)} ± {number(sd)}"


# -- tests -----------------------------------------------------------------------------------------------------------


def _tests(pair: StudyPair) -> str:
    columns = ("Arm", "A and B [m]", "A − B [m]", "Hedges’ g", "Welch’s p", "Verdict")
    content = table(columns, map(_test_cells, pair.differences), "Differences between A and B", kind="tests")
    return f'<h3>{headline(pair)}</h3>{content}<p class="small">{NOTE}</p><p class="small">{INDEPENDENCE}</p>'


def _test_cells(row: StudyDifference) -> list[str]:
    sides = "<br>".join(_plus_minus(side.mean.value, side.sd) for side in (row.a, row.b))
    holm = "" if row.clustered_holm is None else f"<small>Holm {escape(p_value(row.clustered_holm))}</small>"
    replicated = max(row.a.n_replicates, row.b.n_replicates) > 1
    n_replicates = f"<small>in {row.a.n_replicates}, {row.b.n_replicates} replicates</small>" if replicated else ""
    arm_name = f"{_swatch(row.evolved_in)}, {QUANTITY_WORDS[row.quantity]}"
    return [
        f"{arm_name}<small>{row.depth:g}\u00a0m</small>",
        f"{sides}<small>n\u00a0=\u00a0{row.a.n}, {row.b.n}</small>{n_replicates}",
        interval(replace(row.difference, reason=None)),  # the verdict's cell gives it
        interval(replace(row.hedges_g, reason=None), "{:.2f}"),
        escape(p_value(row.clustered.p)) + holm,
        f"{verdict_mark(row.judgement.verdict)}<small>{typeset(_why(row))}</small>",
    ]


def _why(row: StudyDifference) -> str:
    judged = row.judgement
    if judged.verdict == "not comparable":
        return judged.why
    place = {"agrees": "within", "differs": "outside"}.get(judged.verdict, "across")
    needs = "" if judged.n_needed is None else f"; needs {_n_trials(judged.n_needed)} trials"
    return f"{place} ± {row.bound:.2f} m{needs}"


def _n_trials(n: float) -> str:
    return f"more than {MOST_TRIALS:,}" if n > MOST_TRIALS else f"about {n:g}"


def _swatch(environment: EnvironmentName) -> str:
    return f'<span class="swatch {environment}"></span>{escape(ENVIRONMENTS[environment].label)}'
