"""Replays as pictures: a robot in its world, or several above one another at one scale.

lane.py draws each robot's part. gif.py and mp4.py put the pictures into files, and films.py into both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image

from pipeline.report.replay import STEPS_PER_FRAME, STEPS_PER_SECOND, Replay
from pipeline.report.robot_view import (
    CAPTION_HEIGHT,
    FAINT,
    GROUND,
    GROUND_EDGE,
    INK,
    LANE_HEIGHT,
    OVERSAMPLING,
    SKY,
    SLUSH,
    SLUSH_OVER_ROBOT,
    SURFACE,
    UNKNOWN,
    WHITE,
    WIDTH,
    Camera,
    Lane,
    Points,
    Rgb,
    mix,
    robot_colors,
)

FPS = STEPS_PER_SECOND // STEPS_PER_FRAME
"""Pictures a second: all that a replay has."""

MARGIN = 0.6
"""Room above and below what the robot reaches [m]."""
VIEW_HEIGHT = (5.5, 15.0)
"""Least and most that a lane shows [m]."""
SMOOTHING = 1.0
"""Half the time over which the camera evens out the robot's way [s]."""


def pictures(replays: Sequence[Replay], *, every: int = 1) -> Iterator[Image.Image]:
    """Draw replays above one another, each followed by its own camera, for as long as the longest lasts.

    Args:
        replays: from top to bottom.
        every: of how many pictures, FPS a second, one is drawn.

    Yields:
        RGB, WIDTH by LANE_HEIGHT for each replay.

    Raises:
        ValueError: there are no replays.
    """
    if not replays:
        raise ValueError("a film needs a replay, none came")
    times = np.arange(0.0, max(replay.duration for replay in replays) + 1e-9, 1 / FPS)
    poses = [np.stack([replay.at(time) for time in times]) for replay in replays]
    cameras = _cameras(replays, poses, window=round(SMOOTHING * FPS))
    lanes = [Lane(*of_one) for of_one in zip(replays, poses, cameras, strict=True)]
    for frame in range(0, len(times), every):
        picture = Image.new("RGB", (WIDTH, LANE_HEIGHT * len(replays)))
        for number, (replay, lane) in enumerate(zip(replays, lanes, strict=True)):
            picture.paste(lane.draw(frame, min(float(times[frame]), replay.duration)), (0, number * LANE_HEIGHT))
        yield picture


def palette(replays: Sequence[Replay]) -> list[Rgb]:
    """List the colours that are drawn, and what lies halfway between those that meet at an edge."""
    colors = [mix(flat, flat, 0) for flat in (WHITE, SKY, SLUSH, GROUND, INK, FAINT, SURFACE, GROUND_EDGE, UNKNOWN)]
    colors += [mix(INK, WHITE, share) for share in (0.25, 0.5, 0.75)]
    edges = ((INK, GROUND), (INK, SLUSH), (GROUND_EDGE, SKY), (SURFACE, SKY), (UNKNOWN, SKY))
    colors += [mix(one, other, 0.5) for one, other in edges]
    colors += [mix(color, SLUSH, SLUSH_OVER_ROBOT) for color in (INK, WHITE, UNKNOWN, FAINT)]
    for environment in sorted({replay.environment for replay in replays}):
        color, paler, edge = robot_colors(environment)
        dry = [color, paler, edge, mix(edge, paler, 0.5), mix(edge, SKY, 0.5)]
        colors += [*dry, mix(color, WHITE, 0.6), *(mix(part, SLUSH, SLUSH_OVER_ROBOT) for part in dry)]
    return list(dict.fromkeys(colors))


def _cameras(replays: Sequence[Replay], poses: Sequence[Points], *, window: int) -> list[Camera]:
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
        cameras.append(Camera(scale=scale, x=x, bottom=bottom))
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
