"""Films as GIF and MP4: what they show, that they stay small, and that their bytes are always the same."""

from __future__ import annotations

import io
from dataclasses import replace

import av
import numpy as np
import pytest
from PIL import Image, ImageColor

from pipeline.report import films
from pipeline.report.films import LANE_HEIGHT, PICTURE_WIDTH, SLUSH, pictures, render_gif, render_mp4
from pipeline.report.palette import LOOKS
from pipeline.report.replay import FILM_FPS, link_corners
from tasks.world.medium import Scene

pytestmark = pytest.mark.slow


def count(picture, color, tolerance=0):
    rgb = ImageColor.getrgb(color) if isinstance(color, str) else color
    return int((np.abs(np.asarray(picture.convert("RGB")).astype(int) - rgb) <= tolerance).all(axis=2).sum())


def blend(first, second, share):
    return np.array(ImageColor.getrgb(first)) * (1 - share) + np.array(ImageColor.getrgb(second)) * share


def test_two_robots_above_one_another(slush_replay, dry_replay):
    color = LOOKS["dry_land"].color
    picture = Image.open(io.BytesIO(render_gif([slush_replay, replace(dry_replay, color=color)])))
    assert picture.size == (PICTURE_WIDTH, 2 * LANE_HEIGHT)
    assert picture.n_frames == int(slush_replay.duration * FILM_FPS / films.GIF_EVERY) + 1  # the longer of the two
    assert (picture.info["duration"], picture.info["loop"]) == (1000 * films.GIF_EVERY / FILM_FPS, 0)
    upper, lower = (picture.crop((0, top, PICTURE_WIDTH, top + LANE_HEIGHT)) for top in (0, LANE_HEIGHT))
    assert count(upper, SLUSH, 3) > 0.2 * PICTURE_WIDTH * LANE_HEIGHT and count(lower, SLUSH, 3) == 0
    assert count(lower, films.GROUND, 3) > 0.05 * PICTURE_WIDTH * LANE_HEIGHT
    assert count(upper, films.SKY, 3) > 0 < count(lower, films.SKY, 3) and count(lower, color, 9) > 200


def test_slush_lies_over_the_robot(slush_replay):
    """A robot at rest, upright and half under slush."""
    frames = np.tile([0.0, 0.3, 0.0], (3, 6, 1))
    color = LOOKS["dry_land"].color
    picture = next(pictures([replace(slush_replay, frames=frames, length_scale=np.full(6, 2.0), color=color)]))
    assert count(picture, color) > 100 < count(picture, blend(color, SLUSH, 0.45), 2)


