"""Replays as pictures: a robot in its world, or several above one another at one scale.

Drawn with Pillow at twice the size and reduced. gif.py and mp4.py put the pictures into files.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
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

MARGIN = 0.6
"""Room above and below what the robot reaches [m]."""
VIEW_HEIGHT = (5.5, 15.0)
"""Least and most that a lane shows [m]."""
SMOOTHING = 1.0
"""Half the time over which the camera evens out the robot's way [s]."""
CAPTION_HEIGHT = 44
"""Of the strip at a lane's top where words stand [pixel]."""

SKY, SLUSH, GROUND, INK, FAINT, WHITE = "#f5f8fb", "#bcd9ee", "#8b7d6b", "#1d2129", "#d5dde5", "#ffffff"
SURFACE, GROUND_EDGE, UNKNOWN = "#5d9fcd", "#5f5446", "#566270"
SLUSH_OVER_ROBOT = 0.45
"""How much of a submerged robot's colour the slush in front of it takes."""

Rgb = tuple[int, int, int]
Points = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Camera:
    """What a lane shows: (x, y) [m] to pixels of the oversampled lane."""

    scale: float
    """[pixel/m]"""
    x: Points
    """(n_pictures,) in the middle of the picture [m]."""
    bottom: Points
    """(n_pictures,) y at the lane's lower edge [m]."""

    def project(self, points: Points, frame: int) -> list[tuple[float, float]]:
        column = OVERSAMPLING * WIDTH / 2 + (points[:, 0] - self.x[frame]) * self.scale
        row = OVERSAMPLING * LANE_HEIGHT - (points[:, 1] - self.bottom[frame]) * self.scale
        return list(zip(column.tolist(), row.tolist(), strict=True))


def pictures(replays: Sequence[Replay], fps: float) -> Iterator[Image.Image]:
    """Draw replays above one another, each followed by its own camera, for as long as the longest lasts.

    Args:
        replays: from top to bottom.
        fps: pictures a second.

    Yields:
        RGB, WIDTH by LANE_HEIGHT for each replay.

    Raises:
        ValueError: there are no replays.
    """
    if not replays:
        raise ValueError("a film needs a replay, none came")
    times = np.arange(0.0, max(replay.duration for replay in replays) + 1e-9, 1 / fps)
    poses = [np.stack([replay.at(time) for time in times]) for replay in replays]
    cameras = _cameras(replays, poses, window=round(SMOOTHING * fps))
    for frame, time in enumerate(times):
        picture = Image.new("RGB", (WIDTH * OVERSAMPLING, LANE_HEIGHT * len(replays) * OVERSAMPLING), SKY)
        for lane, (replay, pose, camera) in enumerate(zip(replays, poses, cameras, strict=True)):
            drawn = _lane(replay, pose, camera, frame, min(float(time), replay.duration))
            picture.paste(drawn, (0, lane * LANE_HEIGHT * OVERSAMPLING))
        yield picture.reduce(OVERSAMPLING)


def palette(replays: Sequence[Replay]) -> list[Rgb]:
    """List the colours that are drawn, and what lies halfway between those that meet at an edge."""
    colors = [_mix(flat, flat, 0) for flat in (WHITE, SKY, SLUSH, GROUND, INK, FAINT, SURFACE, GROUND_EDGE, UNKNOWN)]
    colors += [_mix(INK, WHITE, share) for share in (0.25, 0.5, 0.75)]
    edges = ((INK, GROUND), (INK, SLUSH), (GROUND_EDGE, SKY), (SURFACE, SKY), (UNKNOWN, SKY))
    colors += [_mix(one, other, 0.5) for one, other in edges]
    colors += [_mix(color, SLUSH, SLUSH_OVER_ROBOT) for color in (INK, WHITE, UNKNOWN, FAINT)]
    for environment in sorted({replay.environment for replay in replays}):
        color, paler, edge = _robot_colors(environment)
        dry = [color, paler, edge, _mix(edge, paler, 0.5), _mix(edge, SKY, 0.5)]
        colors += [*dry, _mix(color, WHITE, 0.6), *(_mix(part, SLUSH, SLUSH_OVER_ROBOT) for part in dry)]
    return list(dict.fromkeys(colors))


def _cameras(replays: Sequence[Replay], poses: Sequence[Points], *, window: int) -> list[_Camera]:
    """Choose one scale for all lanes, and a camera for each that follows its robot, evened out over a window."""
    extents = [_vertical_extent(replay, pose) for replay, pose in zip(replays, poses, strict=True)]
    height = float(np.clip(max(high - low for low, high in extents) + 2 * MARGIN, *VIEW_HEIGHT))
    scale = OVERSAMPLING * (LANE_HEIGHT - CAPTION_HEIGHT) / height
    cameras = []
    for replay, pose, (low, high) in zip(replays, poses, extents, strict=True):
        center = _smooth(pose[:, :, :2].mean(axis=1), window)
        fits = high - low + 2 * MARGIN <= height  # then the camera moves sideways alone
        if low <= -replay.depth:
            bottom = np.full(len(pose), low - MARGIN) if fits else np.maximum(center[:, 1] - height / 2, low - MARGIN)
        else:
            bottom = np.full(len(pose), (low + high - height) / 2) if fits else center[:, 1] - height / 2
        # Whole pixels alone, so that scenery keeps its edges from frame to frame and the file stays small.
        pixel = OVERSAMPLING / scale
        x, bottom = (np.rint(place / pixel) * pixel for place in (center[:, 0], bottom))
        cameras.append(_Camera(scale=scale, x=x, bottom=bottom))
    return cameras


