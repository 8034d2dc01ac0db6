"""Films of replays as GIF and MP4, several robots above one another. The same replays always give the same bytes.

MP4s are H.264 in yuv420p, which every browser and phone plays. x264 runs on one thread, because its output depends on
the number of threads. The rows of all planes are multiples of 64 bytes: FFmpeg pads others with uninitialised memory,
which made one film in ten of 600 or 608 pixels differ. The bytes depend on the versions of Matplotlib and PyAV.
"""

import io
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, MultipleLocator
from PIL import Image
from scipy.signal import savgol_filter

from pipeline.report.drawing import DASHED, FAINT, INK
from pipeline.report.replay import FILM_FPS, Replay, link_corners
from tasks.arrays import Float64
from tasks.world.medium import Scene

PICTURE_WIDTH = 640  # width of a picture [pixel]; multiples of 128 leave an MP4's planes without padding
LANE_HEIGHT = 240  # height of each robot's part of the picture [pixel]
CAPTION_HEIGHT = 44  # of which its caption takes the top [pixel]
GIF_EVERY = 3  # a GIF has every third picture: it counts time in hundredths of a second, and pictures add to its size
SKY, SLUSH, SURFACE, PARTICLE = "#f5f8fb", "#bcd9ee", "#5d9fcd", "#3c7fb5"
GROUND, GROUND_EDGE = "#8b7d6b", "#5f5446"

_DPI = 100
_BODY_OF_WATER = (0, 1.0), (4, 0.45)  # order and opacity: behind the robot and, paler, before it
_MARGIN = 0.6  # space above and below what the robot reaches [m]
_VIEW_HEIGHT = (5.5, 15.0)  # least and greatest height that a lane shows [m]
_MOST_COLORS = 32  # of a GIF
_X264 = {"preset": "veryfast", "crf": "23", "threads": "1"}
"""At a constant rate factor of 23 the edges of links are clean, and 20 s take 250 to 550 kB. A slower preset takes
twice as long for files that are a tenth smaller."""
_MP4 = {"movflags": "+faststart", "movie_timescale": str(1000 * FILM_FPS)}
"""The index goes to the front, so that a browser can start at once. The time scale is a multiple of the frame rate;
milliseconds would cut the last picture short."""


def render_gif(replays: Sequence[Replay]) -> bytes:
    """Return a film of replays above one another as a GIF that repeats forever."""
    drawn, out = pictures(replays, every=GIF_EVERY), io.BytesIO()
    # With k-means, robots keep their colours.
    first = next(drawn).quantize(_MOST_COLORS, kmeans=3, dither=Image.Dither.NONE)
    rest = (picture.quantize(palette=first, dither=Image.Dither.NONE) for picture in drawn)
    duration = round(1000 * GIF_EVERY / FILM_FPS)
    # "optimize" writes only the part of a picture that changed.
    first.save(out, "GIF", save_all=True, append_images=rest, duration=duration, loop=0, optimize=True)
    return out.getvalue()


