"""Tracked throws in a study: their files, their check, and the item that makes a data set of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.store.encoding import digest, encode_json
from pipeline.store.track_file import read_bars, read_track_table
from pipeline.workflow.identity import InputName
from pipeline.workflow.stage import Inputs, OutsideFile
from tasks.bench.tracks import Bars, TrackError, Tracks, TrackTable
from tasks.bench.tracks.bars import TrackedBarError
from tasks.bench.tracks.free_fall import Fall, falls_oddly
from tasks.bench.tracks.residuals import TrackReport, check_throws
from tasks.bench.tracks.table import Paths
from tasks.bench.tracks.unseen import Unseen, findings
from tasks.residual.learner import TANK_MODEL

TRACK_REPORT = "tracks.json"  # what the tracks are like
TRACKED, BARS = InputName("tracks"), InputName("bars")


def with_tracks(settings: Settings, file: Path | None) -> Settings:
    """Return settings that name a file of tracks, if one is given, and the digests of what they name.

    Args:
        settings: the study's settings.
        file: the file that ``--tracks`` names, if any; the other settings of tracks stay.

    Returns:
        Settings with whole paths, digests, and the number of throws.
    """
    tracks = settings.tracks
    if file is not None:
        tracks = tracks or Tracks(file=str(file))
        bars = None if tracks.bars_sha256 else tracks.bars  # a recorded file of bars belongs to the recorded tracks
        tracks = tracks.model_copy(update={"file": str(file), "bars": bars, "sha256": None, "bars_sha256": None})
    if tracks is None or tracks.sha256 is not None:
        return settings
    path = Path(tracks.file).expanduser().resolve()
    content = path.read_bytes()
    table, bars_beside = read_track_table(content, str(path))
    numbers = set(table.throw.tolist())
    bars_path = _bars_path(tracks, path, in_rows=bars_beside is not None)
    changes = {
        "tracks": tracks.model_copy(
            update={
                "file": str(path),
                "bars": None if bars_path is None else str(bars_path),
                "sha256": digest(content),
                "bars_sha256": None if bars_path is None else digest(bars_path.read_bytes()),
            }
        ),
        "throws": settings.throws.model_copy(update={"source": "tracks", "n_throws": max(len(numbers), 2)}),
    }
    try:
        given = settings.model_copy(update=changes).model_dump(exclude_unset=True)
        recorded = settings.tracks is not None and settings.tracks.sha256 is not None
        arms = given.get("grid", {}).get("environments", ())
        asked = "target" in settings.model_fields_set or settings.target in arms
        if not (recorded or asked):
            given["target"] = TANK_MODEL
        return Settings.model_validate(given)
    except ValidationError as error:
        raise PuddleError("; ".join(found["msg"].removeprefix("Value error, ") for found in error.errors())) from None


def _bars_path(tracks: Tracks, path: Path, *, in_rows: bool) -> Path | None:
    """Return the file of bars; None if the rows of tracks state them."""
    if tracks.bars is not None:
        return Path(tracks.bars).expanduser().resolve()
    if in_rows:
        return None
    of_csv, of_file = (path.with_name(f"{stem}-bars.csv") for stem in (path.stem.removesuffix(".csv"), path.stem))
    if not (beside := of_file if of_file.is_file() else of_csv).is_file():  # of a.csv.gz also a.csv-bars.csv
        raise PuddleError(
            f"{path}: expected the columns length, width and mass of the bars, or a file {beside.name} beside it: give "
            f"each throw's bar, or name the file (tracks.bars)"
        )
    return beside


def outside_files(tracks: Tracks) -> Mapping[InputName, OutsideFile]:
    """Return the files that an item reads."""
    if tracks.sha256 is None:
        raise PuddleError(f"tracks.sha256 is null for {tracks.file}: expected the SHA-256, which the command line adds")
    files = {TRACKED: OutsideFile(tracks.file, tracks.sha256)}
    if tracks.bars is not None and tracks.bars_sha256 is not None:
        files[BARS] = OutsideFile(tracks.bars, tracks.bars_sha256)
    return files


@dataclass(frozen=True)
class ReadTracks:
    """Tracks as read, and what messages call them."""

    name: str
    table: TrackTable
    bars: Bars


def read_tracks(inputs: Inputs) -> ReadTracks:
    """Return the tracks among an item's inputs."""
    ((name, content),) = inputs[TRACKED].items()
    table, bars = read_track_table(content, name)
    for file, data in inputs.get(BARS, {}).items():
        bars = read_bars(data, file)
    assert bars is not None  # as with_tracks has checked
    return ReadTracks(name, table, bars)


