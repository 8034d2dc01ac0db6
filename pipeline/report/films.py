"""Films of replays as GIF and MP4, several robots above one another. The same replays always give the same bytes.

robot_view.py draws each robot, camera.py decides what is in view.

MP4s are H.264 in yuv420p, which every browser and phone plays. x264 runs on one thread, because its output depends on
the number of threads. The rows of all planes are multiples of 64 bytes: FFmpeg pads others with uninitialised memory,
which made one film in ten of 600 or 608 pixels differ. The bytes depend on the version of PyAV.
"""

import io
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from pipeline.report.camera import FILM_FPS, LANE_HEIGHT, PICTURE_WIDTH, cameras
from pipeline.report.replay import Replay
from pipeline.report.robot_view import Lane

GIF_EVERY = 3  # a GIF has every third picture: it counts time in hundredths of a second, and pictures add to its size
_MOST_COLORS = 128  # of a GIF: the most frequent ones

_X264 = {"preset": "veryfast", "crf": "23", "threads": "1"}
"""At a constant rate factor of 23 the edges of links are clean, and 20 s take 250 to 550 kB. A slower preset takes
twice as long for files that are a tenth smaller."""
_MP4 = {"movflags": "+faststart", "movie_timescale": str(1000 * FILM_FPS)}
"""The index goes to the front, so that a browser can start at once. The time scale is a multiple of the frame rate;
milliseconds would cut the last picture short."""
_BT709 = 1  # colour encoding (ITU-T H.273), written into the file so that players do not guess it from the size
_STUDIO_RANGE = 1  # brightness from 16 to 235, as players expect


def render_gif(replays: Sequence[Replay]) -> bytes:
    """Return a film of replays above one another as a GIF that repeats forever."""
    some = list(pictures(replays, every=25 * GIF_EVERY))
    seen = Image.new("RGB", (PICTURE_WIDTH, sum(picture.height for picture in some)))
    for number, picture in enumerate(some):
        seen.paste(picture, (0, number * picture.height))
    counted: list[tuple[int, tuple[int, ...]]] = seen.getcolors(seen.width * seen.height)  # type: ignore[assignment]
    colors = Image.new("P", (1, 1))
    colors.putpalette([part for _, color in sorted(counted, reverse=True)[:_MOST_COLORS] for part in color])
    drawn = pictures(replays, every=GIF_EVERY)
    first, *rest = (picture.quantize(palette=colors, dither=Image.Dither.NONE) for picture in drawn)
    duration, out = round(1000 * GIF_EVERY / FILM_FPS), io.BytesIO()
    # "optimize" writes only the part of a picture that changed.
    first.save(out, "GIF", save_all=True, append_images=rest, duration=duration, loop=0, optimize=True)
    return out.getvalue()


def render_mp4(replays: Sequence[Replay]) -> bytes:
    """Return a film of replays above one another as an MP4."""
    import av  # takes a tenth of a second to load, and only films need it
    from av.video.reformatter import VideoReformatter

    converter = VideoReformatter()  # one for all pictures: setting it up takes longer than using it
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"  # a file, because the index is moved to the front at the end
        with av.open(path, "w", options=_MP4) as container:
            stream = container.add_stream("libx264", rate=FILM_FPS, options=_X264)
            stream.width, stream.height, stream.pix_fmt = PICTURE_WIDTH, LANE_HEIGHT * len(replays), "yuv420p"
            context = stream.codec_context
            context.colorspace = context.color_primaries = context.color_trc = _BT709
            context.color_range = _STUDIO_RANGE
            for picture in pictures(replays):
                frame = converter.reformat(
                    av.VideoFrame.from_image(picture),
                    format="yuv420p",
                    dst_colorspace=_BT709,
                    dst_color_range=_STUDIO_RANGE,
                    threads=1,
                )
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
        return path.read_bytes()


def pictures(replays: Sequence[Replay], *, every: int = 1) -> Iterator[Image.Image]:
    """Draw replays above one another until the longest ends; only every n-th of the FILM_FPS pictures per second.

    Raises:
        ValueError: there are no replays.
    """
    if not replays:
        raise ValueError("film: expected at least one replay, got none")
    times = np.arange(0.0, max(replay.duration for replay in replays) + 1e-9, 1 / FILM_FPS)
    poses = [np.stack([replay.at(time) for time in times]) for replay in replays]
    lanes = [Lane(*of_one) for of_one in zip(replays, poses, cameras(replays, poses), strict=True)]
    for frame in range(0, len(times), every):
        picture = Image.new("RGB", (PICTURE_WIDTH, LANE_HEIGHT * len(replays)))
        for number, (replay, lane) in enumerate(zip(replays, lanes, strict=True)):
            picture.paste(lane.draw(frame, min(float(times[frame]), replay.duration)), (0, number * LANE_HEIGHT))
        yield picture


RENDERERS = {".gif": render_gif, ".mp4": render_mp4}  # by the ending of the file
