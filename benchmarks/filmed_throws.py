"""Measure what filmed throws are worth: `python -m benchmarks.filmed_throws --work DIR`.

500 throws are filmed by the synthetic camera, tracked as `puddle track` does, and learned from. Adds its rows to
docs/results/tracks-rollouts.json, which docs/your-own-tank.md shows. It takes half an hour on two cores; DIR keeps the
videos.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from benchmarks.synthetic_tank import TankCamera, TankScene, film_board, render, throws_for_bars
from benchmarks.tracks import (
    DEPTH,
    N_DATA_SETS,
    N_MORE_TRIALS,
    PHYSICS,
    SECONDS,
    TIME,
    Measurement,
    measure_missing,
    study,
)
from pipeline.store.track_file import bars_of, read_track_columns, track_table
from pipeline.vision.kit_markers import markers_of
from pipeline.vision.markers_file import Markers
from pipeline.vision.track_video import TrackOptions, track_videos
from tasks.fabrication.kit_settings import KitSettings, ThrowingKit
from tasks.fabrication.throwing_bars import throwing_bars
from tasks.residual import Transitions, simulate_throws
from tasks.residual.throws import Starts
from tasks.seeding import generator
from tasks.tracks import Tracks, residual_transitions
from tasks.world import Slush, TrueSlush

_N_VIDEOS, _N_THROWS = 10, 50  # in each video
_CAMERA = TankCamera(width=1210, height=1060, field=0.82)  # the pixels of 1080p, as far as the tank reaches


def markers() -> Markers:
    """Return a tank just large enough for throws of a quarter of a second."""
    throwing = ThrowingKit(tank_length=0.7, tank_height=0.62, waterline=0.32)
    return markers_of(throwing, throwing_bars(throwing, KitSettings(), 1000.0))


def throws_of(video: int) -> tuple[Starts, list[int]]:
    """Return the starts of a video's throws, and their bars."""
    starts, bars = throws_for_bars(_N_THROWS, markers(), generator(1, "filmed throws", video))
    return replace(starts, throw=starts.throw + video * _N_THROWS), bars


def film(folder: Path, video: int) -> Path:
    """Film the throws of a video, unless that is done."""
    path = folder / f"throws-{video}.mp4"
    if not path.exists():
        starts, bars = throws_of(video)
        scene = TankScene(_CAMERA, markers(), rng=generator(2, "filmed throws", video))
        begun = folder / f"begun-{video}.mp4"
        render(begun, scene, starts, bars, SECONDS * TIME)
        begun.rename(path)
    return path


def filmed(folder: Path) -> Transitions:
    """Film, track and smooth the throws."""
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(2) as workers:
        videos = list(workers.map(partial(film, folder), range(_N_VIDEOS)))
    board, tracks = folder / "board.mp4", folder / "tracks.csv"
    if not tracks.exists():
        film_board(board, _CAMERA, markers(), 20, generator(3, "filmed throws"))
        for line in track_videos(videos, markers(), tracks, TrackOptions(lens_video=board)):
            print(line, flush=True)
    table = track_table(read_track_columns(tracks.read_bytes(), tracks.name), tracks.name)
    of_bars = tracks.with_name("tracks-bars.csv")
    bars = bars_of(read_track_columns(of_bars.read_bytes(), of_bars.name), of_bars.name)
    return residual_transitions(table, bars, Tracks(file="tracks.csv"), PHYSICS)[0]


def exact() -> Transitions:
    """Return the same throws as a study simulates them."""
    starts = [throws_of(video)[0] for video in range(_N_VIDEOS)]
    return Transitions.concatenate([simulate_throws(one, round(SECONDS * 60), Slush(), PHYSICS) for one in starts])


def main() -> None:
    """Measure the rows that the file lacks."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--work", type=Path, required=True)
    folder: Path = options.parse_args().work
    row = {"n_throws": _N_VIDEOS * _N_THROWS}
    # As many ensembles as there are data sets elsewhere, all of which learn from these throws.
    learn = partial(study, true=TrueSlush(DEPTH), n_data_sets=N_DATA_SETS, n_trials=N_MORE_TRIALS)
    exact_states, seen = cache(exact), cache(filmed)
    measurements: list[Measurement] = [
        (row | {"learned_from": "exact states of filmed throws"}, lambda: learn(lambda _: exact_states())),
        (row | {"learned_from": "video", "rate": _CAMERA.rate}, lambda: learn(lambda _: seen(folder))),
    ]
    measure_missing("studies", measurements)


if __name__ == "__main__":
    main()
