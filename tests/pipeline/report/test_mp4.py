from __future__ import annotations

import io
from dataclasses import replace

import av
import numpy as np
import pytest

from pipeline.report.film import FPS, pictures
from pipeline.report.mp4 import render_mp4
from pipeline.report.robot_view import LANE_HEIGHT, WIDTH


def read(data: bytes) -> tuple[av.video.VideoStream, list[np.ndarray]]:
    """The stream of a film, and its pictures, (height, width, 3)."""
    with av.open(io.BytesIO(data)) as container:
        (stream,) = container.streams
        return stream, [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]


def test_a_film_is_what_browsers_and_slides_play(slush_replay, dry_replay):
    data = render_mp4([slush_replay, dry_replay])
    stream, shown = read(data)
    assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
    assert (stream.width, stream.height) == (WIDTH, 2 * LANE_HEIGHT)
    assert stream.average_rate == FPS
    assert len(shown) == stream.frames == int(slush_replay.duration * FPS) + 1  # the longer of the two
    assert float(stream.duration * stream.time_base) == pytest.approx(len(shown) / FPS)
    assert data.index(b"moov") < data.index(b"mdat")  # the index comes first, so that a browser begins at once


def test_it_shows_the_pictures_that_were_drawn_and_they_move(slush_replay):
    """Flat areas keep their colour to 2 of 255, which is what studio range leaves; edges blur, chroma being halved."""
    _, shown = read(render_mp4([slush_replay]))
    drawn = [np.asarray(picture) for picture in pictures([slush_replay])]
    assert len(shown) == len(drawn)
    for one, other in zip(shown[:: FPS // 2], drawn[:: FPS // 2], strict=True):
        off = np.abs(one.astype(int) - other).max(axis=2)
        assert np.median(off) <= 2 and off.mean() < 4
    moved = np.abs(shown[0].astype(int) - shown[-1]).max(axis=2) > 60
    assert moved.sum() > 500


def test_the_same_bytes_each_time(slush_replay, dry_replay):
    """Between the films memory is filled with other things, which once came through."""
    short, other = (replace(replay, frames=replay.frames[:12]) for replay in (slush_replay, dry_replay))
    first = render_mp4([short])
    for _ in range(25):
        render_mp4([other])
        assert render_mp4([short]) == first


def test_twenty_seconds_take_a_few_hundred_kilobytes(slush_replay):
    """Rocking back and forth while it goes 12 m in 20 s, so that robot and scenery differ in every picture."""
    there = slush_replay.frames
    frames = np.resize(np.concatenate([there, there[::-1]]), (601, 6, 3))
    frames[:, :, 0] += np.linspace(0, 12, 601)[:, None]
    assert len(render_mp4([replace(slush_replay, frames=frames)])) < 500_000


def test_nothing_to_film():
    with pytest.raises(ValueError, match="needs a replay"):
        render_mp4([])
