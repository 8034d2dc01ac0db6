"""Sheets of tags to print at their true size: A4 pages as PNG, and all of them as PDF."""

import io
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pipeline.bench.vision.markers_file import Dictionary, Markers
from pipeline.bench.vision.tags import charuco_board, modules
from pipeline.errors import PuddleError
from tasks.arrays import Bools

_PAGE_MM, _MARGIN_MM, _GAP_MM, _TEXT_MM = (210.0, 297.0), 8.0, 4.0, 3.0
_DPI = 300
_PX_PER_MM = _DPI / 25.4
_TANK_BORDER, _ROBOT_BORDER = 1.5, 4 / 3  # side of a label over that of its tag


@dataclass(frozen=True)
class _Label:
    """Something to cut out."""

    text: str
    width: float  # [mm]
    height: float  # [mm]
    tags: tuple[tuple[Bools, float, float, float], ...]
    """Modules of each tag, True where black, the left and upper end of it from the upper left corner, and the edge of a
    module [mm]."""


def tag_sheets(markers: Markers, names: Sequence[str]) -> dict[str, bytes]:
    """Draw all tags of a kit whose bars have names, as pages ``NAME.png`` and as ``tags.pdf``.

    The faces of the bars are to be glued on whole, so that their tags are where the markers file says; then come the
    tags of the tank and the robot, and the board. Raises PuddleError if a label does not fit on the page.
    """
    dictionary, board = markers.dictionary, markers.board
    faces = []
    for bar, name in zip(markers.bars, names, strict=True):
        width, height, tags = 1000 * bar.width, 1000 * bar.length, []
        for tag in bar.tags:
            size, black = 1000 * tag.size, modules(dictionary, tag.number)
            left, top = width / 2 + 1000 * tag.across - size / 2, height / 2 - 1000 * tag.along - size / 2
            tags.append((black, left, top, size / len(black)))
        numbers = ", ".join(str(tag.number) for tag in bar.tags)
        faces.append(_Label(f"{name}: {numbers}", width, height, tuple(tags)))
    tank = [(f"tank {tag.number}", tag.number) for tag in markers.tank.corners]
    robot = [(f"link {i}: {bar.tags[0].number}", bar.tags[0].number) for i, bar in enumerate(markers.robot.bars())]
    single = [_single(dictionary, *tag, markers.tank.tag_size, _TANK_BORDER) for tag in tank]
    single += [_single(dictionary, *tag, markers.robot.tag_size, _ROBOT_BORDER) for tag in robot]
    of_board = charuco_board(board, dictionary)
    n_px = 24 * of_board.getDictionary().markerSize  # per square, more than it has modules
    black = np.rot90(of_board.generateImage((board.columns * n_px, board.rows * n_px), marginSize=0)) == 0
    square = 1000 * board.square
    text, sides = f"board: squares of {square:g} mm", (square * board.rows, square * board.columns)
    whole = _Label(text, *sides, ((black, 0.0, 0.0, square / n_px),))
    pages: dict[str, Image.Image] = {}
    for name, labels in (("faces", faces), ("tags", single), ("board", [whole])):
        of_name = _pages(labels)
        pages |= {name if len(of_name) == 1 else f"{name}-{i}": page for i, page in enumerate(of_name, 1)}
    files = {}
    for name, page in pages.items():
        out = io.BytesIO()
        page.save(out, "PNG", dpi=(_DPI, _DPI), optimize=True)
        files[f"{name}.png"] = out.getvalue()
    out, (first, *others) = io.BytesIO(), (page.point(lambda grey: 255 * (grey > 128), "1") for page in pages.values())
    dates = {"creationDate": time.gmtime(0), "modDate": time.gmtime(0)}  # the same kit gives the same bytes
    first.save(out, "PDF", save_all=True, append_images=others, resolution=_DPI, **dates)
    return files | {"tags.pdf": out.getvalue()}


def _single(dictionary: Dictionary, text: str, number: int, size_m: float, border: float) -> _Label:
    black, size = modules(dictionary, number), 1000 * size_m
    at = size * (border - 1) / 2
    return _Label(text, size * border, size * border, ((black, at, at, size / len(black)),))


def _pages(labels: Sequence[_Label]) -> list[Image.Image]:
    """Lay labels out in rows from the upper left, on as many pages as they need."""
    pages, x, y, deepest = [_blank()], _MARGIN_MM, _MARGIN_MM, 0.0
    for label in sorted(labels, key=lambda label: -label.height):
        width, height = label.width, label.height + _TEXT_MM + _GAP_MM
        if width > _PAGE_MM[0] - 2 * _MARGIN_MM or height > _PAGE_MM[1] - 2 * _MARGIN_MM:
            raise PuddleError(
                f"{label.text} has {label.width:.0f} × {label.height:.0f} mm and does not fit on A4: expected a "
                f"smaller kit.scale_mm_per_m, or print its tags from the markers file with another program"
            )
        if x + width > _PAGE_MM[0] - _MARGIN_MM:
            x, y, deepest = _MARGIN_MM, y + deepest + _GAP_MM, 0.0
        if y + height > _PAGE_MM[1] - _MARGIN_MM:
            pages.append(_blank())
            x, y, deepest = _MARGIN_MM, _MARGIN_MM, 0.0
        _draw(pages[-1], label, x, y)
        x, deepest = x + width + _GAP_MM, max(deepest, height)
    return pages


def _blank() -> Image.Image:
    return Image.new("L", (round(_PAGE_MM[0] * _PX_PER_MM), round(_PAGE_MM[1] * _PX_PER_MM)), 255)


def _draw(page: Image.Image, label: _Label, x: float, y: float) -> None:
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(size=(_TEXT_MM - 0.4) * _PX_PER_MM)

    def box(left: float, top: float, right: float, bottom: float) -> tuple[int, int, int, int]:
        ends = [round(side * _PX_PER_MM) for side in (left, top, right, bottom)]
        return ends[0], ends[1], ends[2] - 1, ends[3] - 1

    draw.rectangle(box(x, y, x + label.width, y + label.height), outline=150)
    draw.text((x * _PX_PER_MM, (y + label.height + 0.3) * _PX_PER_MM), label.text, fill=90, font=font)
    for black, left, top, side in label.tags:
        for row, column in np.argwhere(black):
            at = (x + left + side * column, y + top + side * row)
            draw.rectangle(box(*at, at[0] + side, at[1] + side), fill=0)
