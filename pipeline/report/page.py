"""The page of a study: one HTML file that loads nothing else, for desktop and phone, in light and dark mode.

Fixed text is in page.html, the frame of any page in document.html, styles in page.css, and the replay viewer in
viewer.js. This module adds what depends on the study, and escapes every text that comes from it.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from string import Template

from pipeline.report import data
from pipeline.report.data import ALL_DIVERGED, Draws, StudyReport
from pipeline.report.downloads import links
from pipeline.report.drawing import FAINT, INK, PAPER_MARK, Drawing, Missing
from pipeline.report.ensembles_table import ensembles_table
from pipeline.report.figures import applies, draw_all
from pipeline.report.first_screen import first_screen
from pipeline.report.moving import document, gallery, resource, script, viewer
from pipeline.report.page_tables import against_paper, contrasts, exploiters, lineage, retried, robots_on, tank_tests
from pipeline.report.replay import Replay
from pipeline.report.transfer_table import transfer_table, variance_table
from pipeline.report.wording import absent, folded, percent
from pipeline.text import escape
from tasks.evolution import OBJECTIVES, PAPERS_OBJECTIVE
from tasks.world import ENVIRONMENTS, EnvironmentName

_STUDY_POLICY = "script-src 'unsafe-inline'; img-src data:"  # nothing is loaded from elsewhere

_MOST_PIXELS_PER_UNIT = 1.5  # limit on the enlargement of figures; their text is then as large as a heading


def render_page(report: StudyReport, drawings: Mapping[str, Drawing | Missing] | None = None) -> str:
    """Write the page of a study; its figures are drawn here if the caller has not done so."""
    drawn = draw_all(report) if drawings is None else drawings
    sections = _sections(report, {name: _figure(drawn, name) for name in drawn if not name.endswith("_wide")})
    contents = [("about", "What this page shows"), *((name, title) for name, title, _ in sections)]
    texts = {
        "title": escape(report.title),
        "name": escape(report.name),
        "first_screen": first_screen(report),
        "contents": "".join(f' <a href="#{name}">{escape(title)}</a>' for name, title in contents),
        "failed": _missing(report),
        "aim": _aim(report),
        "environments": "\n".join(_environment(name) for name in report.environments if ENVIRONMENTS[name].about),
        "sections": "\n".join(
            f'<section id="{name}">\n<h2>{escape(title)}</h2>\n{content}\n</section>'
            for name, title, content in sections
        ),
        "script": script(report.replays),
    }
    body = Template(resource("page.html")).substitute(texts)
    return document(title=texts["title"], policy=_STUDY_POLICY, body=body)


def _environment(name: EnvironmentName) -> str:
    """Say what an environment is."""
    kind = ENVIRONMENTS[name]
    swatch = f'<span class="swatch {name}"></span>'
    term = f"<dt>{swatch}{escape(kind.label)}, <i>{escape(kind.symbol)}</i></dt>"
    return f"<div>{term}\n<dd>{escape(kind.about)}</dd></div>"


def _aim(report: StudyReport) -> str:
    """Say what robots evolve for."""
    measured = f"{report.measured_seconds:.0f}\nseconds"
    if report.findings.objective == PAPERS_OBJECTIVE:
        return f"to travel as far to the right as they can in {measured}"
    words = f"{report.findings.selected_for} [{OBJECTIVES[report.findings.objective].unit}]"
    return f"for this objective, measured over {measured}: {escape(words)}"


def _sections(report: StudyReport, figures: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Return the id, the title and the content of every section that applies to the study."""
    reason = ALL_DIVERGED if data.all_diverged(report.trials) else None
    found, robots = report.findings, robots_on(report)

    def grid(*names: str) -> str:
        content = "".join(figures.get(name, "") for name in names)
        return f'<div class="figures">{content}</div>' if content else ""

    def alone(*parts: str) -> str:
        content = "".join(parts)
        return f'<div class="figures"><div class="alone">{content}</div></div>' if content else ""

    tests = contrasts(found) if applies(report, "contrasts") else ""
    transfer = grid("transfer_at_depth", "transfer_across_depths", "attribution", "transfer_matrix")
    tree = alone(figures.get("family_tree", ""), lineage(found))
    networks = grid("aggregates", "data_set", "coverage", "residual_error", "member_error") + ensembles_table(found)
    doubts = grid("champion_coverage", "phantom_thrust")
    exploited = exploiters(found, robots) if applies(report, "exploiters") else ""
    sections = [
        ("evolved", "What evolved", gallery(report.replays, reason=reason)),
        ("watch", "Watch them move", viewer(report.replays, study=report.name, reason=reason)),
        ("transfer", "Transfer to True Slush", transfer + transfer_table(report.trials, found) + variance_table(found)),
        ("tank", "The robot to build", tank_tests(found, robots)),
        ("paper", "Comparison with the paper", against_paper(found)),
        ("tests", "t tests", tests),
        ("evolution", "Evolution", figures.get("fitness_curves", "") + _draws(report.draws) + tree),
        ("networks", "What the networks learned", figures.get("prediction_accuracy", "") + networks),
        ("exploitation", "Model exploitation", doubts + exploited),
        ("luck", "Luck and reach", retried(found, robots)),
        ("made", "How this study was made", _made(report)),
    ]
    return [section for section in sections if section[2]]