def _vertical_extent(replay: Replay, pose: Points) -> tuple[float, float]:
    """Lowest and highest y [m] that the links reach, with the slush's surface or the ground where they are near."""
    reach = np.abs(np.cos(pose[:, :, 2])) * replay.length_scale / 2
    low, high = float((pose[:, :, 1] - reach).min()), float((pose[:, :, 1] + reach).max())
    if replay.has_medium:
        low, high = min(low, -1.0), max(high, 0.5)
    return (min(low, -replay.depth - 0.4), high) if low < -replay.depth + 2.0 else (low, high)


def _smooth(path: Points, window: int) -> Points:
    """Average a path (n_frames, 2) over as much of a window to either side as both sides have, so it never lags."""
    sums = np.concatenate([np.zeros((1, 2)), np.cumsum(path, axis=0)])
    frame = np.arange(len(path))
    reach = np.minimum(window, np.minimum(frame, len(path) - 1 - frame))
    return np.asarray((sums[frame + reach + 1] - sums[frame - reach]) / (2 * reach + 1)[:, None])


# -- one robot's part of one frame ------------------------------------------------------------------------------------


def _lane(replay: Replay, poses: Points, camera: _Camera, frame: int, time: float) -> Image.Image:
    size = (WIDTH * OVERSAMPLING, LANE_HEIGHT * OVERSAMPLING)
    surface = camera.project(np.zeros((1, 2)), frame)[0][1]
    ground = camera.project(np.array([[0.0, -replay.depth]]), frame)[0][1]
    start = float(poses[0, 0, 0])
    picture = Image.new("RGB", size, SKY)
    draw = ImageDraw.Draw(picture)
    top = min(max(round(surface), 0), size[1])
    if replay.has_medium:
        draw.rectangle((0, top, *size), fill=SLUSH)
    _distances(draw, camera, frame, start, size)
    _robot(draw, replay, poses[frame], camera, frame)
    if replay.has_medium and top < size[1]:
        below = picture.crop((0, top, *size))
        veil = Image.new("RGB", below.size, SLUSH)
        picture.paste(Image.blend(below, veil, SLUSH_OVER_ROBOT), (0, top))
        _surface(draw, top, size, dashed=replay.imagined)
    if ground < size[1]:
        draw.rectangle((0, ground, *size), fill=GROUND)
        draw.line((0, ground, size[0], ground), fill=GROUND_EDGE, width=2 * OVERSAMPLING)
    _scale(draw, camera, frame, start, size)
    _caption(draw, replay, float(poses[frame, 0, 0]) - start, time, size)
    draw.line((0, size[1] - 1, size[0], size[1] - 1), fill=WHITE, width=2 * OVERSAMPLING)
    return picture


def _surface(draw: ImageDraw.ImageDraw, row: int, size: tuple[int, int], *, dashed: bool) -> None:
    """Draw the medium's surface; that of a medium which is only imagined is dashed."""
    dash, every = (10 * OVERSAMPLING, 16 * OVERSAMPLING) if dashed else (size[0], size[0])
    for left in range(0, size[0], every):
        draw.line((left, row, left + dash, row), fill=SURFACE, width=2 * OVERSAMPLING)


def _ticks(camera: _Camera, frame: int, start: float, every: float) -> list[tuple[float, float]]:
    """Distances from the start [m] that are in view, and their columns."""
    half = OVERSAMPLING * WIDTH / 2 / camera.scale
    first = math.ceil((camera.x[frame] - half - start) / every)
    last = math.floor((camera.x[frame] + half - start) / every)
    distances = [every * number for number in range(first, last + 1)]
    return [(at, camera.project(np.array([[start + at, 0.0]]), frame)[0][0]) for at in distances]


def _distances(draw: ImageDraw.ImageDraw, camera: _Camera, frame: int, start: float, size: tuple[int, int]) -> None:
    """Draw an upright line every 5 m, so that motion shows where nothing else is near; the start's is darker."""
    for at, column in _ticks(camera, frame, start, 5.0):
        color = UNKNOWN if at == 0 else FAINT
        draw.line((column, CAPTION_HEIGHT * OVERSAMPLING, column, size[1]), fill=color, width=OVERSAMPLING)


