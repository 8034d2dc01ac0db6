"""The page of a study: one HTML file that loads nothing else, for desktop and phone.

Text lives in page.html and viewer.html, which loop over the tables that tasks/analysis/tables registers and the figures
below. Every value that comes from a study is escaped.
"""

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import yaml
from markupsafe import Markup
from matplotlib.figure import Figure

from pipeline.config.settings import Settings
from pipeline.report import network_figures, transfer_figures
from pipeline.report.document import TEMPLATES, document, inline_svg, resource
from pipeline.report.drawing import Drawing, finish
from pipeline.report.network_figures import ThrowPaths
from pipeline.report.palette import Look, arms_css, looks_of
from pipeline.report.render import as_html, typeset
from pipeline.report.replay import Replay, encode
from pipeline.report.transfer_figures import Curves
from tasks.analysis import paper
from tasks.analysis.columns import percent, scored_by
from tasks.analysis.registry import Analysis
from tasks.analysis.study import Assessed
from tasks.analysis.tables import ANALYSES
from tasks.residual import arm_kind

_POLICY = "script-src 'unsafe-inline'; img-src data:"  # nothing is loaded from elsewhere
_SCRIPTS = ("robot.js", "viewer.js", "gallery.js")


@dataclass(frozen=True, eq=False)
class StudyPage:
    """A study, or as much of it as is done. Nothing is required: a study that has only begun has a page, too."""

    settings: Settings
    tables: Mapping[str, Sequence[Any]] = field(default_factory=dict)  # rows by name of the analysis
    curves: Curves = field(default_factory=dict)
    assessed: Mapping[str, Assessed] = field(default_factory=dict)  # by group of throws, the main one first
    throws: ThrowPaths | None = None  # of the main data set
    replays: Sequence[Replay] = ()
    rejected: Mapping[str, float] = field(default_factory=dict)  # share of drawn designs, by operator
    created_with: Mapping[str, str] = field(default_factory=dict)  # version by package
    digests: Sequence[tuple[str, str, str]] = ()  # stage, label and SHA-256 of every chain that is done
    failed: Sequence[str] = ()  # work items that failed, with their errors
    not_possible: Sequence[str] = ()  # work items that were not tried because an input failed
    diverged: Sequence[str] = ()  # trials with designs that diverged, and how many

    @property
    def looks(self) -> dict[str, Look]:
        """How the arms are drawn."""
        arms = (environment for environment, _, _ in self.settings.trials())
        return looks_of(arms, self.settings.target, self.settings.arm_learners)

    @property
    def target(self) -> str:
        """Where champions are transferred to, as readers know it."""
        return self.settings.target_label

    @property
    def score_label(self) -> str:
        """Label of an axis of scores in the target."""
        objective = self.settings.evolution.maximised
        return objective.with_unit(f"{objective.label.lower()} in {self.target}")

    def rows(self, name: str) -> Sequence[Any]:
        """Return the rows of an analysis."""
        return self.tables.get(name, ())


@dataclass(frozen=True)
class PageFigure:
    """A figure of the page."""

    title: str
    section: str
    caption: str
    draw: Callable[[StudyPage], Figure]