def test_water_shows_its_waves_and_particles(slush_replay):
    """A trough of 1 m on the left half and a crest on the right, of a flume that is narrower than the picture."""
    x = np.linspace(-4, 4, 81)
    waves = Scene(np.stack((x, np.sign(x)), axis=1), np.array([[0.0, -1.8], [2.0, -1.8]]), 8.0)
    frames = np.tile([0.0, 6.0, 0.0], (3, 6, 1))
    picture = next(pictures([replace(slush_replay, frames=frames, depth=9.0, scenes=[waves] * 3)]))
    trough, crest = (
        count(picture.crop((left, 0, left + 10, LANE_HEIGHT)), SLUSH, 3)
        for left in (PICTURE_WIDTH // 2 + d for d in (-20, 10))
    )
    assert crest > trough + 200
    assert count(picture, blend(films.PARTICLE, SLUSH, 0.45), 20) > 10


def test_hallucinated_slush_has_a_dashed_surface(slush_replay):
    """Dashes of 4 line widths in 7."""
    real, hallucinated = (
        count(next(pictures([replace(slush_replay, hallucinated=hallucinated)])), films.SURFACE, 9)
        for hallucinated in (False, True)
    )
    assert real >= 0.8 * PICTURE_WIDTH and hallucinated / real == pytest.approx(4 / 7, abs=0.1)


def test_the_camera_keeps_a_robot_in_view_however_far_and_high_it_goes(dry_replay):
    frames = dry_replay.frames[:9] + np.linspace([0.0, 0.0, 0.0], [200.0, 60.0, 0.0], 9)[:, None]
    *_, last = pictures([replace(dry_replay, frames=frames, environment="", title="<b>Ê′ – Ẽ</b>" * 9)])
    body, color = last.crop((0, 50, PICTURE_WIDTH, LANE_HEIGHT)), dry_replay.color
    assert count(body, color) + count(body, blend(color, "#ffffff", 0.28), 2) > 100


def test_no_distance_is_cut_at_the_edge(slush_replay):
    """The camera passes 6 m in 60 pictures: marks leave on the left, and no ink of a label touches the edge."""
    frames = np.resize(slush_replay.frames[:1], (180, 6, 3))
    frames[:, :, 0] += np.linspace(0, 6, 180)[:, None]
    labels, edges, drawn = 0, 0, list(pictures([replace(slush_replay, frames=frames)], every=3))
    for picture in drawn:
        dark = np.asarray(picture)[LANE_HEIGHT - 28 : LANE_HEIGHT - 12].astype(int).sum(axis=2) < 300
        labels, edges = labels + dark.sum(), edges + dark[:, (0, 1, -2, -1)].sum()
    assert labels > 100 * len(drawn) and edges == 0


def test_corners_of_a_link_that_lies_on_its_side():
    """A link of length 2 is 0.5 wide; turned by 90° its long axis lies along x."""
    corners = link_corners(np.array([3.0, 1.0, np.pi / 2]), np.array(2.0))
    assert corners.min(axis=0) == pytest.approx([2.0, 0.75]) and corners.max(axis=0) == pytest.approx([4.0, 1.25])


def test_films_stay_small(slush_replay, dry_replay):
    """A GIF of two robots takes at most 10 kB a picture, and twice that for the first; an MP4 of one 25 kB a second.

    They go back and forth while they travel 2.4 m in 4 s, so that robot and scenery differ in every picture.
    """
    moving = []
    for replay in (slush_replay, dry_replay):
        frames = np.resize(np.concatenate([replay.frames, replay.frames[::-1]]), (121, 6, 3))
        frames[:, :, 0] += np.linspace(0, 2.4, 121)[:, None]
        moving.append(replace(replay, frames=frames))
    assert len(render_gif(moving)) < 42 * 10_000 and len(render_mp4(moving[:1])) < 4 * 25_000


def test_an_mp4_plays_in_browsers_and_slides_and_shows_the_pictures(slush_replay, dry_replay):
    """Flat areas keep their colour to 2 of 255, which is what studio range leaves; edges blur, chroma being halved."""
    second = [replace(replay, frames=replay.frames[: FILM_FPS + 1]) for replay in (slush_replay, dry_replay)]
    data, drawn = render_mp4(second), list(pictures(second))
    with av.open(io.BytesIO(data)) as container:
        (stream,) = container.streams
        shown = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height) == (PICTURE_WIDTH, 2 * LANE_HEIGHT) and stream.average_rate == FILM_FPS
        assert len(shown) == stream.frames == len(drawn) == FILM_FPS + 1
        assert float(stream.duration * stream.time_base) == pytest.approx(len(shown) / FILM_FPS)
    assert data.index(b"moov") < data.index(b"mdat")  # the index comes first, so that a browser begins at once
    for one, other in zip(shown[:: FILM_FPS // 2], drawn[:: FILM_FPS // 2], strict=True):
        off = np.abs(one.astype(int) - np.asarray(other)).max(axis=2)
        assert np.median(off) <= 2 and off.mean() < 4
    assert (np.abs(shown[0].astype(int) - shown[-1]).max(axis=2) > 60).sum() > 500  # and they move


def test_films_have_the_same_bytes_each_time(slush_replay, dry_replay):
    """Between the films memory is filled with other data, which once leaked into a film."""
    short, other = (replace(replay, frames=replay.frames[:6]) for replay in (slush_replay, dry_replay))
    first = render_mp4([short])
    for _ in range(4):
        render_mp4([other])
        assert render_mp4([short]) == first
    assert render_gif([short]) == render_gif([short])
