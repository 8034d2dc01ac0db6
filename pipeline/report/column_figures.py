"""The figures of a study for print: as wide as a column of a two-column paper, or at most as its page.

They are those of the study's page, scaled as a whole, so that their text is about 7 points high. The same report always
gives the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_pdf import Op, PdfFile, RendererPdf
from matplotlib.figure import Figure

from pipeline.report.data import StudyReport
from pipeline.report.drawing import (
    FIGURE_WIDTH,
    NO_METADATA,
    Missing,
    NothingToDraw,
    figure_style,
    fix_layout,
    round_paths,
)
from pipeline.report.figures import FIGURES, WIDE

COLUMN_WIDTH, PAGE_WIDTH = 3.5, 7.16  # of a two-column paper [inch]

_PNG_DPI = 600  # dots per inch of the printed figure
_PDF_METADATA = {"Creator": None, "Producer": None, "CreationDate": None}


@dataclass(frozen=True)
class ColumnFigure:
    """A figure for print."""

    name: str
    caption: str
    svg: bytes
    png: bytes
    pdf: bytes


def draw_for_print(report: StudyReport) -> Iterator[ColumnFigure | Missing]:
    """Draw every figure of a study, or give the reason why there is none."""
    for name, (title, draw) in FIGURES.items():
        with figure_style(), mpl.rc_context({"pdf.fonttype": 42}):  # text that an editor of figures can change
            try:
                figure, caption = draw(report)
            except NothingToDraw as nothing:
                yield Missing(name=name, title=title, reason=str(nothing))
                continue
            width = figure.get_size_inches()[0]
            if name.endswith(WIDE) and width <= FIGURE_WIDTH:
                continue  # the same figure
            fix_layout(figure)
            scale = min(COLUMN_WIDTH / FIGURE_WIDTH, PAGE_WIDTH / width)
            yield ColumnFigure(name, caption, _svg(figure, scale), _png(figure, scale), _pdf(figure, scale))


def _svg(figure: Figure, scale: float) -> bytes:
    """Encode a figure as SVG; its view box keeps the size in which it was drawn."""
    sink = io.BytesIO()
    figure.savefig(sink, format="svg", metadata=NO_METADATA)
    head, body = round_paths(sink.getvalue()).split(b"<svg ", 1)
    attributes, body = body.split(b">", 1)

    def scaled(size: re.Match[bytes]) -> bytes:
        return size[1] + b'="%gpt"' % (scale * float(size[2]))

    attributes = re.sub(rb'\b(width|height)="([\d.]+)pt"', scaled, attributes)
    return head + b"<svg " + attributes + b">" + body


def _png(figure: Figure, scale: float) -> bytes:
    sink = io.BytesIO()
    resolution = {"dpi": (_PNG_DPI, _PNG_DPI)}
    metadata = {"Software": None}
    figure.savefig(
        sink, format="png", dpi=scale * _PNG_DPI, facecolor="white", metadata=metadata, pil_kwargs=resolution
    )
    return sink.getvalue()


def _pdf(figure: Figure, scale: float) -> bytes:
    """Encode a figure as PDF. Matplotlib has no scale for it, so this is its ``print_pdf`` with one."""
    sink = io.BytesIO()
    width, height = figure.get_size_inches()
    dpi, figure.dpi = figure.dpi, 72  # as many as points
    file: Any = PdfFile(sink, metadata=_PDF_METADATA)
    try:
        file.newPage(scale * width, scale * height)
        file.width, file.height = width, height  # to which paths are clipped
        file.output(scale, 0, 0, scale, 0, 0, Op.concat_matrix)
        canvas = RendererPdf(file, scale * _PNG_DPI, height, width)
        renderer = MixedModeRenderer(figure, width, height, scale * _PNG_DPI, canvas)
        figure.draw(renderer)
        renderer.finalize()
        file.finalize()
    finally:
        file.close()
        figure.dpi = dpi
    return sink.getvalue()
