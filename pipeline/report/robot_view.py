"""One robot in its world, picture by picture: a lane of a film.

Drawn with Pillow at twice the size and reduced. Where things are is computed for all pictures at once; the caption's
strip and each word are drawn once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from pipeline.report.data import ENVIRONMENTS
from pipeline.report.replay import Replay

WIDTH = 640
"""Of the picture [pixel]. A multiple of 128, so that no row of an MP4's planes has padding, see mp4.py."""
LANE_HEIGHT = 240
"""Of each robot's part of it [pixel]."""
OVERSAMPLING = 2
SIZE = WIDTH * OVERSAMPLING, LANE_HEIGHT * OVERSAMPLING
"""Of a lane before it is reduced [pixel]."""

CAPTION_HEIGHT = 44
"""Of the strip at a lane's top where words stand [pixel]."""
EDGE = 1.75 * OVERSAMPLING
"""Width of a link's edge before it is reduced [pixel]."""

SKY, SLUSH, GROUND, INK, FAINT, WHITE = "#f5f8fb", "#bcd9ee", "#8b7d6b", "#1d2129", "#d5dde5", "#ffffff"
SURFACE, GROUND_EDGE, UNKNOWN = "#5d9fcd", "#5f5446", "#566270"
SLUSH_OVER_ROBOT = 0.45
"""How much of a submerged robot's colour the slush in front of it takes."""

Rgb = tuple[int, int, int]
Points = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Camera:
    """What a lane shows: (x, y) [m] to pixels of the oversampled lane."""

    scale: float
    """[pixel/m]"""
    x: Points
    """(n_pictures,) in the middle of the picture [m]."""
    bottom: Points
    """(n_pictures,) y at the lane's lower edge [m]."""

    def project(self, points: Points) -> Points:
        """Map (n_pictures, ..., 2) x, y [m] to columns and rows."""
        over_all = (slice(None), *[None] * (points.ndim - 2))
        column = SIZE[0] / 2 + (points[..., 0] - self.x[over_all]) * self.scale
        row = SIZE[1] - (points[..., 1] - self.bottom[over_all]) * self.scale
        return np.stack([column, row], axis=-1)


