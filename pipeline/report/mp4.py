"""Replays as an MP4, for browsers, phones and slides: H.264 in yuv420p, which all of them play.

Encoded by x264 through PyAV on one thread, because the number of threads changes what x264 writes; and with rows whose
lengths are multiples of 64 bytes, because FFmpeg pads others with whatever was in memory, and one film in ten of 600 or
608 pixels then came out different. So the same replays give the same bytes, for one version of PyAV.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from pipeline.report.film import LANE_HEIGHT, WIDTH, pictures
from pipeline.report.replay import STEPS_PER_FRAME, STEPS_PER_SECOND, Replay

FPS = STEPS_PER_SECOND // STEPS_PER_FRAME
"""Pictures a second: all that a replay has."""

QUALITY = 24
"""x264's constant rate factor, less is better: at 24 the edges of links are clean, and 20 s take 100 to 300 kB."""

BT709 = 1
"""How colours are encoded (ITU-T H.273): written into the file, so that no player has to guess from the size."""
NARROW = 1
"""That brightness goes from 16 to 235, as players expect."""


def render_mp4(replays: Sequence[Replay]) -> bytes:
    """Film replays above one another.

    Raises:
        ValueError: there are no replays.
    """
    import av  # its libraries take a tenth of a second to load; only films need them

    drawn = pictures(replays, FPS)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        # The index goes to the front, so that a browser can begin at once; to go back there takes a file.
        with av.open(path, "w", options={"movflags": "+faststart"}) as container:
            stream = container.add_stream("libx264", rate=FPS, options={"crf": str(QUALITY), "threads": "1"})
            stream.width, stream.height, stream.pix_fmt = WIDTH, LANE_HEIGHT * len(replays), "yuv420p"
            context = stream.codec_context
            context.colorspace = context.color_primaries = context.color_trc = BT709
            context.color_range = NARROW
            for picture in drawn:
                frame = av.VideoFrame.from_image(picture)
                frame = frame.reformat(format="yuv420p", dst_colorspace=BT709, dst_color_range=NARROW)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
        return path.read_bytes()