FIGURES: Mapping[str, PageFigure] = {
    "transfer_at_depth": PageFigure(
        "Transfer at the greatest depth",
        "top",
        "{score} in {target}, zero-shot and with controllers adapted to it: means over trials ± 1 SD, and single "
        "trials as points.",
        lambda page: transfer_figures.transfer_at_depth(
            page.rows("transfer"), page.rows("scores"), page.looks, page.score_label
        ),
    ),
    "transfer_across_depths": PageFigure(
        "Transfer across depths",
        "transfer",
        "{score} in {target} by depth, zero-shot and with controllers adapted to it: means over trials ± 1 SD.",
        lambda page: transfer_figures.transfer_across_depths(page.rows("transfer"), page.looks, page.score_label),
    ),
    "fitness_curves": PageFigure(
        "Fitness by generation",
        "evolution",
        "Best fitness so far in the environment where the robots evolve: means over trials, bands of ± 1 SD.",
        lambda page: transfer_figures.fitness_curves(
            page.curves, page.settings.evolution.maximised.with_unit("best fitness"), page.looks
        ),
    ),
    "elites": PageFigure(
        "The fittest robot of each kind of body",
        "evolution",
        "Fitness of the best robot of each cell over all trials at the greatest depth, in the environment where the "
        "robots evolve. Cells at the edge hold what lies beyond. The viewer plays those of the target, under "
        "Elites; the table elites.csv names every robot.",
        lambda page: transfer_figures.elites(page.rows("elites"), page.settings.evolution, page.looks),
    ),
    "prediction_accuracy": PageFigure(
        "Prediction accuracy",
        "networks",
        "Displacement in {target} against the ensemble’s mean prediction, for designs of whole runs. Darker cells "
        "hold more of them. A slope m below 1 means that the networks overestimate how far robots get; the dotted line "
        "is for μ − σ.",
        lambda page: network_figures.prediction_accuracy(
            page.assessed, page.rows("regressions"), page.target, page.settings.arm_learners
        ),
    ),
    "data_set": PageFigure(
        "The throws",
        "networks",
        "Paths of the thrown links, by size. The blue line is the surface. Of one throw, the link is drawn.",
        lambda page: network_figures.data_set(page.throws),
    ),
}


def draw_all(page: StudyPage) -> dict[str, Drawing]:
    """Draw the figures for which a study has data, by name."""
    made = {name: finish(name, one.title, partial(_drawn, one, page)) for name, one in FIGURES.items()}
    return {name: drawing for name, drawing in made.items() if isinstance(drawing, Drawing)}


def _drawn(one: PageFigure, page: StudyPage) -> tuple[Figure, str]:
    return one.draw(page), one.caption.format(target=page.target, score=page.settings.evolution.maximised.label)


def render_page(page: StudyPage, drawings: Mapping[str, Drawing]) -> str:
    """Write the page of a study."""
    settings = page.settings
    objective = settings.evolution.maximised
    depth = max((row.depth for row in page.rows("transfer") if row.zero_shot.value is not None), default=None)
    known, learners = {replay.robot for replay in page.replays}, settings.arm_learners

    def html(one: Analysis, rows: Sequence[Any], depth: float | None) -> Markup:
        without = ("depth",) if depth is not None else ()
        kind, address = scored_by(objective, one.row), partial(_address, known)
        return as_html(kind, rows, one.answers, address=address, without=without, learners=learners)

    body = TEMPLATES.get_template("page.html").render(
        page=page,
        settings=settings,
        scale=scale_words(settings),
        depth=depth,
        deepest=[row for row in page.rows("transfer") if row.depth == depth and row.zero_shot.value is not None],
        singles={name for name, learner in learners.items() if learner.is_single},
        kind_of=partial(arm_kind, learners=learners),
        arms=[arm_kind(name, learners) for name in dict.fromkeys(name for name, _, _ in settings.trials())],
        objective=None if objective.is_papers else objective.with_unit(settings.selected_for),
        score=objective.label.lower(),
        unit=objective.unit,
        seconds=settings.rollout.n_measure * settings.physics.time_step,
        heroes=heroes(page.replays),
        tables=[(one, page.rows(name)) for name, one in ANALYSES.items() if page.rows(name)],
        figures=[(one, drawings[name]) for name, one in FIGURES.items() if name in drawings],
        settings_yaml=yaml.safe_dump(settings.model_dump(mode="json", exclude={"work"}), sort_keys=False),
        shown=_shown,
        html=html,
        svg=inline_svg,
        percent=lambda share: typeset(percent(share)),
        number=lambda value: typeset(f"{value:z.{1 if objective.is_papers else 2}f}"),
        **viewer_values(page.replays, settings.name),
    )
    title = f"Robots evolved for {page.target}: {settings.name}"
    return document(title=title, policy=_POLICY, body=body, css=arms_css(page.looks))


