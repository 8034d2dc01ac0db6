"""``puddle track``: videos of a tank become a tracks file, with films that show what was found."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pipeline.bench.vision.check_film import write_check_film
from pipeline.bench.vision.markers_file import Markers
from pipeline.bench.vision.track_video import Track, TrackOptions, follow
from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.tables import Columns, csv_of


def track_videos(videos: Sequence[Path], markers: Markers, out: Path, options: TrackOptions) -> list[str]:
    """Track the bars in videos; write the tracks file (NAME.csv), NAME-bars.csv, and NAME-check.mp4 of each video.

    Throws are numbered on from one video to the next. Returns lines for the terminal. Raises PuddleError if a video
    can't be read or calibrated, or holds no throw; nothing was written.
    """
    if out.suffix != ".csv" or not out.parent.is_dir() or out.is_dir():
        raise PuddleError(f"--out: expected a file name that ends in .csv, in an existing folder, got {out}")
    tracked, lines = follow(videos, markers, options)
    tracks = [track for video in tracked for track in video.tracks]
    films = [out.with_name(f"{out.stem}-check{f'-{i + 1}' * (len(videos) > 1)}.mp4") for i in range(len(videos))]
    with TemporaryDirectory(dir=out.parent, prefix=f".{out.stem}-") as unfinished:
        for video, film in zip(tracked, films, strict=True):
            write_check_film(Path(unfinished, film.name), video)
        for film in films:
            Path(unfinished, film.name).replace(film)
    tables = {out: _tracks_table(tracks)}
    if not options.robot:
        tables[out.with_name(f"{out.stem}-bars.csv")] = _bars_table(tracks)
    for path, table in tables.items():
        disk.place(path, csv_of(table))
    return [*lines, f"written: {', '.join(map(str, (*tables, *films)))}"]


def _tracks_table(tracks: Sequence[Track]) -> Columns:
    pose, deviation = (np.concatenate([getattr(track, name) for track in tracks]) for name in ("pose", "deviation"))
    columns: Columns = {
        "throw": np.concatenate([np.full(len(track.time), track.throw) for track in tracks]),
        "time": np.concatenate([track.time for track in tracks]).round(7),
    }
    columns |= {name: pose[:, i].round(8) for i, name in enumerate(("x", "y", "angle"))}
    return columns | {f"{name}_sd": deviation[:, i].round(8) for i, name in enumerate(("x", "y", "angle"))}


def _bars_table(tracks: Sequence[Track]) -> Columns:
    columns: Columns = {"throw": np.array([track.throw for track in tracks])}
    sizes = ("length", "width", "mass")
    return columns | {size: np.array([getattr(track.bar, size) for track in tracks]) for size in sizes}
