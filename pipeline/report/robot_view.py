"""One robot in its environment, picture by picture: a lane of a film.

Drawn with Pillow at ZOOM times the size and reduced. Positions are computed for all pictures at once.
"""

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pipeline.report.camera import CAPTION_HEIGHT, LANE_SIZE, ZOOM, Camera
from pipeline.report.drawing import INK
from pipeline.report.replay import Replay
from tasks.arrays import Float64

SKY, SLUSH, GROUND_FILL, GROUND_EDGE, SURFACE = "#f5f8fb", "#bcd9ee", "#8b7d6b", "#5f5446", "#5d9fcd"
DISTANCE_LINE, UNKNOWN, WHITE = "#d5dde5", "#566270", "#ffffff"
SLUSH_OVER_ROBOT = 0.45  # opacity of the slush in front of a submerged robot

_EDGE = 1.75 * ZOOM  # width of a link's edge as drawn [pixel]

Rgb = tuple[int, int, int]


class Lane:
    """A robot in its environment, ready to be drawn at each of its poses."""

    def __init__(self, replay: Replay, poses: Float64, camera: Camera) -> None:
        """Project everything for all pictures; poses are (n_pictures, n_links, 3) x, y [m], angle [rad]."""
        self._replay, self._camera = replay, camera
        self._start = float(poses[0, 0, 0])
        self._moved = poses[:, 0, 0] - self._start
        length = replay.length_scale
        self._edges = camera.project(link_outline(poses, length))
        self._insides = camera.project(link_outline(poses, length, inset=_EDGE / camera.scale))
        self._joints = camera.project(_joints(replay, poses))
        self._roots = camera.project(poses[:, 0, :2])
        zero = np.zeros(len(poses))
        self._surface = camera.project(np.stack([zero, zero], axis=1))[:, 1]
        self._ground = camera.project(np.stack([zero, zero - replay.depth], axis=1))[:, 1]
        self._strip = _strip(replay)

    def draw(self, frame: int, time: float) -> Image.Image:
        """Draw one picture, PICTURE_WIDTH by LANE_HEIGHT, with a time [s] on it."""
        picture = Image.new("RGB", LANE_SIZE, SKY)
        draw = ImageDraw.Draw(picture)
        top = min(max(round(float(self._surface[frame])), 0), LANE_SIZE[1]) if self._replay.has_medium else LANE_SIZE[1]
        if top < LANE_SIZE[1]:
            draw.rectangle((0, top, *LANE_SIZE), fill=SLUSH)
        for at, column in self._ticks(frame, 5.0):  # lines make motion visible; that of the start is darker
            color = UNKNOWN if at == 0 else DISTANCE_LINE
            draw.line((column, CAPTION_HEIGHT * ZOOM, column, LANE_SIZE[1]), fill=color, width=ZOOM)
        self._robot(draw, frame)
        if top < LANE_SIZE[1]:
            submerged = picture.crop((0, top, *LANE_SIZE))
            picture.paste(Image.blend(submerged, Image.new("RGB", submerged.size, SLUSH), SLUSH_OVER_ROBOT), (0, top))
            _surface(draw, top, dashed=self._replay.hallucinated)
        ground = float(self._ground[frame])
        if ground < LANE_SIZE[1]:
            draw.rectangle((0, ground, *LANE_SIZE), fill=GROUND_FILL)
            draw.line((0, ground, LANE_SIZE[0], ground), fill=GROUND_EDGE, width=2 * ZOOM)
        self._scale(draw, frame)
        picture.paste(self._strip, (0, 0))
        right = LANE_SIZE[0] - 10 * ZOOM
        _write(draw, (right, 6 * ZOOM), _metres(float(self._moved[frame]), 1), 14, bold=True, anchor="ra")
        _write(draw, (right, 25 * ZOOM), f"{time:.1f} s", 12, anchor="ra")
        draw.line((0, LANE_SIZE[1] - 1, LANE_SIZE[0], LANE_SIZE[1] - 1), fill=WHITE, width=2 * ZOOM)
        return picture.reduce(ZOOM)

    def _ticks(self, frame: int, every: float) -> list[tuple[float, float]]:
        """Return the distances from the start [m] that are in view, with their columns."""
        camera, x = self._camera, float(self._camera.x[frame])
        half = LANE_SIZE[0] / 2 / camera.scale
        first = math.ceil((x - half - self._start) / every)
        last = math.floor((x + half - self._start) / every)
        distances = [every * number for number in range(first, last + 1)]
        return [(at, LANE_SIZE[0] / 2 + (self._start + at - x) * camera.scale) for at in distances]

    def _scale(self, draw: ImageDraw.ImageDraw, frame: int) -> None:
        """Draw a scale along the lower edge: a tick every metre, and a label every five where it fits."""
        for at, column in self._ticks(frame, 1.0):
            long = at % 5 == 0
            draw.line((column, LANE_SIZE[1] - (8 if long else 4) * ZOOM, column, LANE_SIZE[1]), fill=INK, width=ZOOM)
            if not long:
                continue
            label = _metres(at, 0)
            half = _font(11).getlength(label) / 2
            if half <= column <= LANE_SIZE[0] - half:  # a label that is cut off would be a wrong distance
                _write(draw, (column, LANE_SIZE[1] - 9 * ZOOM), label, 11, anchor="mb")

    def _robot(self, draw: ImageDraw.ImageDraw, frame: int) -> None:
        """Draw the links from the last to the root, so that the root is on top, then the joints."""
        color, paler, edge = robot_colors(self._replay.color)
        for link in reversed(range(self._edges.shape[1])):
            draw.polygon(self._edges[frame, link].ravel().tolist(), fill=edge)
            draw.polygon(self._insides[frame, link].ravel().tolist(), fill=color if link == 0 else paler)
        for joint in self._joints[frame].tolist():
            _dot(draw, joint, 3.2, WHITE, edge)
        _dot(draw, self._roots[frame].tolist(), 4.6, INK, WHITE)


