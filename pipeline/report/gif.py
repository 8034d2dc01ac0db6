"""Replays as a GIF, which moves wherever a picture can stand. The same replays always give the same bytes."""

from __future__ import annotations

import io
from collections.abc import Sequence

from PIL import Image

from pipeline.report.film import palette, pictures
from pipeline.report.replay import Replay

FPS = 10
"""Pictures a second; a GIF counts in hundredths of a second, and grows with every picture."""


def render_gif(replays: Sequence[Replay]) -> bytes:
    """Film replays above one another, repeating for ever, on one palette of the colours that are drawn.

    Raises:
        ValueError: there are no replays.
    """
    drawn_colors = Image.new("P", (1, 1))
    drawn_colors.putpalette([part for color in palette(replays) for part in color])
    frames = [
        picture.quantize(palette=drawn_colors, dither=Image.Dither.NONE) for picture in pictures(replays, FPS)
    ]
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
