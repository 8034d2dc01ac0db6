"""The check film: a video with the outlines of the bars where tracking found them."""

from pathlib import Path

import numpy as np

from pipeline.bench.vision.track_video import VideoTracks
from pipeline.bench.vision.video import Picture, film, frames
from tasks.arrays import Float64

_WIDTH = 960  # at most [px]
_WATER, _OUTLINES = (200, 120, 30), ((60, 60, 230), (40, 160, 40), (200, 60, 160), (20, 140, 230))  # blue, green, red
_TRAIL = 40  # frames of the path that are drawn behind a bar


def write_check_film(path: Path, video: VideoTracks) -> None:
    """Write the film of a video as MP4."""
    import cv2

    plane = video.plane
    shrink = min(1.0, _WIDTH / video.size[0])
    size = tuple(round(side * shrink / 2) * 2 for side in video.size)
    edges = plane.metres(np.array([[0.0, 0.0], [0.0, video.size[1]], [video.size[0], 0.0], video.size]))[:, 0]
    water = np.column_stack((np.linspace(edges.min(), edges.max(), 100), np.zeros(100)))
    rows = [{int(frame): i for i, frame in enumerate(track.frame)} for track in video.tracks]

    def line(picture: Picture, points: Float64, colour: tuple[int, ...], *, closed: bool, width: int = 1) -> None:
        at = np.round(plane.pixels(points) * shrink * 16).astype(np.int32)
        cv2.polylines(picture, [at], closed, colour, width, cv2.LINE_AA, 4)

    with film(path, width=size[0], height=size[1], rate=video.rate) as add:
        for frame in frames(video.path, colour=True):
            picture = cv2.resize(frame.picture, size, interpolation=cv2.INTER_AREA)
            line(picture, water, _WATER, closed=False)
            for track, row in zip(video.tracks, rows, strict=True):
                if frame.index not in row:
                    continue
                at, colour = row[frame.index], _OUTLINES[track.throw % len(_OUTLINES)]
                x, y, angle = track.pose[at]
                half = np.array([track.bar.width, track.bar.length]) / 2
                corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
                turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
                line(picture, corners @ turn + (x, y), colour, closed=True, width=2)
                line(picture, track.pose[max(0, at - _TRAIL) : at + 1, :2], colour, closed=False)
                u, v = (plane.pixels(np.array([[x, y]]))[0] * shrink).astype(int).tolist()
                cv2.putText(picture, f"{track.throw}", (u + 8, v - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 2)
            add(picture)
