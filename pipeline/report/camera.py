"""The cameras of a film: where each looks at every picture, at one scale for all robots."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.report.replay import STEPS_PER_FRAME, STEPS_PER_SECOND, Replay
from tasks.arrays import Float64

FILM_FPS = STEPS_PER_SECOND // STEPS_PER_FRAME  # pictures per second: every frame of a replay

PICTURE_WIDTH = 640  # width of a picture [pixel]; multiples of 128 leave an MP4's planes without padding, see films.py
LANE_HEIGHT = 240  # height of each robot's part of the picture [pixel]
CAPTION_HEIGHT = 44  # height of the caption at the top of a lane [pixel]
ZOOM = 2  # pixels drawn per pixel of the picture, in each direction, to smooth edges
LANE_SIZE = PICTURE_WIDTH * ZOOM, LANE_HEIGHT * ZOOM  # width and height of a lane as drawn [pixel]

_MARGIN = 0.6  # space above and below what the robot reaches [m]
_VIEW_HEIGHT = (5.5, 15.0)  # least and greatest height that a lane shows [m]
_SMOOTHING = 1.0  # half of the time over which the camera averages the robot's position [s]


@dataclass(frozen=True, eq=False)
class Camera:
    """The view of a lane: maps (x, y) [m] to pixels of the lane as drawn."""

    scale: float  # [pixel/m]
    x: Float64  # (n_pictures,) x at the centre of the picture [m]
    bottom: Float64  # (n_pictures,) y at the lower edge of the lane [m]

    def project(self, points: Float64) -> Float64:
        """Map (n_pictures, ..., 2) x, y [m] to columns and rows."""
        over_all = (slice(None), *[None] * (points.ndim - 2))
        column = LANE_SIZE[0] / 2 + (points[..., 0] - self.x[over_all]) * self.scale
        row = LANE_SIZE[1] - (points[..., 1] - self.bottom[over_all]) * self.scale
        return np.stack([column, row], axis=-1)


def cameras(replays: Sequence[Replay], poses: Sequence[Float64]) -> list[Camera]:
    """Return a camera for each replay that follows its robot, all at the same scale.

    Poses are (n_pictures, n_links, 3) x, y [m], angle [rad], one array per replay.
    """
    extents = [_vertical_extent(replay, pose) for replay, pose in zip(replays, poses, strict=True)]
    height = float(np.clip(max(high - low for low, high in extents) + 2 * _MARGIN, *_VIEW_HEIGHT))
    scale = ZOOM * (LANE_HEIGHT - CAPTION_HEIGHT) / height
    found = []
    for replay, pose, (low, high) in zip(replays, poses, extents, strict=True):
        center = _smooth(pose[:, :, :2].mean(axis=1), round(_SMOOTHING * FILM_FPS))
        fits = high - low + 2 * _MARGIN <= height  # then the camera only moves sideways
        if low <= -replay.depth:
            bottom = np.full(len(pose), low - _MARGIN) if fits else np.maximum(center[:, 1] - height / 2, low - _MARGIN)
        else:
            bottom = np.full(len(pose), (low + high - height) / 2) if fits else center[:, 1] - height / 2
        # Whole pixels only, so that scenery keeps its edges from frame to frame and the file stays small.
        pixel = ZOOM / scale
        x, bottom = (np.rint(place / pixel) * pixel for place in (center[:, 0], bottom))
        found.append(Camera(scale=scale, x=x, bottom=bottom))
    return found


def _vertical_extent(replay: Replay, pose: Float64) -> tuple[float, float]:
    """Return the lowest and highest y [m] of the links, including the surface or the ground where they are near."""
    reach = np.abs(np.cos(pose[:, :, 2])) * replay.length_scale / 2
    low, high = float((pose[:, :, 1] - reach).min()), float((pose[:, :, 1] + reach).max())
    if replay.has_medium:
        low, high = min(low, -1.0), max(high, 0.5)
    return (min(low, -replay.depth - 0.4), high) if low < -replay.depth + 2.0 else (low, high)


def _smooth(path: Float64, window: int) -> Float64:
    """Average a path (n_frames, 2) over a window that is equally long on both sides, so that it never lags."""
    sums = np.concatenate([np.zeros((1, 2)), np.cumsum(path, axis=0)])
    frame = np.arange(len(path))
    reach = np.minimum(window, np.minimum(frame, len(path) - 1 - frame))
    return np.asarray((sums[frame + reach + 1] - sums[frame - reach]) / (2 * reach + 1)[:, None])
