"""Measure what tracking makes of a synthetic camera's videos: `python -m benchmarks.tank_video --work DIR`.

Writes docs/results/tank-video.json, which docs/filming.md shows. DIR keeps the videos, which take ten minutes on one
core; those that it holds are not filmed again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.published import RESULTS
from benchmarks.synthetic_tank import SCALE, TankCamera, TankScene, film_board, render, states_of, throws_for_bars
from pipeline.store.provenance import environment as provenance
from pipeline.store.tables import Columns, csv_of
from pipeline.vision.kit_markers import markers_of
from pipeline.vision.track_video import TrackOptions, track_videos
from tasks.arrays import Float64
from tasks.fabrication.kit_settings import KitSettings, ThrowingKit
from tasks.fabrication.throwing_bars import throwing_bars
from tasks.residual.throws import Starts
from tasks.seeding import generator
from tasks.simulation.free_links import FreeLinks
from tasks.tracks import Bars, Tracks, TrackTable, residual_transitions
from tasks.world import Physics, Slush, froude_time

_N_THROWS, _SECONDS = 20, 0.5
_EXACT = 1e-6  # deviation that is stated of exact positions [m] and angles [rad]
_SPEED = SCALE / froude_time(SCALE)  # bench m/s per m/s of simulation
_SPEED_BANDS = (0.0, 0.1, 0.3, 0.6, 2.0)  # speeds at bench scale [m/s]
CASES = (
    ("60/s, board", 60.0),
    ("60/s, no board", 60.0),
    ("120/s, board", 120.0),
    ("60/s, exact positions", 60.0),
    ("120/s, exact positions", 120.0),
)


def table_of(path: Path) -> Any:
    """Read a CSV file as a structured array."""
    return np.genfromtxt(path, delimiter=",", names=True)


def measure(folder: Path, camera: TankCamera, lens: str) -> list[dict[str, Any]]:
    """Film, track and compare.

    Args:
        folder: the videos and tracks.
        camera: the camera.
        lens: "board", "no board" if the tank's tags alone calibrate it, or "exact positions" for those of the truth.

    Returns:
        A row for each band of speeds.
    """
    folder.mkdir(parents=True, exist_ok=True)
    throwing = ThrowingKit(tank_length=1.1, tank_height=0.62, waterline=0.32)
    markers = markers_of(throwing, throwing_bars(throwing, KitSettings(), 1000.0))
    starts, bars = throws_for_bars(_N_THROWS, markers, generator(0, "tank video"))
    if not (folder / "truth.json").exists():
        scene = TankScene(camera, markers, rng=generator(0, "tank video", camera.rate))
        rows = render(folder / "throws.mp4", scene, starts, bars, _SECONDS)
        film_board(folder / "board.mp4", camera, markers, 20, generator(1, "tank video", camera.rate))
        (folder / "markers.yaml").write_text(yaml.safe_dump(markers.model_dump(mode="json"), sort_keys=False))
        (folder / "truth.json").write_text(json.dumps(rows))
    truth = np.array(json.loads((folder / "truth.json").read_text()))
    out = folder / f"tracks-{lens.replace(' ', '-')}.csv"
    if lens == "exact positions":
        _write_exact(out, truth, starts)
    else:
        options = TrackOptions(lens_video=folder / "board.mp4" if lens == "board" else None)
        for line in track_videos([folder / "throws.mp4"], markers, out, options):
            print(line, flush=True)
    tracks, of_bars = table_of(out), table_of(out.with_name(f"{out.stem}-bars.csv"))
    row = np.abs(tracks["time"][:, None] - truth[:, 1]).argmin(axis=1)
    error = np.stack([tracks[name] for name in ("x", "y", "angle")], axis=1) - truth[row, 2:5]
    error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
    sd = np.stack([tracks[f"{name}_sd"] for name in ("x", "y", "angle")], axis=1)
    jitter = error.copy()  # what is constant in a throw says nothing of velocities
    for throw in np.unique(tracks["throw"]):
        jitter[tracks["throw"] == throw, :2] -= error[tracks["throw"] == throw, :2].mean(axis=0)
    shown, seen = np.hypot(*truth[:, 5:7].T), np.hypot(*truth[row, 5:7].T)
    speed, residual, size = _residual_errors(tracks, of_bars, truth, starts)
    found = []
    for low, high in pairwise(_SPEED_BANDS):
        tracked, filmed, step = ((of >= low) & (of < high) for of in (seen, shown, speed))
        found.append(
            {
                "band": [low, high],
                "frames": int(filmed.sum()),
                "lost": round(1 - tracked.sum() / max(filmed.sum(), 1), 4),
                "position_mm": _rms(1000 * error[tracked, :2]),
                "jitter_mm": _rms(1000 * jitter[tracked, :2]),
                "stated_mm": _rms(1000 * sd[tracked, :2]),
                "angle_deg": _rms(np.degrees(error[tracked, 2])),
                "stated_deg": _rms(np.degrees(sd[tracked, 2])),
                "residual": [_share(residual[step, i], size[step, i]) for i in range(3)],
            }
        )
    return found


def _write_exact(out: Path, truth: Float64, starts: Starts) -> None:
    """Write the truth as a tracks file: what smoothing alone makes of these frames."""
    columns: Columns = {"throw": truth[:, 0].astype(int)}
    columns |= {name: truth[:, i] for i, name in enumerate(("time", "x", "y", "angle"), 1)}
    columns |= {f"{name}_sd": np.full(len(truth), _EXACT) for name in ("x", "y", "angle")}
    out.write_bytes(csv_of(columns))
    length = SCALE * starts.length_scale
    bars: Columns = {"throw": starts.throw, "length": length, "width": SCALE**2 / length}
    out.with_name(f"{out.stem}-bars.csv").write_bytes(csv_of(bars | {"mass": np.full(len(length), 0.196)}))


def _residual_errors(tracks: Any, of_bars: Any, truth: Float64, starts: Starts) -> tuple[Float64, Float64, Float64]:
    """Return the speed at bench scale, the errors of the residuals and the true residuals of (n_steps,) steps."""
    names = ("time", "x", "y", "angle", "x_sd", "y_sd", "angle_sd")
    table = TrackTable(throw=tracks["throw"].astype(int), **{name: tracks[name] for name in names})
    bars = Bars(of_bars["throw"].astype(int), of_bars["length"], of_bars["width"], of_bars["mass"])
    transitions, _ = residual_transitions(table, bars, Tracks(file="tracks.csv"), Physics())
    states, _ = states_of(starts, _SECONDS + 0.1)
    links = FreeLinks(starts.length_scale, Physics())
    pushed = np.stack([links.step(now, Slush()) - links.step(now, None) for now in states.swapaxes(0, 1)], axis=1)
    speeds, errors, sizes = [], [], []
    for throw in np.unique(tracks["throw"]):
        rows = transitions.throw == throw
        begin = tracks["time"][tracks["throw"] == throw][0]
        own = int(truth[np.abs(truth[:, 1] - begin).argmin(), 0])  # a throw may have been cut in two
        first = truth[truth[:, 0] == own, 1][0]
        steps = (begin - first + _open(truth, own)) / froude_time(SCALE) / Physics().time_step + transitions.step[rows]
        grid = np.arange(states.shape[1])
        true = np.stack([np.interp(steps, grid, pushed[own, :, 3 + i]) for i in range(3)], axis=1)
        speeds.append(_SPEED * np.interp(steps, grid, np.hypot(states[own, :, 3], states[own, :, 4])))
        errors.append(transitions.residual[rows, 3:] - true)
        sizes.append(true)
    return np.concatenate(speeds), np.concatenate(errors), np.concatenate(sizes)


def _open(truth: Float64, throw: int) -> float:
    """Return the time from the start of a throw to the middle of its first frame's exposure [s]."""
    return float(truth[truth[:, 0] == throw, 8][0])


def _rms(values: Float64) -> float:
    return round(float(np.sqrt(np.square(values).mean())), 3) if values.size else float("nan")


def _share(error: Float64, true: Float64) -> float:
    """Return the error of residuals as a share of the residuals, both root mean squares."""
    return round(float(np.sqrt(np.square(error).mean() / np.square(true).mean())), 3) if len(true) else float("nan")


def main(words: Sequence[str] | None = None) -> None:
    """Measure every case and write the file."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--work", type=Path, required=True)
    work: Path = options.parse_args(words).work
    cases = []
    for name, rate in CASES:
        rows = measure(work / f"{rate:.0f}", TankCamera(rate=rate), name.split(", ")[1])
        cases += [{"case": name, **row} for row in rows]
        print(*cases[-len(rows) :], sep="\n", flush=True)
    document = {"schema": "puddle.tank_video", "version": 1, "made_with": dict(provenance()), "cases": cases}
    (RESULTS / "tank-video.json").write_text(f"{json.dumps(document, indent=1)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
