"""How every figure looks, and what it becomes: an SVG and a PNG. The same report always gives the same bytes.

Figures are as narrow as a phone (360 units), so that their text stays legible there; a page may show them larger. The
SVG keeps text as text. Its colours are those of ``INK``, ``FAINT`` and the environments alone, so that the page can put
its own in their place when it is dark.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib import style as mpl_style
from matplotlib.figure import Figure

INK = "#1d2129"
FAINT = "#c9ced6"
PAPER_MARK = "#c2185b"

WIDTH = 360 / 72
"""Of a figure [inch]; 360 units of its SVG."""

STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "puddle",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 10.5,
    "axes.titlesize": 10.5,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "hatch.linewidth": 1.0,
    "lines.linewidth": 1.8,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
}
NO_METADATA = {"Creator": None, "Date": None, "Format": None, "Type": None}


@dataclass(frozen=True)
class Drawing:
    """A figure."""

    name: str
    title: str
    description: str
    """What it shows, for those who read it and for those who can't see it."""
    svg: bytes
    png: bytes
    """On white, at three pixels a unit."""


@dataclass(frozen=True)
class Missing:
    """A figure that this study cannot fill, and why."""

    name: str
    title: str
    reason: str


class NothingToDraw(Exception):  # noqa: N818 (what it is, not that it went wrong)
    """Raised by a figure that has no data; its message is the reason, for a reader."""


def finish(name: str, title: str, draw: Callable[[], tuple[Figure, str]]) -> Drawing | Missing:
    """Draw a figure and write it as SVG and PNG, or say why there is none."""
    with mpl_style.context(["default", STYLE]):  # whatever style the user has set
        try:
            figure, description = draw()
        except NothingToDraw as nothing:
            return Missing(name=name, title=title, reason=str(nothing))
        svg, png = io.BytesIO(), io.BytesIO()
        figure.savefig(svg, format="svg", metadata=NO_METADATA)
        figure.savefig(png, format="png", dpi=216, facecolor="white", metadata={"Software": None})
    return Drawing(
        name=name, title=title, description=description, svg=_round_paths(svg.getvalue()), png=png.getvalue()
    )


def _round_paths(svg: bytes) -> bytes:
    """Cut the coordinates of paths to hundredths of a unit, so that a figure of many lines stays small."""
    return re.sub(rb' d="[^"]*"', lambda path: re.sub(rb"(\.\d\d)\d+", rb"\1", path[0]), svg)


LEAST_RANGE = 0.1
"""Of an axis of displacements [m]: where nothing moves, rounding is not blown up to a figure."""


def show_at_least(axes: Any, span: float) -> None:
    """Widen the upright axis to a span around its middle, if it is narrower."""
    low, high = axes.get_ylim()
    if high - low < span:
        axes.set_ylim((low + high - span) / 2, (low + high + span) / 2)


def count(things: Sequence[Any], name: str) -> str:
    """Say how many there are: "1 member", "8 members"."""
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"