def _surface(draw: ImageDraw.ImageDraw, row: int, *, dashed: bool) -> None:
    """Draw the surface of the medium, dashed if the medium is hallucinated."""
    dash, every = (10 * ZOOM, 16 * ZOOM) if dashed else (LANE_SIZE[0], LANE_SIZE[0])
    for left in range(0, LANE_SIZE[0], every):
        draw.line((left, row, left + dash, row), fill=SURFACE, width=2 * ZOOM)


def robot_colors(color: str) -> tuple[Rgb, Rgb, Rgb]:
    """Return the colours of the root, of the other links and of their edges."""
    return mix(color, color, 0), mix(color, WHITE, 0.28), mix(color, INK, 0.55)


def link_outline(pose: Float64, length: Float64, *, inset: float = 0.0) -> Float64:
    """Return the outlines of links with rounded corners: (..., n_points, 2) x, y [m].

    Args:
        pose: (..., 3) x, y of their centres [m], angle [rad].
        length: (...) or broadcastable to it, their long axes along their own y [m].
        inset: distance inside the outline [m].
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


def _joints(replay: Replay, poses: Float64) -> Float64:
    """Return the joints of links with their parents: (n_pictures, n_links - 1, 2) x, y [m]."""
    parent = replay.parent[1:]
    x, y, angle = np.moveaxis(poses[:, parent], -1, 0)
    along = replay.parent_attachment[1:] * replay.length_scale[parent] / 2
    return np.stack([x - np.sin(angle) * along, y + np.cos(angle) * along], axis=-1)


def _dot(draw: ImageDraw.ImageDraw, place: Sequence[float], radius: float, fill: str | Rgb, edge: str | Rgb) -> None:
    reach = radius * ZOOM
    box = (place[0] - reach, place[1] - reach, place[0] + reach, place[1] + reach)
    draw.ellipse(box, fill=fill, outline=edge, width=round(1.5 * ZOOM))


def _strip(replay: Replay) -> Image.Image:
    """Draw the caption: the title, and where the robot is seen."""
    strip = Image.new("RGB", (LANE_SIZE[0], CAPTION_HEIGHT * ZOOM + 1), WHITE)
    draw = ImageDraw.Draw(strip)
    left = 10 * ZOOM
    _write(draw, (left, 6 * ZOOM), replay.title, 14, bold=True, fill=replay.color)
    _write(draw, (left, 25 * ZOOM), f"in {replay.seen_in}, {replay.depth:g} m", 12)
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
    """Write text; the anchor is one of Pillow's."""
    draw.text((round(place[0]), round(place[1])), text, fill=fill, font=_font(size, bold=bold), anchor=anchor)


def _metres(value: float, digits: int) -> str:
    return f"{value:.{digits}f} m".replace("-", "−")


@cache
def _font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Load DejaVu Sans, which matplotlib contains and is therefore the same everywhere."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / name), size * ZOOM)


def mix(first: str | Rgb, second: str | Rgb, share: float) -> Rgb:
    """Return a blend of two colours, given as #rrggbb or as numbers.

    Args:
        first: result for a share of 0.
        second: result for a share of 1.
        share: 0 to 1.
    """
    rgb = [
        tuple(int(color[i : i + 2], 16) for i in (1, 3, 5)) if isinstance(color, str) else color
        for color in (first, second)
    ]
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(*rgb, strict=True))
    return red, green, blue
