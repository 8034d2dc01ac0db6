"""The page of a study: one HTML file that needs nothing else, for a desk or a phone, by day or by night.

The words that stay are in page.html, the looks in page.css, the replay viewer in viewer.js; here is what depends on the
study. Every text that comes from the study is escaped.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from itertools import groupby
from string import Template

from pipeline.report.data import (
    ENVIRONMENTS,
    PAPER,
    PAPER_DEPTH,
    PAPER_TRUE_SLUSH,
    EnvironmentName,
    Estimate,
    Quantity,
    StudyReport,
    TrialResult,
    arm,
    deepest_scored,
    depths,
    environments,
    estimate,
    ratio,
)
from pipeline.report.figures import FAINT, INK, PAPER_MARK, Drawing, Missing, draw_all
from pipeline.report.replay import Replay, encode

LARGEST = 1.5
"""Pixels for a unit of a figure, at most: its letters then have the size of a heading's."""

NONE = "–"
"""Stands where there is no number."""


def render_page(report: StudyReport, drawings: Mapping[str, Drawing | Missing] | None = None) -> str:
    """Write the page of a study.

    Args:
        report: the study, or as much of it as there is.
        drawings: what ``draw_all(report)`` gave, where the caller has it already; drawn here otherwise.
    """
    drawn = draw_all(report) if drawings is None else drawings
    pieces = {
        "title": escape(report.title),
        "name": escape(report.name),
        "css": _resource("page.css"),
        "finding": _finding(report.trials),
        "set_aside": _set_aside(report.set_aside),
        "viewer": _viewer(report.replays),
        "transfer_table": _transfer_table(report.trials),
        "fitness_curves": _fitness_curves(drawn),
        "made": _made(report),
        "script": _script(report.replays),
        **{
            name: _figure(drawn[name]) for name in ("transfer_at_depth", "transfer_across_depths", "residual_error")
        },
    }
    return Template(_resource("page.html")).substitute(pieces)


def _resource(name: str) -> str:
    return files("pipeline.report").joinpath(name).read_text(encoding="utf-8")


# -- words ------------------------------------------------------------------------------------------------------------


def _finding(trials: Sequence[TrialResult]) -> str:
    """Say in a sentence how designs transferred at the deepest depth, as far as there is something to say."""
    if not trials:
        return '<p class="finding">No trial has finished yet; this page fills as the study goes on.</p>'
    depth = deepest_scored(trials)
    if depth is None:
        return '<p class="finding">Robots have evolved, but none has been in True Slush yet.</p>'
    scored: dict[EnvironmentName, Estimate] = {
        environment: found
        for environment in environments(trials)
        if (found := estimate(arm(trials, environment, depth), "zero_shot"))
    }
    best = scored.get("true_slush")
    parts = []
    for environment, found in scored.items():
        share = ratio(found, best) if environment != "true_slush" else None
        of_best = "" if share is None else f" ({_percent(share)})"
        evolved = escape(ENVIRONMENTS[environment].evolved)
        parts.append(f"<b>{_number(found.mean)}\u00a0m</b>{of_best} if they evolved {evolved}")
    return (
        f'<p class="finding">In {depth:g} m of True Slush, champions put there as they were moved on average '
        f"{', '.join(parts)}.</p>"
    )


def _set_aside(names: Sequence[str]) -> str:
    if not names:
        return ""
    listed = "".join(f"<li>{escape(name)}</li>" for name in names)
    return (
        f'<div class="notice"><b>Not everything ran.</b> These failed twice and were set aside; what is below does '
        f"without them.<ul>{listed}</ul></div>"
    )


def _number(value: float) -> str:
    """Write a number to one decimal, with a true minus and no negative zero."""
    return f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


def _percent(share: float) -> str:
    return f"{round(100 * share)}\u00a0%".replace("-", "−")


def _absent(title: str, reason: str) -> str:
    return f'<p class="absent"><b>{escape(title)}</b> is not here: {escape(reason)}.</p>'


# -- figures ----------------------------------------------------------------------------------------------------------


def _figure(drawing: Drawing | Missing) -> str:
    if isinstance(drawing, Missing):
        return _absent(drawing.title, drawing.reason)
    caption = f"<figcaption>{escape(drawing.description)}</figcaption>"
    return f"<figure><h3>{escape(drawing.title)}</h3>{inline_svg(drawing)}{caption}</figure>"


