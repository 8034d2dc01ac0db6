"""Replays as a GIF, which moves wherever a picture can stand. The same replays always give the same bytes."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence

from PIL import Image

from pipeline.report.film import FPS as FILM_FPS
from pipeline.report.film import palette, pictures
from pipeline.report.replay import Replay

EVERY = 3
"""Of how many pictures of a film a GIF has one; it counts in hundredths of a second, and grows with every picture."""
FPS = FILM_FPS / EVERY
"""Pictures a second."""


def render_gif(replays: Sequence[Replay]) -> bytes:
    """Film replays above one another, repeating for ever, on one palette of the colours that are drawn.

    Raises:
        ValueError: there are no replays.
    """
    reduce_colors = on_palette(replays)
    return write_gif([reduce_colors(picture) for picture in pictures(replays, every=EVERY)])


def on_palette(replays: Sequence[Replay]) -> Callable[[Image.Image], Image.Image]:
    """Return what reduces a picture of replays to a palette of the colours that are drawn."""
    colors = Image.new("P", (1, 1))
    colors.putpalette([part for color in palette(replays) for part in color])
    return lambda picture: picture.quantize(palette=colors, dither=Image.Dither.NONE)


def write_gif(frames: Sequence[Image.Image]) -> bytes:
    """Put pictures that share a palette, FPS a second, into a GIF that repeats for ever."""
    out = io.BytesIO()
    frames[0].save(
        out,
        "GIF",
        save_all=True,
        append_images=frames[1:],
        duration=round(1000 / FPS),
        loop=0,
        optimize=True,  # only what changed is written
    )
    return out.getvalue()
