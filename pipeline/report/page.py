"""The page of a study: one HTML file that loads nothing else, for desktop and phone.

Text lives in page.html and viewer.html, which loop over the tables that tasks/analysis/tables registers and the figures
that are registered beside this module. Every value that comes from a study is escaped.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import yaml
from markupsafe import Markup

from pipeline.report import network_figures, transfer_figures  # noqa: F401 (they register their figures)
from pipeline.report.document import TEMPLATES, document
from pipeline.report.drawing import Drawing, NothingToDraw, finish
from pipeline.report.palette import arms_css
from pipeline.report.render import as_html, typeset
from pipeline.report.replay import Replay, encode
from pipeline.report.study_page import FIGURES, StudyPage, scale_words
from tasks.analysis.columns import OfTrial, percent, scored_by
from tasks.analysis.registry import Analysis
from tasks.analysis.tables import ANALYSES
from tasks.residual import arm_kind

_POLICY = "script-src 'unsafe-inline'; img-src data:"  # nothing is loaded from elsewhere


def draw_all(page: StudyPage) -> dict[str, Drawing]:
    """Draw the figures for which a study has data, by name."""
    drawings = {}
    for name, figure in FIGURES.items():
        with suppress(NothingToDraw):
            drawings[name] = finish(name, figure.title, partial(figure.drawn, page))
    return drawings


def render_page(page: StudyPage, drawings: Mapping[str, Drawing]) -> str:
    """Write the page of a study."""
    settings, learners = page.settings, page.settings.arm_learners
    objective = settings.evolution.maximised
    tested = [row for row in page.rows("transfer") if row.zero_shot.value is not None]
    depth = max((row.depth for row in tested), default=None)
    robots = {replay.robot for replay in page.replays}

    def address(row: Any) -> str:  # of a row's robot on the page, if it is there
        name = robot_address(*row.key) if isinstance(row, OfTrial) else ""
        return name if name in robots else ""

    def html(analysis: Analysis, rows: Sequence[Any], depth: float | None) -> Markup:
        without = ("depth",) if depth is not None else ()
        kind = scored_by(objective, analysis.row)
        return as_html(kind, rows, analysis.answers, address=address, without=without, learners=learners)

    title = f"Robots evolved for {page.target}: {settings.name}"
    body = TEMPLATES.get_template("page.html").render(
        page=page,
        title=title,
        settings=settings,
        scale=scale_words(settings),
        depth=depth,
        deepest=[row for row in tested if row.depth == depth],
        singles={name for name, learner in learners.items() if learner.is_single},
        kind_of=partial(arm_kind, learners=learners),
        arms=[arm_kind(name, learners) for name in dict.fromkeys(name for name, _, _ in settings.trials())],
        objective=None if objective.is_papers else objective.with_unit(settings.selected_for),
        score=objective.label.lower(),
        unit=objective.unit,
        seconds=settings.rollout.n_measure * settings.physics.time_step,
        heroes=heroes(page.replays),
        tables=[(analysis, page.rows(name)) for name, analysis in ANALYSES.items() if page.rows(name)],
        figures=[(FIGURES[name].section, drawing) for name, drawing in drawings.items()],
        settings_yaml=yaml.safe_dump(settings.model_dump(mode="json", exclude={"work"}), sort_keys=False),
        shown=_shown,
        html=html,
        percent=lambda share: typeset(percent(share)),
        number=lambda value: typeset(f"{value:z.{1 if objective.is_papers else 2}f}"),
        **viewer_values(page.replays, settings.name),
    )
    return document(title=title, policy=_POLICY, body=body, css=arms_css(page.looks))


def _shown(analysis: Analysis, rows: Sequence[Any]) -> list[tuple[float | None, list[Any]]]:
    """Group the rows that the page shows by depth, the greatest first; without depths they are one group."""
    groups: dict[float | None, list[Any]] = {}
    for row in filter(analysis.shown, rows):
        groups.setdefault(getattr(row, "depth", None) if analysis.by_depth else None, []).append(row)
    return sorted(groups.items(), key=lambda group: -(group[0] or 0.0))


def robot_address(environment: str, depth: float, trial: int) -> str:
    """Return the address of a champion on the page, which is the name of its design file, too."""
    return f"robot-{environment}-{depth:g}m-trial-{trial}".replace(".", "_")  # file names hold a single dot


def heroes(replays: Sequence[Replay]) -> list[tuple[int, Replay]]:
    """Return the two robots that stand for the study, with their numbers among the replays.

    They are filmed in the target at the greatest depth: the best robot of the best arm that has never been there, and
    that of dry land. A study without these arms is represented by its best robots.
    """
    filmed = [(number, replay) for number, replay in enumerate(replays) if replay.best and replay.in_target]
    deepest = max((replay.depth for _, replay in filmed), default=None)
    ranked = sorted((hero for hero in filmed if hero[1].depth == deepest), key=lambda hero: -hero[1].arm_mean)
    learned = [hero for hero in ranked if hero[1].environment not in (hero[1].command, "dry_land")]
    on_land = [hero for hero in ranked if hero[1].environment == "dry_land"]
    return [*learned[:1], *on_land] or ranked[:2]


def viewer_values(replays: Sequence[Replay], study: str) -> dict[str, Any]:
    """Return what viewer.html needs: the robots in their groups, the colours, and the data for the scripts."""
    groups: dict[str, list[tuple[int, Replay]]] = {}
    for number, replay in enumerate(replays):
        groups.setdefault(replay.group or f"Depth {replay.depth:g} m", []).append((number, replay))
    return {
        "study": study,
        "replays": replays,
        "groups": groups,
        "opened": next((number for number, _ in heroes(replays)), 0),
        "has_colours": any(replay.disagreement is not None for replay in replays),
        "encoded": [encode(replay) for replay in replays],
    }


def render_robot(replay: Replay, lines: Sequence[str], beside: Sequence[Replay] = ()) -> str:
    """Write a page with one robot in the viewer, below some lines of text, and with the same robot elsewhere."""
    values = viewer_values([replay, *beside], "")
    body = TEMPLATES.get_template("robot.html").render(replay=replay, lines=lines, **values)
    return document(title=replay.title, policy=_POLICY, body=body)