def render_mp4(replays: Sequence[Replay]) -> bytes:
    """Return a film of replays above one another as an MP4."""
    import av  # takes a tenth of a second to load, and only films need it

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"  # a file, because the index is moved to the front at the end
        with av.open(path, "w", options=_MP4) as container:
            stream = container.add_stream("libx264", rate=FILM_FPS, options=_X264)
            stream.width, stream.height, stream.pix_fmt = PICTURE_WIDTH, LANE_HEIGHT * len(replays), "yuv420p"
            for picture in pictures(replays):
                container.mux(stream.encode(av.VideoFrame.from_image(picture)))
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
    poses = [replay.at(times) for replay in replays]
    extents = [_vertical_extent(replay, pose) for replay, pose in zip(replays, poses, strict=True)]
    height = float(np.clip(max(high - low for low, high in extents), *_VIEW_HEIGHT))
    figure = Figure(figsize=(PICTURE_WIDTH / _DPI, LANE_HEIGHT * len(replays) / _DPI), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    tops = np.arange(len(replays)) / len(replays)
    lanes = [_lane(figure, *robot, height) for robot in zip(tops, replays, poses, extents, strict=True)]
    for frame in range(0, len(times), every):
        for lane in lanes:
            lane(frame, float(times[frame]))
        canvas.draw()
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


def _vertical_extent(replay: Replay, poses: Float64) -> tuple[float, float]:
    """Return the lowest and highest y [m] to show, including the surface or the ground where they are near."""
    y = link_corners(poses, replay.length_scale)[..., 1]
    low, high = float(y.min()), float(y.max())
    if replay.has_medium:
        low, high = min(low, -1.0), max(high, 0.5)
    if low < 2.0 - replay.depth:
        low = min(low, -replay.depth - 0.4)
    return low - _MARGIN, high + _MARGIN


def _lane(
    figure: Figure, top: float, replay: Replay, poses: Float64, extent: tuple[float, float], height: float
) -> Callable[[int, float], None]:
    """Add a robot in its environment to a figure; return what moves it to a frame, at a time [s]."""
    lane = LANE_HEIGHT / (figure.get_figheight() * _DPI)  # heights of figures are shares
    axes = figure.add_axes((0, 1 - top - lane, 1, lane * (1 - CAPTION_HEIGHT / LANE_HEIGHT)), facecolor=SKY)
    start, metre = poses[0, 0, 0], (LANE_HEIGHT - CAPTION_HEIGHT) / height  # [pixel]
    half = PICTURE_WIDTH / metre / 2
    center = savgol_filter(poses[:, :, :2].mean(axis=1), min(2 * FILM_FPS + 1, len(poses)), 1, axis=0)  # mean over 2 s
    bottom = np.clip(center[:, 1] - height / 2, extent[0], max(extent[1] - height, extent[0]))
    # Whole pixels only, so that scenery keeps its edges from frame to frame and the file stays small.
    middle, bottom = (np.rint(place * metre) / metre for place in (center[:, 0], bottom))

    flow = _water(axes, replay.scenes, half) if replay.scenes else None
    if replay.has_medium and not flow:
        for order, opacity in _BODY_OF_WATER:
            axes.axhspan(-1e4, 0, color=SLUSH, alpha=opacity, lw=0, zorder=order)
        axes.axhline(0, color=SURFACE, lw=1.5, ls=DASHED if replay.hallucinated else "-", zorder=5)
    axes.axhspan(-1e4, -replay.depth, color=GROUND, lw=0, zorder=6)
    axes.axhline(-replay.depth, color=GROUND_EDGE, lw=1.5, zorder=6)
    color, ink = np.array(to_rgb(replay.color)), np.array(to_rgb(INK))
    edge, paler = 0.45 * color + 0.55 * ink, 0.72 * color + 0.28
    corners = link_corners(poses, replay.length_scale)[:, ::-1]  # the root is drawn last
    faces = [*[paler] * (corners.shape[1] - 1), color]
    links = PolyCollection(corners[0], facecolors=faces, edgecolors=[edge], linewidths=1.3, joinstyle="round", zorder=2)
    axes.add_collection(links, autolim=False)
    parent = replay.parent[1:]
    x, y, angle = np.moveaxis(poses[:, parent], -1, 0)
    along = replay.parent_attachment[1:] * replay.length_scale[parent] / 2
    joints = x - np.sin(angle) * along, y + np.cos(angle) * along
    (joint,) = axes.plot([], [], "o", ms=4.5, mfc="white", mec=edge, mew=1.0, zorder=3)
    (root,) = axes.plot([], [], "o", ms=6.5, mfc=INK, mec="white", mew=1.0, zorder=3)

    axes.spines[:].set_visible(False)
    axes.yaxis.set_visible(False)
    axes.xaxis.set_major_locator(MultipleLocator(5, offset=start))
    axes.tick_params(axis="x", direction="in", length=7, pad=-19, labelsize=8, labelcolor=INK)
    axes.xaxis.set_zorder(7)
    seen = np.arange(np.floor(middle.min() - half - start), middle.max() + half - start + 1)
    axes.vlines(start + seen, 0, 0.02, color=INK, lw=0.8, zorder=7, transform=axes.get_xaxis_transform())
    axes.vlines(start + seen[seen % 5 == 0], -1e4, 1e4, color=FAINT, lw=0.8, zorder=1)  # make motion visible

    def label(at: float, _: int) -> str:
        low, high = axes.get_xlim()  # a label that is cut off would be a wrong distance
        return f"{at - start:.0f} m".replace("-", "−") if low + 0.06 * half < at < high - 0.06 * half else ""

    axes.xaxis.set_major_formatter(FuncFormatter(label))

    def caption(x: float, line: int, text: str, **style: Any) -> Text:
        return figure.text(x, 1 - top - lane * (6 + 19 * line) / LANE_HEIGHT, text, va="top", **style)

    caption(0.015, 0, replay.title, color=replay.color, size=10, weight="bold")
    caption(0.015, 1, f"in {replay.seen_in}, {replay.depth:g} m", color=INK, size=9)
    moved = caption(0.985, 0, "", color=INK, size=10, weight="bold", ha="right")
    clock = caption(0.985, 1, "", color=INK, size=9, ha="right")

    def move(frame: int, time: float) -> None:
        if flow:
            flow(min(round(time * replay.fps), len(replay.scenes) - 1), middle[frame])
        axes.set(xlim=(middle[frame] - half, middle[frame] + half), ylim=(bottom[frame], bottom[frame] + height))
        links.set_verts(corners[frame])
        joint.set_data(joints[0][frame], joints[1][frame])
        root.set_data(poses[frame, :1, 0], poses[frame, :1, 1])
        moved.set_text(f"{poses[frame, 0, 0] - start:z.1f} m".replace("-", "−"))
        clock.set_text(f"{min(time, replay.duration):.1f} s")

    return move


def _water(axes: Axes, scenes: Sequence[Scene], half: float) -> Callable[[int, float], None]:
    """Add water with waves and particles to a lane; return what moves it to a scene, seen within half a width [m]."""
    bodies = [
        PolyCollection([], facecolors=SLUSH, alpha=opacity, lw=0, zorder=order) for order, opacity in _BODY_OF_WATER
    ]
    for body in bodies:
        axes.add_collection(body, autolim=False)
    (edge,) = axes.plot([], [], color=SURFACE, lw=1.5, zorder=5)
    (dots,) = axes.plot([], [], ".", color=PARTICLE, ms=3.5, mew=0, zorder=1)

    def flow(number: int, middle: float) -> None:
        surface, particles, period = scenes[number]
        x = np.linspace(middle - half, middle + half, PICTURE_WIDTH // 4 + 1)
        y = np.interp(x, surface[:, 0], surface[:, 1], period=period)
        for body in bodies:
            body.set_verts([[(x[0], -1e4), *zip(x, y, strict=True), (x[-1], -1e4)]])
        edge.set_data(x, y)
        seen = particles[:, 0] + period * np.arange(-np.ceil(half / period), np.ceil(half / period) + 1)[:, None]
        seen -= period * np.round((particles[:, 0] - middle) / period)
        dots.set_data(seen, np.broadcast_to(particles[:, 1], seen.shape))

    return flow


RENDERERS = {".gif": render_gif, ".mp4": render_mp4}  # by the ending of the file