def _shown(one: Analysis, rows: Sequence[Any]) -> list[tuple[float | None, list[Any]]]:
    """Group the rows that the page shows by depth, the greatest first; without depths they are one group."""
    chosen = [row for row in rows if one.shown(row)]
    groups: dict[float | None, list[Any]] = {}
    by_depth = one.name != "exploiters"  # which is ranked over all depths
    for row in chosen:
        groups.setdefault(getattr(row, "depth", None) if by_depth else None, []).append(row)
    return sorted(groups.items(), key=lambda group: -(group[0] or 0.0))


def _address(known: Collection[str], row: Any) -> str:
    """Return the address of a row's robot on the page, if it is there."""
    name = robot_address(row.environment, row.depth, row.trial) if hasattr(row, "trial") else ""
    return name if name in known else ""


def robot_address(environment: str, depth: float, trial: int) -> str:
    """Return the address of a champion on the page, which is the name of its design file, too."""
    return f"robot-{environment}-{depth:g}m-trial-{trial}".replace(".", "_")  # file names hold a single dot


def scale_words(settings: Settings) -> str:
    """Say how the study's scale of evolution compares with the paper's."""
    evaluated = settings.evolution.n_generations * settings.evolution.optimiser.population_size
    share = paper.N_EVALUATED / evaluated
    if share < 1.5 or not settings.has_papers_target:
        return ""
    advice = "compare shares, not metres" if share < 500 else "the figures mean nothing"
    return f"1/{share:,.0f} of the paper’s evolution: {advice}"


def heroes(replays: Sequence[Replay]) -> list[tuple[int, Replay]]:
    """Return the two robots that stand for the study, with their numbers among the replays.

    They are filmed in the target at the greatest depth: the best robot of the best arm that has never been there, and
    that of dry land. A study without these arms is represented by its best robots.
    """
    filmed = [(i, one) for i, one in enumerate(replays) if one.best and one.in_target]
    deepest = max((one.depth for _, one in filmed), default=None)
    ranked = sorted((pair for pair in filmed if pair[1].depth == deepest), key=lambda pair: -pair[1].arm_mean)
    learned = [pair for pair in ranked if pair[1].environment not in (pair[1].command, "dry_land")]
    on_land = [pair for pair in ranked if pair[1].environment == "dry_land"]
    return [*learned[:1], *on_land] or ranked[:2]


def viewer_values(replays: Sequence[Replay], study: str) -> dict[str, Any]:
    """Return what viewer.html needs: the robots in their groups, the colours, and the data for the scripts."""
    groups: dict[str, list[tuple[int, Replay]]] = {}
    for number, replay in enumerate(replays):
        groups.setdefault(replay.group or f"Depth {replay.depth:g} m", []).append((number, replay))
    opened = heroes(replays)[0][0] if heroes(replays) else 0
    # "<" is written as an escape, so that no title can close the element.
    data = json.dumps([encode(replay) for replay in replays], separators=(",", ":")).replace("<", "\\u003c")
    return {
        "study": study,
        "replays": replays,
        "groups": groups,
        "opened": opened,
        "has_colours": any(replay.disagreement is not None for replay in replays),
        "data": Markup(data),
        "scripts": Markup("\n".join(resource(name) for name in _SCRIPTS)),
    }


def render_robot(replay: Replay, lines: Sequence[str], beside: Sequence[Replay] = ()) -> str:
    """Write a page with one robot in the viewer, below some lines of text, and with the same robot elsewhere."""
    values = viewer_values([replay, *beside], "")
    body = TEMPLATES.get_template("robot.html").render(replay=replay, lines=lines, **values)
    return document(title=replay.title, policy=_POLICY, body=body)