def check_tracks(settings: Settings) -> Paths | None:
    """Read and check the tracks of a study before anything is computed; return the throws, if it has any."""
    if settings.tracks is None:
        return None
    read = read_tracks({name: file.read() for name, file in outside_files(settings.tracks).items()})
    try:
        return check_throws(read.table, read.bars, settings.tracks, settings.physics)
    except TrackError as error:
        named = settings.tracks.bars if isinstance(error, TrackedBarError) else None
        raise PuddleError(f"{named or settings.tracks.file}: {error}") from None


def unnamed(tracks: Tracks) -> Tracks:
    """Return the settings without files and digests, which are those of an item's inputs."""
    return tracks.model_copy(update={"file": "tracks", "bars": None, "sha256": None, "bars_sha256": None})


def encode_report(report: TrackReport) -> bytes:
    """Return a report as a JSON document; a number that does not exist is null."""
    return encode_json(_without_nan(asdict(report)))


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_nan(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(inner) for inner in value]
    return None if value != value else value


def report_lines(
    folds: Sequence[Mapping[str, Any]], settings: Settings, n_transitions: int, n_further: int
) -> list[str]:
    """Say what tracks are like, in the units of the bench, and warn of effects that no network learns.

    Args:
        folds: reports of the tracks, decoded: of each fit to all but a fold of them.
        settings: the study's settings.
        n_transitions: number of transitions made of them, in all fits.
        n_further: number of transitions of throws in the fitted media.

    Returns:
        Lines for the terminal.
    """
    tracks, report = settings.tracks, folds[0]
    assert tracks is not None
    mm = 1000 * tracks.metres_per_metre
    noise_x, noise_y, noise_angle = report["noise"]
    of_noise = "stated" if report["sd_given"] else "estimated"
    rate = 1 / (report["frame_interval"] * tracks.time_scale)
    lines = [
        f"{report['n_throws']:,} tracked throws, {report['n_frames']:,} frames at {rate:.0f} a second, "
        f"{n_transitions // len(folds):,} transitions, and {n_further // len(folds):,} of throws in each of "
        f"{len(folds)} media, each fitted to all throws but its share",
        f"    noise, {of_noise}: x {noise_x * mm:.2g} mm, y {noise_y * mm:.2g} mm, angle "
        f"{math.degrees(noise_angle):.2g}°",
    ]
    if unseen := [Unseen(**_with_nan(fold["unseen"])) for fold in folds if fold["unseen"]]:
        error = np.mean([of_fold.error for of_fold in unseen])
        lines.append(f"    throws held out of a fit, followed from start to end: off by {error:.0%} of the way")
        lines += [f"warning: throws held out of a fit: {finding}" for finding in findings(unseen)]
    if n_repeated := report.get("n_repeated", 0):
        lines.append(f"warning: {n_repeated:,} more frames were dropped: they repeat the one before (phone, editor)")
    if report.get("angle_period", math.inf) < 4:
        lines.append("    angles are known up to half a turn, after which a bar is the same, and unwrapped so")
    if report["n_gaps"]:
        lines.append(f"    {report['n_gaps']:,} gaps between frames; {report['n_rows_in_gaps']:,} transitions left out")
    if n_contacts := np.sum(report["n_contacts"]):
        lines.append(f"warning: {n_contacts:,} contacts with walls or the floor; frames around are left out")
    fall, gravity = Fall(**_with_nan(report["fall"])), settings.physics.gravity
    if not fall.n_rows:
        lines.append("    gravity: not tested, no bar is seen above the water")
    elif falls_oddly(fall, gravity):
        lines.append(
            f"warning: bars above the water fall at {-fall.acceleration:.2f} ± {fall.sd:.2f} m/s², expected "
            f"{gravity:g}: check tracks.length_unit, the scale of the calibration, and the frame rate"
        )
    return lines


def _with_nan(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: math.nan if value is None else value for name, value in values.items()}
