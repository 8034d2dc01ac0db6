"""Figures for print: as wide as a column, the same in all three formats, and the same bytes each time."""

import io
import re
import xml.etree.ElementTree as ElementTree
import zlib
from dataclasses import replace

import matplotlib as mpl
import pytest
from PIL import Image

from pipeline.report import column_figures
from pipeline.report.column_figures import COLUMN_WIDTH, PAGE_WIDTH, ColumnFigure, draw_for_print
from pipeline.report.drawing import FIGURE_WIDTH, Missing
from pipeline.report.figures import FIGURES

ONE = "transfer_at_depth"
SHOWN = ("transfer_at_depth", "prediction_accuracy_wide", "fitness_curves", "fitness_curves_wide")


@pytest.fixture
def few(monkeypatch):
    monkeypatch.setattr(column_figures, "FIGURES", {name: FIGURES[name] for name in SHOWN})


@pytest.fixture
def one(monkeypatch):
    monkeypatch.setattr(column_figures, "FIGURES", {ONE: FIGURES[ONE]})


def streams(pdf: bytes) -> list[bytes]:
    """Return the content streams of a PDF that can be decompressed."""
    found = []
    for compressed in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, flags=re.S):
        try:
            found.append(zlib.decompress(compressed))
        except zlib.error:
            continue
    return found


def test_a_figure_is_as_wide_as_a_column_in_every_format(study, few):
    figures = {figure.name: figure for figure in draw_for_print(study)}
    assert list(figures) == list(SHOWN[:3])  # two depths fit a column, so that a wide variant would be the same
    narrow, wide = figures["transfer_at_depth"], figures["prediction_accuracy_wide"]
    three_panels = 1.5 * COLUMN_WIDTH  # two fill a column
    assert three_panels < PAGE_WIDTH
    for figure, inches in ((narrow, COLUMN_WIDTH), (wide, three_panels)):
        assert isinstance(figure, ColumnFigure) and figure.caption.endswith(".")
        svg = ElementTree.fromstring(figure.svg)
        assert float(svg.attrib["width"].removesuffix("pt")) == pytest.approx(72 * inches)
        image = Image.open(io.BytesIO(figure.png))
        assert image.width == pytest.approx(600 * inches, abs=1) and image.info["dpi"][0] == pytest.approx(600, abs=0.1)
        box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", figure.pdf)
        assert float(box[1]) == pytest.approx(72 * inches)
        assert float(box[2]) / float(box[1]) == pytest.approx(image.height / image.width, rel=0.01)
    assert narrow.svg.count(b'viewBox="0 0 360 ') == 1


def test_a_pdf_is_scaled_and_its_paths_reach_the_right_edge(study, one):
    """Matplotlib clips paths to the page: unless it is told the size before scaling, the right third is lost."""
    pdf = next(iter(draw_for_print(study))).pdf
    scale = COLUMN_WIDTH / FIGURE_WIDTH
    (content,) = (stream for stream in streams(pdf) if b" cm" in stream[:200])
    assert re.search(rb"(?m)^([\d.]+) 0 0 \1 0 0 cm$", content)[1].startswith(b"%g" % scale)
    right = max(float(x) for x in re.findall(rb"(?m)^([\d.]+) [\d.]+ l$", content))
    assert right > 0.9 * 72 * FIGURE_WIDTH


def test_text_in_a_pdf_is_text(study, one):
    assert b"/Subtype /Type0" in next(iter(draw_for_print(study))).pdf  # an embedded TrueType font, not outlines


def test_the_same_bytes_each_time_whatever_style_is_set(study, one):
    with mpl.rc_context({"lines.linewidth": 9.0, "pdf.fonttype": 3}):
        again = list(draw_for_print(study))
    assert again == list(draw_for_print(study))


def test_a_figure_without_data_gives_its_reason(study, one):
    (missing,) = draw_for_print(replace(study, trials=[]))
    assert isinstance(missing, Missing) and missing.reason == "no trial has finished yet"
