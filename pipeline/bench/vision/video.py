"""Videos, frame by frame with their times, and films of what was found in them."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.errors import PuddleError

Picture = npt.NDArray[np.uint8]  # (height, width) grey, or (height, width, 3) blue, green, red


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of a video."""

    index: int
    time: float  # as the file states it [s]
    picture: Picture


def frames(path: Path, *, colour: bool = False) -> Iterator[Frame]:
    """Yield the frames of a video, grey or in colour, with the times of the file, which need not be even.

    Raises PuddleError if the file is missing, is not a video, has an unknown codec, or is damaged; it names the frame.
    """
    import av  # takes a tenth of a second to load

    index, before = 0, -np.inf
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise PuddleError(f"{path}: expected a video, found no pictures. Is it the right file?")
            stream = container.streams.best("video")  # a file may begin with a thumbnail
            stream.thread_type = "AUTO"
            for frame in container.decode(stream):
                if frame.time is None or frame.time <= before:
                    raise PuddleError(
                        f"{path}: frame {index}: expected a time later than the frame before, got {frame.time}. Copy "
                        f"the file from the camera again, or convert it to MP4 without changing its frame rate."
                    )
                yield Frame(index, float(frame.time), frame.to_ndarray(format="bgr24" if colour else "gray"))
                index, before = index + 1, frame.time
    except (av.error.FFmpegError, OSError) as error:
        what = "is there such a file?" if not path.exists() else "copy it from the camera again, or convert it to MP4"
        why = getattr(error, "strerror", None) or str(error)
        raise PuddleError(f"{path}: frame {index}: can't be read as a video: {why}. {what.capitalize()}") from None
    if index == 0:
        raise PuddleError(f"{path}: expected at least one frame, found none. Is it the right file?")


@contextlib.contextmanager
def film(path: Path, *, width: int, height: int, rate: float, quality: int = 23) -> Iterator[Any]:
    """Write an MP4 of an even size [px]; yields the function that adds a picture, at a time [s] if one is given.

    ``rate`` is in pictures per second; ``quality`` is x264's constant rate factor, smaller for better pictures.
    """
    import av

    scale = 90_000
    with av.open(str(path), "w") as container:
        options = {"preset": "veryfast", "crf": str(quality), "threads": "1"}
        stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000), options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.codec_context.time_base = Fraction(1, scale)
        n = 0

        def add(picture: Picture, time: float | None = None) -> None:
            nonlocal n
            drawn = av.VideoFrame.from_ndarray(picture, format="gray" if picture.ndim == 2 else "bgr24")
            drawn.pts, drawn.time_base = round((n / rate if time is None else time) * scale), Fraction(1, scale)
            container.mux(stream.encode(drawn))
            n += 1

        yield add
        container.mux(stream.encode())
