"""The common look of all figures, and their output as SVG, PNG and PDF. The same report always gives the same bytes.

Figures are as narrow as a phone (360 units), so that their text stays legible there; a page may enlarge them. The SVG
keeps text as text.
"""

import io
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib import style as mpl_style
from matplotlib.artist import Artist
from matplotlib.figure import Figure

INK = "#1d2129"
FAINT = "#c9ced6"
PAPER_MARK = "#c2185b"
DASHED, DOTTED = (0, (4, 3)), (0, (1, 1.2))

FIGURE_WIDTH = 360 / 72  # width of a figure [inch]; 360 units of its SVG

_STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "pdf.fonttype": 42,  # text that an editor of figures can change
    "svg.hashsalt": "puddle",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 10.5,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.axisbelow": True,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.columnspacing": 1.2,
    "hatch.linewidth": 1.0,
    "lines.linewidth": 1.8,
    "figure.labelsize": 10.5,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
}
_NO_METADATA = {"Creator": None, "Date": None, "Format": None, "Type": None}


@dataclass(frozen=True)
class Drawing:
    """A figure."""

    name: str
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


@dataclass(frozen=True)
class Missing:
    """A figure for which the study has no data, and why."""

    name: str
    title: str
    reason: str


class NothingToDraw(Exception):  # noqa: N818 (a condition, not a failure)
    """Raised by a figure that has no data; the message may give the reason."""


def _figure_style() -> AbstractContextManager[None]:
    """Return the context in which figures are drawn and encoded; it overrides any style that the user has set."""
    return mpl_style.context(["default", _STYLE])


def finish(name: str, title: str, draw: Callable[[], tuple[Figure, str]]) -> Drawing | Missing:
    """Return a figure, or the reason why there is none.

    Args:
        name: name of the figure, used for its files and its id on the page.
        title: heading.
        draw: returns the figure and its description, or raises NothingToDraw.
    """
    with _figure_style():
        try:
            figure, description = draw()
        except NothingToDraw as nothing:
            return Missing(name=name, title=title, reason=str(nothing))
        _fix_layout(figure)
    return Drawing(name, title, description, _round_paths(_encoded(figure, "svg", metadata=_NO_METADATA)), figure)


def _encoded(figure: Figure, kind: str, **options: Any) -> bytes:
    out = io.BytesIO()
    with _figure_style():
        figure.savefig(out, format=kind, **options)
    return out.getvalue()


def _fix_layout(figure: Figure) -> None:
    """Lay out a figure once and for all; a figure with a layout engine is drawn twice for each of its formats."""
    engine = figure.get_layout_engine()
    assert engine is not None  # figures of a report are constrained
    engine.execute(figure)
    figure.set_layout_engine(None)


def _round_paths(svg: bytes) -> bytes:
    """Round the coordinates of paths to hundredths of a unit, so that a figure of many lines stays small."""
    return re.sub(rb' d="[^"]*"', lambda path: re.sub(rb"(\.\d\d)\d+", rb"\1", path[0]), svg)


def panel_grid(n_panels: int, n_columns: int, *, row_height: float, share_y: bool = True) -> tuple[Figure, Any]:
    """Return a figure and its panels (n_panels,), in rows that share their axes.

    Args:
        n_panels: number of panels.
        n_columns: panels per row at most; more than two widen the figure. Rows have about as many panels each.
        row_height: height of a row [inch].
        share_y: whether all panels have the same vertical axis.
    """
    n_rows = -(-n_panels // n_columns)
    n_columns = -(-n_panels // n_rows)
    figure = Figure(figsize=(FIGURE_WIDTH * max(1.0, n_columns / 2), row_height * n_rows + 0.75), layout="constrained")
    panels = figure.subplots(n_rows, n_columns, sharex=True, sharey=share_y, squeeze=False).ravel()
    for panel in panels[n_panels:]:
        panel.set_visible(False)
    for panel in panels[n_panels - n_columns : n_panels]:
        panel.xaxis.set_tick_params(labelbottom=True)
    return figure, panels[:n_panels]


def legend(figure: Figure, handles: Sequence[Artist], *, n_columns: int = 3, above: bool = False) -> None:
    """Put a legend outside the panels.

    Args:
        figure: the figure.
        handles: legend entries; without any there is no legend.
        n_columns: entries per row, or as many as the figure is wide enough for.
        above: whether it goes above the panels instead of below.
    """
    place = f"outside {'upper' if above else 'lower'} center"
    for n in range(n_columns, 0, -1) if handles else ():
        drawn = figure.legend(handles=handles, loc=place, ncols=n)
        if n == 1 or drawn.get_window_extent().width <= figure.bbox.width:
            break
        drawn.remove()


def show_at_least(axes: Any, span: float = 0.1) -> None:
    """Widen the vertical axis to a span [m] around its middle, so that rounding errors do not fill the figure."""
    low, high = axes.get_ylim()
    if high - low < span:
        axes.set_ylim((low + high - span) / 2, (low + high + span) / 2)


def sampled(n: int, n_shown: int) -> Any:
    """Return at most n_shown indices that are evenly spread over n."""
    return np.unique(np.linspace(0, n - 1, n_shown).round().astype(int))
