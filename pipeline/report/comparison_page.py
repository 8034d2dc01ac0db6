"""A comparison as a file: a page that looks like a study's, or the table alone."""

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.report.document import TEMPLATES, document
from pipeline.report.render import WRITERS, as_html
from tasks.analysis.comparison import Comparison

SUFFIXES = (".html", *WRITERS)
SAID_ABOVE = ("b",)  # column that a heading makes superfluous: B is the same study or arm in every row


@dataclass(frozen=True)
class Compared:
    """The rows of a comparison, and what a reader has to know of it."""

    title: str
    a: str  # what A is
    b: str  # what B is, the reference
    changes: Sequence[tuple[str, str, str]]  # settings that differ: name, value in A, value in B
    rows: Sequence[Comparison]
    caution: str = ""


def written_comparison(compared: Compared, suffix: str) -> str:
    """Return the content of a file that ends in one of SUFFIXES."""
    if suffix in WRITERS:
        return WRITERS[suffix](Comparison, compared.rows, compared.title)
    table = as_html(Comparison, compared.rows, "Differences between A and B", without=SAID_ABOVE)
    body = TEMPLATES.get_template("comparison.html").render(compared=compared, table=table)
    return document(title=compared.title, policy="script-src 'none'", body=body)
