"""The page of a study: one HTML file that needs nothing else, for a desk or a phone, by day or by night.

The words that stay are in page.html, what any page begins with in document.html, the looks in page.css, the replay
viewer in viewer.js; here is what depends on the study. Every text that comes from the study is escaped.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from string import Template

from pipeline.config.settings import EnvironmentName
from pipeline.report.data import (
    ALL_DIVERGED,
    ENVIRONMENTS,
    Draws,
    Estimate,
    StudyReport,
    TrialResult,
    all_diverged,
    arm,
    deepest_scored,
    environments,
    estimate,
    ratio,
)
from pipeline.report.drawing import FAINT, INK, PAPER_MARK, Drawing, Missing
from pipeline.report.figures import draw_all
from pipeline.report.moving import document, gallery, resource, script, viewer
from pipeline.report.page_tables import against_paper, contrasts, lineage, retried, suspects, tank_tests
from pipeline.report.replay import Replay
from pipeline.report.transfer_table import transfer_table
from pipeline.report.wording import absent, number, percent

POLICY = "script-src 'unsafe-inline'; img-src data:"
"""Nothing from elsewhere."""

LARGEST = 1.5
"""Pixels for a unit of a figure, at most: its letters then have the size of a heading's."""


def render_page(report: StudyReport, drawings: Mapping[str, Drawing | Missing] | None = None) -> str:
    """Write the page of a study.

    Args:
        report: the study, or as much of it as there is.
        drawings: what ``draw_all(report)`` gave, where the caller has it already; drawn here otherwise.
    """
    drawn = draw_all(report) if drawings is None else drawings
    wide = {name.removesuffix("_wide") for name in drawn if name.endswith("_wide")}
    figures = {
        name: _two_layouts(drawn, name) if name in wide else _figure(drawing)
        for name, drawing in drawn.items()
        if not name.endswith("_wide")
    }
    lost = ALL_DIVERGED if all_diverged(report.trials) else None
    pieces = {
        "title": escape(report.title),
        "name": escape(report.name),
        "finding": _finding(report.trials),
        "failed": _missing(report),
        "gallery": gallery(report.replays, lost=lost),
        "viewer": viewer(report.replays, lost=lost),
        "transfer_table": transfer_table(report.trials),
        "against_paper": against_paper(report.findings),
        "contrasts": contrasts(report.findings),
        "suspects": suspects(report.findings),
        "retried": retried(report.findings),
        "lineage": lineage(report.findings),
        "draws": _draws(report.draws),
        "seconds": f"{report.measured_seconds:.0f}",
        "tank_tests": tank_tests(report.findings),
        "made": _made(report),
        "script": script(report.replays),
        **figures,
    }
    return document(title=pieces["title"], policy=POLICY, body=Template(resource("page.html")).substitute(pieces))


def render_robot(replay: Replay, lines: Sequence[str]) -> str:
    """Write a page with one robot in the viewer.

    Args:
        replay: what it does.
        lines: what is said of it.
    """
    said = "<br>".join(escape(line.strip()) for line in lines)
    body = (
        f'<main><header><p class="study">puddle · one design</p><h1>{escape(replay.title)}</h1><p>{said}</p></header>'
        f"<section><h2>Watch it move</h2>{viewer([replay])}</section></main>{script([replay])}"
    )
    return document(title=escape(replay.title), policy=POLICY, body=body)


# -- words ------------------------------------------------------------------------------------------------------------


def _finding(trials: Sequence[TrialResult]) -> str:
    """Say in a sentence how designs transferred at the deepest depth, as far as there is something to say."""
    if not trials:
        return '<p class="finding">No trial has finished yet; this page fills as the study goes on.</p>'
    depth = deepest_scored(trials)
    if all_diverged(trials):
        return f'<p class="finding">There is no champion: {ALL_DIVERGED}.</p>'
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
        of_best = "" if share is None else f" ({percent(share)})"
        evolved = escape(ENVIRONMENTS[environment].evolved)
        parts.append(f"<b>{number(found.mean)}\u00a0m</b>{of_best} if they evolved {evolved}")
    return (
        f'<p class="finding">In {depth:g} m of True Slush, champions put there as they were moved on average '
        f"{', '.join(parts)}.</p>"
    )


def _missing(report: StudyReport) -> str:
    """Name what the page does without, and say why."""
    failed = _listed("These failed twice and were set aside.", report.failed)
    failed += _listed("These need what is missing, and were not tried.", report.not_possible)
    wild = _listed(
        "They were set aside, and all else goes on without them. In a sound world none does: look at the settings of "
        "physics and slush, and at the networks’ errors.",
        report.diverged,
    )
    notices = (("Not everything ran; what is below does without it.", failed), ("Designs diverged.", wild))
    return "".join(f'<div class="notice"><b>{title}</b>{said}</div>' for title, said in notices if said)


def _listed(sentence: str, names: Sequence[str]) -> str:
    return f" {sentence}<ul>{''.join(f'<li>{escape(name)}</li>' for name in names)}</ul>" if names else ""


def _draws(draws: Sequence[Draws]) -> str:
    """Say how much of what was drawn could not be built; nothing where any body would do."""
    if not draws:
        return ""
    said = ", ".join(
        f"{percent(of.n_rejected / of.n_drawn)} of {of.n_drawn:,} by {escape(of.operator)}" for of in draws
    )
    return (
        '<p class="small" id="draws">Links that no joint ties must not overlap at rest; designs of which some did were '
        f"drawn again: {said}.</p>"
    )


# -- figures ----------------------------------------------------------------------------------------------------------


def _figure(drawing: Drawing | Missing) -> str:
    if isinstance(drawing, Missing):
        return absent(drawing.title, drawing.reason)
    caption = f"<figcaption>{escape(drawing.description)}</figcaption>"
    return f'<figure id="{drawing.name}"><h3>{escape(drawing.title)}</h3>{inline_svg(drawing)}{caption}</figure>'


def _two_layouts(drawn: Mapping[str, Drawing | Missing], name: str) -> str:
    """Choose between two layouts of the same panels by the page's width."""
    narrow, wide = drawn[name], drawn[f"{name}_wide"]
    if isinstance(narrow, Missing) or isinstance(wide, Missing):
        return _figure(narrow)
    caption = f"<figcaption>{escape(narrow.description)}</figcaption>"
    return (
        f'<figure id="{name}"><h3>{escape(narrow.title)}</h3><div class="narrow">{inline_svg(narrow)}</div>'
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


# -- how it was made --------------------------------------------------------------------------------------------------


def _made(report: StudyReport) -> str:
    digests = [(f"{digest.stage} · {digest.label}", digest.sha256) for digest in report.digests]
    settings = f"<pre><code>{escape(report.settings_yaml)}</code></pre>" if report.settings_yaml else ""
    return "".join(
        f"<details><summary>{title}</summary>{content}</details>"
        for title, content in (
            ("Made with", _plain_table(report.created_with.items())),
            ("Settings", settings),
            (f"SHA-256 of {len(digests)} artifacts", _plain_table(digests)),
        )
        if content
    )


def _plain_table(rows: Iterable[tuple[str, str]]) -> str:
    body = "".join(f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in rows)
    return f'<div class="scroll"><table class="plain"><tbody>{body}</tbody></table></div>' if body else ""
