"""What all pages share: templates, the frame with its styles, and figures as a part of the page."""

import re
from html import escape
from importlib.resources import files

import jinja2
from markupsafe import Markup

from pipeline.report.drawing import Drawing

_MOST_PIXELS_PER_UNIT = 1.5  # limit on the enlargement of figures; their text is then as large as a heading


TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("pipeline.report", "."),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def resource(name: str) -> str:
    """Read a file of this package."""
    return files("pipeline.report").joinpath(name).read_text(encoding="utf-8")


def document(*, title: str, policy: str, body: str, css: str = "") -> str:
    """Return a whole page, for a study or for a kit.

    Args:
        title: text.
        policy: Content-Security-Policy for everything but styles.
        body: HTML.
        css: styles in addition to page.css.
    """
    styles = f"{resource('page.css').rstrip()}\n{css}"
    return TEMPLATES.get_template("document.html").render(
        title=title, policy=Markup(policy), css=Markup(styles), body=Markup(body.rstrip())
    )


def absent(title: str, reason: str) -> Markup:
    """State in the place of a figure why it is missing."""
    return Markup('<p class="absent"><b>{}</b>: not available, because {}.</p>').format(title, reason)


def inline_svg(drawing: Drawing) -> Markup:
    """Make a figure part of the page, with ids of its own."""
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
    return Markup(svg.replace("<svg", f'<svg role="img" aria-label="{escape(drawing.description)}"', 1).strip())