def _fitness_curves(drawn: Mapping[str, Drawing | Missing]) -> str:
    """Choose between two layouts of the same panels by the page's width."""
    narrow, wide = drawn["fitness_curves"], drawn["fitness_curves_wide"]
    if isinstance(narrow, Missing) or isinstance(wide, Missing):
        return _figure(narrow)
    caption = f"<figcaption>{escape(narrow.description)}</figcaption>"
    return (
        f'<figure><h3>{escape(narrow.title)}</h3><div class="narrow">{inline_svg(narrow)}</div>'
        f'<div class="wide">{inline_svg(wide)}</div>{caption}</figure>'
    )


def inline_svg(drawing: Drawing) -> str:
    """Make a figure's SVG a part of the page: identifiers of its own, colours that follow the page's."""
    svg = drawing.svg.decode("utf-8")
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg)
    for attribute in ("width", "height"):  # the viewBox keeps the proportions, the page gives the size up to a limit
        svg = re.sub(rf'(<svg[^>]*?) {attribute}="[^"]*"', r"\1", svg, count=1)
    width = float(re.search(r'viewBox="0 0 ([\d.]+) ', svg)[1])  # type: ignore[index]  # matplotlib always writes it
    svg = svg.replace("<svg", f'<svg style="max-width: {LARGEST * width:.0f}px"', 1)
    svg = re.sub(r'\bid="', f'id="{drawing.name}-', svg)
    svg = re.sub(r'((?:xlink:)?href="#|url\(#)', rf"\g<1>{drawing.name}-", svg)
    for hexadecimal, variable in _PAGE_COLORS.items():
        svg = re.sub(hexadecimal, f"var({variable})", svg, flags=re.IGNORECASE)
    return svg.replace("<svg", f'<svg role="img" aria-label="{escape(drawing.description)}"', 1).strip()


_PAGE_COLORS = {
    INK: "--ink",
    FAINT: "--faint",
    PAPER_MARK: "--mark",
    **{style.color: f"--{name.replace('_', '-')}" for name, style in ENVIRONMENTS.items()},
    **{style.adapted_color: f"--{name.replace('_', '-')}-adapted" for name, style in ENVIRONMENTS.items()},
}


# -- the transfer table -----------------------------------------------------------------------------------------------


def _transfer_table(trials: Sequence[TrialResult]) -> str:
    if not trials:
        return _absent("The transfer table", "no trial has finished yet")
    bodies = "".join(_depth_rows(trials, depth) for depth in depths(trials))
    note = (
        "Means over n trials ± 1 SD [m]. The first line is the displacement of the root link; CoM is that of the whole "
        "robot’s centre of mass, which a root at the end of a swinging chain cannot fool. “of <i>E</i>” compares means "
        "with that of the designs evolved in True Slush at the same depth."
    )
    if PAPER_DEPTH in depths(trials):
        note += (
            f" “paper” is the mean over 10 trials that it states at {PAPER_DEPTH:g}\u00a0m; for Residual Slush it "
            f"states shares of {PAPER_TRUE_SLUSH:g}\u00a0m."
        )
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="Transfer by depth and environment">'
        '<table class="transfer"><thead><tr>'
        "<th>Evolved in</th><th>Predicted<br>where it evolved</th><th>Zero-shot<br>in True Slush</th>"
        "<th>of <i>E</i></th><th>Adapted<br>in True Slush</th><th>of <i>E</i></th></tr></thead>"
        f'{bodies}</table></div><p class="small">{note}</p>'
    )


