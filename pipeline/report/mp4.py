"""Replays as an MP4, for browsers, phones and slides: H.264 in yuv420p, which all of them play.

Encoded by x264 through PyAV on one thread, because the number of threads changes what x264 writes; and with rows whose
lengths are multiples of 64 bytes, because FFmpeg pads others with whatever was in memory, and one film in ten of 600 or
608 pixels then came out different. So the same replays give the same bytes, for one version of PyAV.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from PIL import Image

from pipeline.report.film import FPS, pictures
from pipeline.report.replay import Replay
from pipeline.report.robot_view import LANE_HEIGHT, WIDTH

X264 = {"preset": "veryfast", "crf": "23", "threads": "1"}
"""At a constant rate factor of 23 the edges of links are clean, and 20 s take 250 to 550 kB; less is better. A
slower preset takes twice as long for files a tenth smaller."""

MP4 = {"movflags": "+faststart", "movie_timescale": str(1000 * FPS)}
"""The index goes to the front, so that a browser can begin at once; to go back there takes a file. A film's length is
counted in parts of a picture, not in milliseconds, which cut the last one short."""

BT709 = 1
"""How colours are encoded (ITU-T H.273): written into the file, so that no player has to guess from the size."""
NARROW = 1
"""That brightness goes from 16 to 235, as players expect."""


def render_mp4(replays: Sequence[Replay]) -> bytes:
    """Film replays above one another.

    Raises:
        ValueError: there are no replays.
    """
    return write_mp4(pictures(replays), len(replays))


def write_mp4(drawn: Iterable[Image.Image], n_lanes: int) -> bytes:
    """Put pictures of some robots above one another, FPS a second, into an MP4."""
    import av  # its libraries take a tenth of a second to load; only films need them
    from av.video.reformatter import VideoReformatter

    # One converter for all pictures: to set it up takes longer than to use it.
    converter = VideoReformatter()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        with av.open(path, "w", options=MP4) as container:
            stream = container.add_stream("libx264", rate=FPS, options=X264)
            stream.width, stream.height, stream.pix_fmt = WIDTH, LANE_HEIGHT * n_lanes, "yuv420p"
            context = stream.codec_context
            context.colorspace = context.color_primaries = context.color_trc = BT709
            context.color_range = NARROW
            for picture in drawn:
                frame = converter.reformat(
                    av.VideoFrame.from_image(picture),
                    format="yuv420p",
                    dst_colorspace=BT709,
                    dst_color_range=NARROW,
                    threads=1,
                )
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
        return path.read_bytes()
