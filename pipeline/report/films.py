"""Replays as a GIF and an MP4 of the same pictures, each drawn once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from PIL import Image

from pipeline.report.film import pictures
from pipeline.report.gif import EVERY, on_palette, write_gif
from pipeline.report.mp4 import write_mp4
from pipeline.report.replay import Replay


def render_films(replays: Sequence[Replay]) -> tuple[bytes, bytes]:
    """Film replays above one another: what ``render_gif`` and ``render_mp4`` give.

    Raises:
        ValueError: there are no replays.
    """
    kept: list[Image.Image] = []
    reduce_colors = on_palette(replays)

    def drawn() -> Iterator[Image.Image]:
        for number, picture in enumerate(pictures(replays)):
            if number % EVERY == 0:
                kept.append(reduce_colors(picture))
            yield picture

    mp4 = write_mp4(drawn(), len(replays))
    return write_gif(kept), mp4
