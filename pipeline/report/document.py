"""What all pages share: templates, and the frame with its styles."""

from importlib.resources import files

import jinja2

TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("pipeline.report", "."),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
TEMPLATES.globals["resource"] = lambda name: files("pipeline.report").joinpath(name).read_text("utf-8")
"""Read a file of this package, such as a script."""


def document(*, title: str, policy: str, body: str, css: str = "") -> str:
    """Return a whole page; ``policy`` is its Content-Security-Policy, ``css`` comes in addition to page.css."""
    return TEMPLATES.get_template("document.html").render(title=title, policy=policy, css=css, body=body.rstrip())