def render_robot(replay: Replay, lines: Sequence[str]) -> str:
    """Write a page with one robot in the viewer, below some lines of text."""
    text = "<br>".join(escape(line.strip()) for line in lines)
    body = (
        f'<main><header><p class="study">puddle · one design</p><h1>{escape(replay.title)}</h1><p>{text}</p></header>'
        f"<section><h2>Watch it move</h2>{viewer([replay])}</section></main>{script([replay])}"
    )
    return document(title=escape(replay.title), policy=_STUDY_POLICY, body=body)


def _missing(report: StudyReport) -> str:
    """List the parts that the page lacks, with the reasons."""
    failed = _listed("These work items failed.", report.failed)
    failed += _listed("These need a failed work item and were not tried.", report.not_possible)
    wild = _listed(
        "They count as unfit, and the study goes on without them. With sound settings no design diverges: check the "
        "settings of physics and slush, and the errors of the networks.",
        report.diverged,
    )
    notices = (("The study is incomplete, and so is this page.", failed), ("Some designs diverged.", wild))
    return "".join(f'<div class="notice"><b>{title}</b>{text}</div>' for title, text in notices if text)


def _listed(sentence: str, names: Sequence[str]) -> str:
    return f" {sentence}<ul>{''.join(f'<li>{escape(name)}</li>' for name in names)}</ul>" if names else ""


def _draws(draws: Sequence[Draws]) -> str:
    """State which share of the drawn designs was rejected; nothing where every design is buildable."""
    if not draws:
        return ""
    shares = ", ".join(
        f"{percent(total.n_rejected / total.n_drawn)} of {total.n_drawn:,} from {escape(total.operator)}"
        for total in draws
    )
    return (
        '<p class="small" id="draws">Links that are not joined must not overlap at rest. Designs in which they did '
        f"were rejected and resampled: {shares}.</p>"
    )


def _figure(drawn: Mapping[str, Drawing | Missing], name: str) -> str:
    """Show a figure; where it has a wide variant, the width of the page chooses between the two."""
    drawing, wide = drawn[name], drawn.get(f"{name}_wide")
    if isinstance(drawing, Missing):
        return absent(drawing.title, drawing.reason)
    content = inline_svg(drawing)
    if isinstance(wide, Drawing):
        content = f'<div class="narrow">{content}</div><div class="wide">{inline_svg(wide)}</div>'
    caption = f"<figcaption>{escape(drawing.description)}</figcaption>{_files(drawing, wide)}"
    return f'<figure id="{name}"><h3>{escape(drawing.title)}</h3>{content}{caption}</figure>'


def _files(drawing: Drawing, wide: Drawing | Missing | None) -> str:
    names = [drawing.name, wide.name] if isinstance(wide, Drawing) else [drawing.name]
    return links(*(f"{name}.{kind}" for name in names for kind in ("svg", "png")))


def inline_svg(drawing: Drawing) -> str:
    """Make a figure part of the page: with ids of its own, and colours that follow the page's."""
    svg = drawing.svg.decode("utf-8")
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg)
    for attribute in ("width", "height"):  # the viewBox keeps the proportions, the page sets the size
        svg = re.sub(rf'(<svg[^>]*?) {attribute}="[^"]*"', r"\1", svg, count=1)
    view_box = re.search(r'viewBox="0 0 ([\d.]+) ', svg)
    assert view_box is not None  # Matplotlib always writes it
    width = float(view_box[1])
    svg = svg.replace("<svg", f'<svg style="max-width: {_MOST_PIXELS_PER_UNIT * width:.0f}px"', 1)
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


def _made(report: StudyReport) -> str:
    digests = [(f"{stage} · {label}", sha256) for stage, label, sha256 in report.digests]
    settings = f"<pre><code>{escape(report.settings_yaml)}</code></pre>" if report.settings_yaml else ""
    return "".join(
        folded(title, content)
        for title, content in (
            ("Software versions", _plain_table(report.created_with.items())),
            ("Settings", settings),
            (f"SHA-256 of {len(digests)} artifacts", _plain_table(digests)),
        )
        if content
    )


def _plain_table(rows: Iterable[tuple[str, str]]) -> str:
    body = "".join(f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in rows)
    return f'<div class="scroll"><table class="plain"><tbody>{body}</tbody></table></div>' if body else ""