class Lane:
    """A robot in its world, ready to be drawn at any of its poses."""

    def __init__(self, replay: Replay, poses: Points, camera: Camera) -> None:
        """Place everything in all pictures: poses are (n_pictures, n_links, 3) x, y [m], angle [rad]."""
        self._replay, self._camera = replay, camera
        self._start = float(poses[0, 0, 0])
        self._moved = poses[:, 0, 0] - self._start
        length = replay.length_scale
        self._edges = camera.project(link_outline(poses, length))
        self._insides = camera.project(link_outline(poses, length, inset=EDGE / camera.scale))
        self._joints = camera.project(_joints(replay, poses))
        self._roots = camera.project(poses[:, 0, :2])
        zero = np.zeros(len(poses))
        self._surface = camera.project(np.stack([zero, zero], axis=1))[:, 1]
        self._ground = camera.project(np.stack([zero, zero - replay.depth], axis=1))[:, 1]
        self._strip = _strip(replay)

    def draw(self, frame: int, time: float) -> Image.Image:
        """Draw one picture, WIDTH by LANE_HEIGHT, and write a time [s] on it."""
        picture = Image.new("RGB", SIZE, SKY)
        draw = ImageDraw.Draw(picture)
        top = min(max(round(float(self._surface[frame])), 0), SIZE[1]) if self._replay.has_medium else SIZE[1]
        if top < SIZE[1]:
            draw.rectangle((0, top, *SIZE), fill=SLUSH)
        veiled = self._submerged(frame, top)
        self._distances(draw, frame, top, veiled)
        self._robot(draw, frame)
        if veiled is not None:
            seen = picture.crop(veiled)
            picture.paste(Image.blend(seen, Image.new("RGB", seen.size, SLUSH), SLUSH_OVER_ROBOT), veiled)
        if top < SIZE[1]:
            _surface(draw, top, dashed=self._replay.imagined)
        ground = float(self._ground[frame])
        if ground < SIZE[1]:
            draw.rectangle((0, ground, *SIZE), fill=GROUND)
            draw.line((0, ground, SIZE[0], ground), fill=GROUND_EDGE, width=2 * OVERSAMPLING)
        self._scale(draw, frame)
        picture.paste(self._strip, (0, 0))
        right = SIZE[0] - 10 * OVERSAMPLING
        _write(draw, (right, 6 * OVERSAMPLING), _metres(float(self._moved[frame]), 1), 14, bold=True, anchor="ra")
        _write(draw, (right, 25 * OVERSAMPLING), f"{time:.1f} s", 12, anchor="ra")
        draw.line((0, SIZE[1] - 1, SIZE[0], SIZE[1] - 1), fill=WHITE, width=2 * OVERSAMPLING)
        return picture.reduce(OVERSAMPLING)

    def _submerged(self, frame: int, top: int) -> tuple[int, int, int, int] | None:
        """Box of what may show of the robot through the slush; None where there is nothing."""
        reach = 5 * OVERSAMPLING  # dots lie over the edges
        left, upper = (self._edges[frame].min(axis=(0, 1)) - reach).astype(int).tolist()
        right, lower = (self._edges[frame].max(axis=(0, 1)) + reach).astype(int).tolist()
        box = max(left, 0), max(upper, top), min(right, SIZE[0]), min(lower, SIZE[1])
        return box if box[0] < box[2] and box[1] < box[3] else None

    def _ticks(self, frame: int, every: float) -> list[tuple[float, float]]:
        """Distances from the start [m] that are in view, and their columns."""
        camera, x = self._camera, float(self._camera.x[frame])
        half = SIZE[0] / 2 / camera.scale
        first = math.ceil((x - half - self._start) / every)
        last = math.floor((x + half - self._start) / every)
        distances = [every * number for number in range(first, last + 1)]
        return [(at, SIZE[0] / 2 + (self._start + at - x) * camera.scale) for at in distances]

    def _distances(
        self, draw: ImageDraw.ImageDraw, frame: int, top: int, veiled: tuple[int, int, int, int] | None
    ) -> None:
        """Draw an upright line every 5 m, so that motion shows where nothing else is near; the start's is darker."""
        for at, column in self._ticks(frame, 5.0):
            color = UNKNOWN if at == 0 else FAINT
            draw.line((column, CAPTION_HEIGHT * OVERSAMPLING, column, top), fill=color, width=OVERSAMPLING)
            if top < SIZE[1]:
                paler = mix(color, SLUSH, SLUSH_OVER_ROBOT)
                draw.line((column, top, column, SIZE[1]), fill=paler, width=OVERSAMPLING)
            if veiled is not None and veiled[0] <= column < veiled[2]:  # it is to be veiled with the robot
                draw.line((column, veiled[1], column, veiled[3] - 1), fill=color, width=OVERSAMPLING)

    def _scale(self, draw: ImageDraw.ImageDraw, frame: int) -> None:
        """Draw a tick every metre and, where it fits whole, its distance every five, along the lower edge."""
        for at, column in self._ticks(frame, 1.0):
            long = at % 5 == 0
            draw.line(
                (column, SIZE[1] - (8 if long else 4) * OVERSAMPLING, column, SIZE[1]), fill=INK, width=OVERSAMPLING
            )
            if not long:
                continue
            label = _metres(at, 0)
            half = _length(label, 11) / 2
            if half <= column <= SIZE[0] - half:  # "−10 m" cut short is another distance
                _write(draw, (column, SIZE[1] - 9 * OVERSAMPLING), label, 11, anchor="mb")

    def _robot(self, draw: ImageDraw.ImageDraw, frame: int) -> None:
        """Draw links from the last to the root, so that the root lies on top, then the joints."""
        color, paler, edge = robot_colors(self._replay.environment)
        for link in reversed(range(self._edges.shape[1])):
            draw.polygon(self._edges[frame, link].ravel().tolist(), fill=edge)
            draw.polygon(self._insides[frame, link].ravel().tolist(), fill=color if link == 0 else paler)
        for joint in self._joints[frame].tolist():
            _dot(draw, joint, 3.2, WHITE, edge)
        _dot(draw, self._roots[frame].tolist(), 4.6, INK, WHITE)


def _surface(draw: ImageDraw.ImageDraw, row: int, *, dashed: bool) -> None:
    """Draw the medium's surface; that of a medium which is only imagined is dashed."""
    dash, every = (10 * OVERSAMPLING, 16 * OVERSAMPLING) if dashed else (SIZE[0], SIZE[0])
    for left in range(0, SIZE[0], every):
        draw.line((left, row, left + dash, row), fill=SURFACE, width=2 * OVERSAMPLING)


def robot_colors(environment: str) -> tuple[Rgb, Rgb, Rgb]:
    """Give the colours of a root, of the other links and of their edges."""
    color = _color(environment)
    return color, mix(color, WHITE, 0.28), mix(color, INK, 0.55)