def _scale(draw: ImageDraw.ImageDraw, camera: _Camera, frame: int, start: float, size: tuple[int, int]) -> None:
    """Draw a tick every metre and, where it fits whole, its distance every five, along the lower edge."""
    font = _font(11)
    for at, column in _ticks(camera, frame, start, 1.0):
        long = at % 5 == 0
        draw.line(
            (column, size[1] - (8 if long else 4) * OVERSAMPLING, column, size[1]), fill=INK, width=OVERSAMPLING
        )
        if not long:
            continue
        label = _metres(at, 0)
        half = font.getlength(label) / 2
        if half <= column <= size[0] - half:  # "−10 m" cut short is another distance
            draw.text((column, size[1] - 9 * OVERSAMPLING), label, fill=INK, font=font, anchor="mb")


def _robot(draw: ImageDraw.ImageDraw, replay: Replay, pose: Points, camera: _Camera, frame: int) -> None:
    """Draw links from the last to the root, so that the root lies on top, then the joints."""
    color, paler, edge = _robot_colors(replay.environment)
    for link in reversed(range(len(pose))):
        outline = camera.project(link_outline(pose[link], float(replay.length_scale[link])), frame)
        draw.polygon(outline, fill=color if link == 0 else paler, outline=edge, width=2 * OVERSAMPLING)
    for link in range(1, len(pose)):
        _dot(draw, camera.project(_joint(replay, pose, link)[None], frame)[0], 3.2, WHITE, edge)
    root = camera.project(pose[:1, :2], frame)[0]
    _dot(draw, root, 4.6, INK, WHITE)


def _robot_colors(environment: str) -> tuple[Rgb, Rgb, Rgb]:
    """Give the colours of a root, of the other links and of their edges."""
    color = _color(environment)
    return color, _mix(color, WHITE, 0.28), _mix(color, INK, 0.55)


def link_outline(pose: Points, length: float) -> Points:
    """Give the corners of a link, rounded, in the world.

    Args:
        pose: (3,) x, y of its centre [m], angle [rad].
        length: its long axis, along its own y [m].

    Returns:
        (n_points, 2) x, y [m].
    """
    half_width, half_height = 0.5 / length, 0.5 * length
    radius = 0.45 * half_width
    turn = np.linspace(0, np.pi / 2, 5)
    corners = [
        np.stack(
            [
                across * (half_width - radius) + radius * np.cos(turn + quarter),
                along * (half_height - radius) + radius * np.sin(turn + quarter),
            ],
            axis=1,
        )
        for across, along, quarter in ((1, 1, 0.0), (-1, 1, np.pi / 2), (-1, -1, np.pi), (1, -1, 1.5 * np.pi))
    ]
    local = np.concatenate(corners)
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(pose[:2] + local @ np.array([[cos, sin], [-sin, cos]]))


def _joint(replay: Replay, pose: Points, link: int) -> Points:
    """Place the joint of a link with its parent: (2,) x, y [m]."""
    parent = int(replay.parent[link])
    x, y, angle = pose[parent]
    along = float(replay.parent_attachment[link]) * float(replay.length_scale[parent]) / 2
    return np.array([x - np.sin(angle) * along, y + np.cos(angle) * along])


def _dot(
    draw: ImageDraw.ImageDraw, place: tuple[float, float], radius: float, fill: str | Rgb, edge: str | Rgb
) -> None:
    reach = radius * OVERSAMPLING
    box = (place[0] - reach, place[1] - reach, place[0] + reach, place[1] + reach)
    draw.ellipse(box, fill=fill, outline=edge, width=round(1.5 * OVERSAMPLING))


def _caption(draw: ImageDraw.ImageDraw, replay: Replay, moved: float, time: float, size: tuple[int, int]) -> None:
    """Write the title and the world on the left, the displacement and the time on the right, over a plain strip."""
    edge = 10 * OVERSAMPLING
    draw.rectangle((0, 0, size[0], CAPTION_HEIGHT * OVERSAMPLING), fill=WHITE)
    draw.text((edge, 6 * OVERSAMPLING), replay.title, fill=_color(replay.environment), font=_font(14, bold=True))
    draw.text((edge, 25 * OVERSAMPLING), f"in {replay.world}, {replay.depth:g} m", fill=INK, font=_font(12))
    right = size[0] - edge
    draw.text((right, 6 * OVERSAMPLING), _metres(moved, 1), fill=INK, font=_font(14, bold=True), anchor="ra")
    draw.text((right, 25 * OVERSAMPLING), f"{time:.1f} s", fill=INK, font=_font(12), anchor="ra")


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
    return _mix(color, color, 0)


def _mix(first: str | Rgb, second: str | Rgb, share: float) -> Rgb:
    """Blend two colours, given as #rrggbb or as numbers."""
    rgb = [
        tuple(int(color[i : i + 2], 16) for i in (1, 3, 5)) if isinstance(color, str) else color
        for color in (first, second)
    ]
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(*rgb, strict=True))
    return red, green, blue