def _depth_rows(trials: Sequence[TrialResult], depth: float) -> str:
    best = estimate(arm(trials, "true_slush", depth), "zero_shot")
    rows = []
    for environment, style in ENVIRONMENTS.items():
        chosen = arm(trials, environment, depth)
        if not chosen:
            continue
        cells = [
            f'<td><span class="swatch {environment}"></span>{escape(style.label)} <i>{escape(style.symbol)}</i>'
            f"<small>n = {len(chosen)}</small></td>",
            _cell(chosen, "predicted", None, _paper(environment, "predicted", depth)),
            _cell(chosen, "zero_shot", "zero_shot_com", _paper(environment, "zero_shot", depth)),
            _share(chosen, "zero_shot", best, _paper(environment, "zero_shot", depth)),
            _cell(chosen, "adapted", "adapted_com", _paper(environment, "adapted", depth)),
            _share(chosen, "adapted", best, _paper(environment, "adapted", depth)),
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    heading = f'<tr><th colspan="6" scope="rowgroup"><span>Depth {depth:g} m</span></th></tr>'
    return f"<tbody>{heading}{''.join(rows)}</tbody>"


def _paper(environment: EnvironmentName, quantity: Quantity, depth: float) -> float | None:
    return PAPER.get((environment, quantity)) if depth == PAPER_DEPTH else None


def _cell(
    trials: Sequence[TrialResult], quantity: Quantity, com_quantity: Quantity | None, paper: float | None
) -> str:
    found = estimate(trials, quantity)
    com = estimate(trials, com_quantity) if com_quantity else None
    lines = _spread(found)
    if found is not None and found.n < len(trials):
        lines += f"<small>{found.n} of {len(trials)} trials</small>"
    if com is not None:
        lines += f"<small>CoM {_spread(com)}</small>"
    if paper is not None:
        lines += f'<small class="paper">paper {_number(paper)}</small>'
    return f"<td>{lines}</td>"


def _share(trials: Sequence[TrialResult], quantity: Quantity, best: Estimate | None, paper: float | None) -> str:
    share = ratio(estimate(trials, quantity), best)
    lines = NONE if share is None else _percent(share)
    if paper is not None:
        lines += f'<small class="paper">paper {_percent(paper / PAPER_TRUE_SLUSH)}</small>'
    return f"<td>{lines}</td>"


def _spread(found: Estimate | None) -> str:
    if found is None:
        return NONE
    return _number(found.mean) + (f" ± {_number(found.sd)}" if found.sd is not None else "")


# -- the viewer -------------------------------------------------------------------------------------------------------


def _viewer(replays: Sequence[Replay]) -> str:
    if not replays:
        return _absent("The replay viewer", "no champion’s motion has been kept yet")
    numbered = sorted(enumerate(replays), key=lambda item: item[1].depth)
    # The first thing to see is what the study is about: a robot evolved with residuals, where they matter most.
    chosen, _ = max(numbered, key=lambda item: (item[1].environment == "residual_slush", item[1].depth))
    groups = "".join(
        f'<optgroup label="Depth {depth:g} m">{_choices(group, chosen)}</optgroup>'
        for depth, group in groupby(numbered, key=lambda item: item[1].depth)
    )
    return f"""<div class="viewer">
<div class="bar"><label class="grow">Robot <select id="choice">{groups}</select></label></div>
<canvas id="stage" role="img" aria-label="A robot moving in its world"></canvas>
<div class="bar below"><button id="play" type="button">Play</button>
<input id="scrub" type="range" min="0" max="1" step="0.01" value="0" aria-label="Time">
<output id="time" for="scrub"></output></div>
<div class="bar below"><label>Speed <select id="speed"><option value="0.25">¼ ×</option><option value="0.5">½ ×</option>
<option value="1" selected>1 ×</option><option value="2">2 ×</option><option value="4">4 ×</option></select></label>
<label><input id="follow" type="checkbox" checked> Follow the robot</label></div>
</div>
<p class="small">The root link, whose way is measured, is darker and bears a black dot; joints are white dots. The
number is how far the root has come since the clock started, once the robot had settled.</p>"""


def _choices(numbered: Iterable[tuple[int, Replay]], chosen: int) -> str:
    return "".join(
        f'<option value="{index}"{" selected" if index == chosen else ""}>{escape(replay.title)}</option>'
        for index, replay in numbered
    )


def _script(replays: Sequence[Replay]) -> str:
    if not replays:
        return ""
    # "<" is written as an escape, so that no title can close the element.
    data = json.dumps([encode(replay) for replay in replays], separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<script type="application/json" id="replays">{data}</script>\n<script>\n{_resource("viewer.js")}</script>'
    )


# -- how it was made --------------------------------------------------------------------------------------------------


def _made(report: StudyReport) -> str:
    seconds = [(stage, _duration(time)) for stage, time in report.seconds.items()]
    digests = [(f"{digest.stage} · {digest.label}", digest.sha256) for digest in report.digests]
    settings = f"<pre><code>{escape(report.settings_yaml)}</code></pre>" if report.settings_yaml else ""
    return "".join(
        f"<details{' open' if opened else ''}><summary>{title}</summary>{content}</details>"
        for title, content, opened in (
            ("Time by stage", _plain_table(seconds), True),
            ("Made with", _plain_table(report.created_with.items()), False),
            ("Settings", settings, False),
            (f"SHA-256 of {len(digests)} artifacts", _plain_table(digests), False),
        )
        if content
    )


def _plain_table(rows: Iterable[tuple[str, str]]) -> str:
    body = "".join(f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in rows)
    return f'<div class="scroll"><table class="plain"><tbody>{body}</tbody></table></div>' if body else ""


def _duration(seconds: float) -> str:
    """Write a time as people say it: 9.4 s, 3 min 20 s, 2 h 05 min."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min"