def link_outline(pose: Points, length: Points, *, inset: float = 0.0) -> Points:
    """Give the corners of links, rounded, in the world.

    Args:
        pose: (..., 3) x, y of their centres [m], angle [rad].
        length: (...) or what broadcasts to it: their long axes, along their own y [m].
        inset: how far inside the outline to stay [m].

    Returns:
        (..., n_points, 2) x, y [m].
    """
    half_width, half_height = np.maximum(0.5 / length - inset, 0.0), np.maximum(0.5 * length - inset, 0.0)
    radius = np.maximum(0.45 * 0.5 / length - inset, 0.0)
    turn = np.linspace(0, np.pi / 2, 5)
    corners = [
        np.stack(
            [
                across * (half_width - radius)[..., None] + radius[..., None] * np.cos(turn + quarter),
                along * (half_height - radius)[..., None] + radius[..., None] * np.sin(turn + quarter),
            ],
            axis=-1,
        )
        for across, along, quarter in ((1, 1, 0.0), (-1, 1, np.pi / 2), (-1, -1, np.pi), (1, -1, 1.5 * np.pi))
    ]
    x, y = np.moveaxis(np.concatenate(corners, axis=-2), -1, 0)
    cos, sin = np.cos(pose[..., 2, None]), np.sin(pose[..., 2, None])
    return np.stack([pose[..., 0, None] + cos * x - sin * y, pose[..., 1, None] + sin * x + cos * y], axis=-1)


def _joints(replay: Replay, poses: Points) -> Points:
    """Place the joints of links with their parents: (n_pictures, n_links - 1, 2) x, y [m]."""
    parent = replay.parent[1:]
    x, y, angle = np.moveaxis(poses[:, parent], -1, 0)
    along = replay.parent_attachment[1:] * replay.length_scale[parent] / 2
    return np.stack([x - np.sin(angle) * along, y + np.cos(angle) * along], axis=-1)


def _dot(draw: ImageDraw.ImageDraw, place: Sequence[float], radius: float, fill: str | Rgb, edge: str | Rgb) -> None:
    reach = radius * OVERSAMPLING
    box = (place[0] - reach, place[1] - reach, place[0] + reach, place[1] + reach)
    draw.ellipse(box, fill=fill, outline=edge, width=round(1.5 * OVERSAMPLING))


def _strip(replay: Replay) -> Image.Image:
    """Write the title and the world on the left of a plain strip."""
    strip = Image.new("RGB", (SIZE[0], CAPTION_HEIGHT * OVERSAMPLING + 1), WHITE)
    draw = ImageDraw.Draw(strip)
    left = 10 * OVERSAMPLING
    _write(draw, (left, 6 * OVERSAMPLING), replay.title, 14, bold=True, fill=_color(replay.environment))
    _write(draw, (left, 25 * OVERSAMPLING), f"in {replay.world}, {replay.depth:g} m", 12)
    return strip


def _write(
    draw: ImageDraw.ImageDraw,
    place: tuple[float, float],
    text: str,
    size: int,
    *,
    bold: bool = False,
    anchor: str = "la",
    fill: str | Rgb = INK,
) -> None:
    """Write words; an anchor is Pillow's."""
    word, left, top = _word(text, size, bold, anchor)
    draw.bitmap((round(place[0]) + left, round(place[1]) + top), word, fill=fill)


@lru_cache(maxsize=1000)
def _length(text: str, size: int) -> float:
    """Measure a word [pixel]."""
    return float(_font(size).getlength(text))


@lru_cache(maxsize=1000)
def _word(text: str, size: int, bold: bool, anchor: str) -> tuple[Image.Image, int, int]:
    """Draw a word once: how much of each pixel it covers, and where that lies from the anchor."""
    font = _font(size, bold=bold)
    left, top, right, bottom = (math.floor(side) for side in font.getbbox(text, anchor=anchor))
    word = Image.new("L", (right + 1 - left, bottom + 1 - top))
    ImageDraw.Draw(word).text((-left, -top), text, fill=255, font=font, anchor=anchor)
    return word, left, top


def _metres(value: float, digits: int) -> str:
    return f"{value:.{digits}f} m".replace("-", "−")


@cache
def _font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Load DejaVu Sans, which comes with matplotlib and so is the same everywhere."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / name), size * OVERSAMPLING)


def _color(environment: str) -> Rgb:
    colors: dict[str, str] = {name: style.color for name, style in ENVIRONMENTS.items()}
    color = colors.get(environment, UNKNOWN)
    return mix(color, color, 0)


def mix(first: str | Rgb, second: str | Rgb, share: float) -> Rgb:
    """Blend two colours, given as #rrggbb or as numbers."""
    rgb = [
        tuple(int(color[i : i + 2], 16) for i in (1, 3, 5)) if isinstance(color, str) else color
        for color in (first, second)
    ]
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(*rgb, strict=True))
    return red, green, blue
