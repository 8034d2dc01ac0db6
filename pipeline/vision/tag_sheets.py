"""Sheets of tags to print at their true size: A4 pages as SVG and PNG."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pipeline.errors import PuddleError
from pipeline.vision.markers_file import Dictionary, Markers
from pipeline.vision.tags import charuco_board, modules
from tasks.arrays import Bools

_PAGE_MM, _MARGIN_MM, _GAP_MM, _TEXT_MM = (210.0, 297.0), 8.0, 4.0, 3.0
_DPI = 300
_TANK_BORDER, _ROBOT_BORDER = 1.5, 4 / 3  # side of a label over that of its tag

Rectangle = tuple[float, float, float, float]  # left, top, width, height [mm]


@dataclass(frozen=True)
class Label:
    """Something to cut out."""

    text: str
    width: float  # [mm]
    height: float  # [mm]
    black: tuple[Rectangle, ...]  # from its upper left corner


@dataclass
class _Page:
    outlines: list[Rectangle] = field(default_factory=list)
    black: list[Rectangle] = field(default_factory=list)
    texts: list[tuple[float, float, str]] = field(default_factory=list)


def tag_sheets(markers: Markers, names: Sequence[str]) -> dict[str, bytes]:
    """Draw all tags of a kit.

    Args:
        markers: the tags of tank, bars, robot and board.
        names: of the bars.

    Returns:
        Pages as ``NAME.svg`` and ``NAME.png``: the faces of the bars, to be glued on whole, so that their tags are
        where the markers file says; the tags of the tank and the robot; the board.

    Raises:
        PuddleError: a number is not in the dictionary, or a label does not fit on the page.
    """
    dictionary = markers.dictionary
    faces = []
    for bar, name in zip(markers.bars, names, strict=True):
        width, height = 1000 * bar.width, 1000 * bar.length
        black: list[Rectangle] = []
        for tag in bar.tags:
            size = 1000 * tag.size
            left, top = width / 2 + 1000 * tag.across - size / 2, height / 2 - 1000 * tag.along - size / 2
            black += _squares(modules(dictionary, tag.number), left, top, size)
        numbers = ", ".join(str(tag.number) for tag in bar.tags)
        faces.append(Label(f"{name}: {numbers}", width, height, tuple(black)))
    tank = [tag.number for tag in markers.tank.corners] + list(markers.tank.waterline_tags or ())
    single = [_label(dictionary, f"tank {n}", n, 1000 * markers.tank.tag_size, _TANK_BORDER) for n in tank]
    for link, bar in enumerate(markers.robot.bars()):
        number = bar.tags[0].number
        single.append(
            _label(dictionary, f"link {link}: {number}", number, 1000 * markers.robot.tag_size, _ROBOT_BORDER)
        )
    board = markers.board
    of_board = charuco_board(board, dictionary)
    n_px = 8 * of_board.getDictionary().markerSize  # per square, more than it has modules
    picture = of_board.generateImage((board.columns * n_px * 3, board.rows * n_px * 3), marginSize=0)
    upright = np.rot90(picture) == 0
    side = 1000 * board.square / (n_px * 3)
    whole = Label(
        f"board: squares of {1000 * board.square:g} mm",
        1000 * board.square * board.rows,
        1000 * board.square * board.columns,
        tuple(_runs(upright, 0.0, 0.0, side)),
    )
    files: dict[str, bytes] = {}
    for name, labels in (("faces", faces), ("tags", single), ("board", [whole])):
        pages = _packed(labels)
        for number, page in enumerate(pages, 1):
            stem = name if len(pages) == 1 else f"{name}-{number}"
            files[f"{stem}.svg"], files[f"{stem}.png"] = _svg(page), _png(page)
    return files


def _label(dictionary: Dictionary, text: str, number: int, size: float, border: float) -> Label:
    side = size * border
    at = (side - size) / 2
    return Label(text, side, side, tuple(_squares(modules(dictionary, number), at, at, size)))


def _squares(black: Bools, left: float, top: float, size: float) -> list[Rectangle]:
    return _runs(black, left, top, size / len(black))


def _runs(black: Bools, left: float, top: float, side: float) -> list[Rectangle]:
    """Join the black squares of each row into rectangles, and equal ones of neighbouring rows."""
    found: list[Rectangle] = []
    open_: dict[tuple[int, int], int] = {}
    for row in range(len(black) + 1):
        padded = np.zeros(black.shape[1] + 2, dtype=np.int8)
        padded[1:-1] = black[row] if row < len(black) else 0
        change = np.flatnonzero(np.diff(padded))
        runs = set(zip(change[::2].tolist(), change[1::2].tolist(), strict=True))
        for run in sorted(open_.keys() - runs):
            begin = open_.pop(run)
            found.append((left + run[0] * side, top + begin * side, (run[1] - run[0]) * side, (row - begin) * side))
        open_ |= dict.fromkeys(runs - open_.keys(), row)
    return found


def _packed(labels: Sequence[Label]) -> list[_Page]:
    """Lay labels out in rows from the upper left, on as many pages as they need."""
    pages, x, y, deepest = [_Page()], _MARGIN_MM, _MARGIN_MM, 0.0
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
            pages.append(_Page())
            x, y, deepest = _MARGIN_MM, _MARGIN_MM, 0.0
        page = pages[-1]
        page.outlines.append((x, y, label.width, label.height))
        page.black += [(x + left, y + top, w, h) for left, top, w, h in label.black]
        page.texts.append((x, y + label.height + _TEXT_MM, label.text))
        x, deepest = x + width + _GAP_MM, max(deepest, height)
    return pages


def _svg(page: _Page) -> bytes:
    width, height = _PAGE_MM
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}"><rect width="100%" height="100%" fill="#fff"/>'
    ]
    out += [_rectangle(at, 'fill="none" stroke="#999" stroke-width="0.1"') for at in page.outlines]
    out += [_rectangle(at, 'shape-rendering="crispEdges"') for at in page.black]
    style = f'font-family="sans-serif" font-size="{_TEXT_MM - 0.4:g}" fill="#555"'
    out += [f'<text x="{x:.2f}" y="{y:.2f}" {style}>{text}</text>' for x, y, text in page.texts]
    return "\n".join([*out, "</svg>\n"]).encode()


def _rectangle(at: Rectangle, style: str) -> str:
    left, top, width, height = at
    return f'<rect x="{left:.4f}" y="{top:.4f}" width="{width:.4f}" height="{height:.4f}" {style}/>'


def _png(page: _Page) -> bytes:
    per_mm = _DPI / 25.4
    picture = Image.new("L", (round(_PAGE_MM[0] * per_mm), round(_PAGE_MM[1] * per_mm)), 255)
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(size=(_TEXT_MM - 0.4) * per_mm)
    for shapes, style in ((page.outlines, {"outline": 150}), (page.black, {"fill": 0})):
        for left, top, width, height in shapes:
            box = [round(side * per_mm) for side in (left, top, left + width, top + height)]
            draw.rectangle((box[0], box[1], box[2] - 1, box[3] - 1), **style)
    for x, y, text in page.texts:
        draw.text((x * per_mm, (y - _TEXT_MM + 0.3) * per_mm), text, fill=90, font=font)
    out = io.BytesIO()
    picture.save(out, "PNG", dpi=(_DPI, _DPI), optimize=True)
    return out.getvalue()
