"""The common look of all figures, and their output as SVG, PNG and PDF. The same report always gives the same bytes.

Figures are as narrow as a phone (360 units), so that their text stays legible there; a page may enlarge them. The SVG
keeps text as text.
"""

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import style as mpl_style
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tasks.arrays import Int64

INK = "#1d2129"
FAINT = "#c9ced6"
PAPER_MARK = "#c2185b"
DASHED, DOTTED = (0, (4, 3)), (0, (1, 1.2))

FIGURE_WIDTH = 360 / 72  # width of a figure [inch]; 360 units of its SVG

_STYLE = ["default", "pipeline.report.figures"]  # figures.mplstyle, whatever style the user has set


class NothingToDraw(Exception):  # noqa: N818 (a condition, not a failure)
    """Raised by a figure that has no data; the message may give the reason."""


@dataclass(frozen=True)
class Drawing:
    """A figure."""

    name: str  # of its files, and its id on the page
    title: str
    description: str  # the caption, which is also the text for readers who cannot see the figure
    svg: bytes
    figure: Figure = field(repr=False, compare=False)

    @cached_property
    def png(self) -> bytes:
        """The figure on white, 300 dots per inch; encoded when asked for, as is the PDF: few figures need both."""
        return _encoded(self.figure, "png", dpi=300, facecolor="white", metadata={"Software": None})

    @cached_property
    def pdf(self) -> bytes:
        """The figure for print."""
        return _encoded(self.figure, "pdf", metadata={"Creator": None, "Producer": None, "CreationDate": None})

    def html(self, below: str = "") -> Markup:
        """Return the part of a page: heading, SVG with ids of its own, caption, and what stands ``below``."""
        svg = self.svg.decode()
        tag = re.search(r'<svg[^>]*(viewBox="[\d. ]+")[^>]*>', svg)
        assert tag is not None  # Matplotlib always writes it
        content = re.sub(r'\b(id="|href="#|url\(#)', rf"\1{self.name}-", svg[tag.end() :])
        return Markup(
            '<figure id="{0.name}"><h3>{0.title}</h3><svg role="img" aria-label="{0.description}" {1}>{2}'
            "<figcaption>{0.description}</figcaption>{3}</figure>"
        ).format(self, Markup(tag[1]), Markup(content), below)


def finish(name: str, title: str, draw: Callable[[], tuple[Figure, str]]) -> Drawing:
    """Draw a figure and its description by ``draw``, in the common style, whatever style the user has set."""
    with mpl_style.context(_STYLE):
        figure, description = draw()
        figure.draw_without_rendering()  # lays it out, once for all formats
        figure.set_layout_engine("none")
    svg = _encoded(figure, "svg", metadata={"Creator": None, "Date": None, "Format": None, "Type": None})
    # Coordinates of paths in hundredths of a unit keep a figure of many lines small.
    rounded = re.sub(rb' d="[^"]*"', lambda path: re.sub(rb"(\.\d\d)\d+", rb"\1", path[0]), svg)
    return Drawing(name, title, description, rounded, figure)


def _encoded(figure: Figure, kind: str, **options: Any) -> bytes:
    out = io.BytesIO()
    with mpl_style.context(_STYLE):
        figure.savefig(out, format=kind, **options)
    return out.getvalue()


def panel_grid(n_panels: int, *, row_height: float, n_columns: int = 2) -> tuple[Figure, Any]:
    """Return a figure and its panels (n_panels,), in rows of ``row_height`` inches that share their axes."""
    n_columns = min(n_columns, n_panels)
    n_rows = -(-n_panels // n_columns)
    figure = Figure(figsize=(FIGURE_WIDTH, row_height * n_rows + 0.75), layout="constrained")
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel()
    for panel in panels[n_panels:]:
        panel.set_visible(False)
    for panel in panels[n_panels - n_columns : n_panels]:
        panel.xaxis.set_tick_params(labelbottom=True)
    return figure, panels[:n_panels]


def legend(figure: Figure, handles: Sequence[Artist], *, n_columns: int = 3, above: bool = False) -> None:
    """Put a legend outside the panels, in ``n_columns`` or as many as the figure is wide enough for."""
    for n in range(n_columns, 0, -1) if handles else ():
        drawn = figure.legend(handles=handles, loc=f"outside {'upper' if above else 'lower'} center", ncols=n)
        if n == 1 or drawn.get_window_extent().width <= figure.bbox.width:
            break
        drawn.remove()


def show_at_least(axes: Axes, span: float = 0.1) -> None:
    """Widen the vertical axis to a span [m] around its middle, so that rounding errors do not fill the figure."""
    low, high = axes.get_ylim()
    if high - low < span:
        axes.set_ylim((low + high - span) / 2, (low + high + span) / 2)


def sampled(n: int, n_shown: int) -> Int64:
    """Return at most n_shown indices that are evenly spread over n."""
    return np.unique(np.linspace(0, n - 1, n_shown).round().astype(int))
