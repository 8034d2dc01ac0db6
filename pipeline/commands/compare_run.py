"""puddle compare-run: the run of a built robot beside its prediction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pipeline.bench.fabrication.kit_files import KIT, KIT_MANIFEST
from pipeline.bench.vision.markers_file import Markers
from pipeline.bench.vision.track_video import TrackOptions, follow
from pipeline.commands.options import (
    DEFAULT_STORE,
    MARKERS_OPTION,
    LensVideo,
    Slowdown,
    StorePath,
    StudyName,
    output_suffix,
    with_options,
)
from pipeline.commands.terminal import to_stderr, to_stdout
from pipeline.config.loading import load
from pipeline.config.settings import RolloutSettings
from pipeline.errors import PuddleError
from pipeline.report.render import as_text
from pipeline.report.run_page import render_run, verdict
from pipeline.results.recorded_study import Study, open_study
from pipeline.stages.environments import environment_of
from pipeline.store import disk
from pipeline.store.design_file import load_design
from pipeline.store.encoding import decode_document
from pipeline.store.track_file import read_track_table
from tasks.analysis.built_run import BuiltRobot, LinkPath, RunError, RunRow, compare_with_simulation
from tasks.bench.fabrication.kit_settings import FabricationSettings
from tasks.residual import arm_kind
from tasks.simulation import simulate
from tasks.world import Physics, ResidualSlush


@with_options
def compare_run(
    run: Annotated[Path, typer.Argument(metavar="VIDEO-or-TRACKS", help="A video of the run, or its tracks (.csv).")],
    kit: Annotated[Path, typer.Option("--kit", help="The robot's kit, a folder of `puddle fabricate`.")],
    study: StudyName = None,
    markers: Annotated[Path | None, MARKERS_OPTION] = None,
    lens: LensVideo = None,
    slowdown: Slowdown = 1.0,
    out: Annotated[Path, typer.Option("--out", help="The page (.html).")] = Path("run.html"),
    store: StorePath = DEFAULT_STORE,
) -> None:
    """Compare a built robot's run with what was predicted.

    How far and how fast it went, and its gait, stand on the terminal and on a page. The prediction is what the
    kit records, or that of another study's ensemble (--study); its interval is two standard deviations of the members
    to either side.
    """
    output_suffix(out, (".html",))
    recorded = None if study is None else open_study(study, store, say=to_stderr)
    robot = read_kit(kit, recorded)
    own = recorded is not None and robot.name.startswith(f"{recorded.name}-trial-")  # as a proposed champion is called
    if recorded is not None and (robot.predicted is None or not own):  # else the kit has the trial's own ensemble's
        robot = _predicted(robot, recorded)
    if run.suffix in (".csv", ".parquet", ".gz"):
        if markers or lens or slowdown != 1.0:
            raise PuddleError(f"{run}: --markers, --lens and --slowdown are for a video, not for tracks")
        paths, lines = _read_tracks(run, robot.design.room), list[str]()
    else:
        paths, lines = _tracked(run, markers, TrackOptions(lens, slowdown, robot=True))
    try:
        comparison = compare_with_simulation(robot, paths)
    except RunError as error:
        raise PuddleError(f"{run} with {kit}: {error}") from None
    disk.place(out, render_run(comparison, run.name).encode())
    to_stdout(*lines, f"{robot.name}: {comparison.measured.time[-1]:.1f} s of steady gait")
    to_stdout(*as_text(RunRow, comparison.rows()), f"page: {out}", verdict(comparison))


def _predicted(robot: BuiltRobot, study: Study) -> BuiltRobot:
    """Predict the robot's speed by the ensemble of a study, with the physics of the kit, whose joints are as built."""
    rollout, physics = study.settings.rollout, robot.physics
    at = ResidualSlush(depth=robot.environment.depth, ensemble=study.ensemble())
    rollouts = simulate(robot.design, at, n_settle=rollout.n_settle, n_measure=rollout.n_measure, physics=physics)
    if not np.isfinite(rollouts.displacement).all():
        raise PuddleError(f"the robot diverges under the ensemble of study {study.name}: there is no prediction")
    seconds = rollout.n_measure * physics.time_step * robot.time_scale
    by = f"the ensemble of study {study.name}"
    return replace(robot, predicted=rollouts.displacement[:, 0] * robot.scale / seconds, predicted_by=by)


def read_kit(folder: Path, study: Study | None = None) -> BuiltRobot:
    """Read a kit's folder; the study has its networks. Raises PuddleError if it is no kit, or they are missing."""
    path = folder / KIT_MANIFEST
    try:
        document = decode_document(path.read_bytes(), schema=KIT.schema, version=KIT.version, source=str(path))
    except OSError as error:
        raise PuddleError(
            f"{folder}: expected a kit of `puddle fabricate`, found no {path.name}: {error.strerror}"
        ) from None
    simulated: Mapping[str, Any] = document["simulated"]
    choices = FabricationSettings.model_validate(document["settings"])
    rollout = RolloutSettings.model_validate(simulated["rollout"])
    scale, predicted = choices.kit.scale_mm_per_m / 1000, simulated["predicted"]
    physics = Physics.model_validate(simulated["physics"])
    time_scale = choices.scaling.time_scale(scale)
    seconds = rollout.n_measure * physics.time_step * time_scale
    target, media = simulated["environment"], simulated["media"]
    learned = isinstance(media[target], str)
    if learned and study is None:
        label = arm_kind(target).label
        raise PuddleError(f"{folder}: its robot was simulated in {label}: expected its study, --study NAME")
    ensemble = study.ensemble() if study is not None and learned else None
    return BuiltRobot(
        name=str(document["name"]),
        design=load_design(folder / "design.json"),
        scale=scale,
        time_scale=time_scale,
        environment=environment_of(media, target, simulated["depth"], ensemble),
        physics=physics,
        n_settle=rollout.n_settle,
        predicted=None if predicted is None else np.array(predicted, dtype=np.float64) * scale / seconds,
    )


def _tracked(video: Path, markers: Path | None, options: TrackOptions) -> tuple[dict[int, LinkPath], list[str]]:
    """Return the path of each link in a video, and lines for the terminal."""
    if markers is None:
        raise PuddleError(
            f"{video}: a video needs --markers, markers.yaml of a throwing kit; tracks end in .csv or .parquet"
        )
    (tracked,), lines = follow([video], load(Markers, markers), options)
    return {track.throw: (track.time, track.pose) for track in tracked.tracks}, lines


def _read_tracks(path: Path, n_links: int) -> dict[int, LinkPath]:
    rows, _ = read_track_table(path.read_bytes(), str(path))
    table = np.column_stack((rows.time, rows.x, rows.y, rows.angle))
    if not np.isfinite(table).all():
        raise PuddleError(f"{path}: row {int(np.argwhere(~np.isfinite(table))[0, 0]) + 1}: expected finite numbers")
    paths: dict[int, LinkPath] = {}
    links = {str(link): link for link in range(n_links)}
    for link in np.unique(rows.throw):
        if str(link) not in links:
            raise PuddleError(
                f"{path}: throw {link}: expected links of a robot, 0 to {n_links - 1}: track the run with --robot"
            )
        time, x, y, angle = table[rows.throw == link].T
        if (late := np.flatnonzero(np.diff(time) <= 0)).size:
            raise PuddleError(f"{path}: link {link}, frame {late[0] + 1}: expected a time later than the frame before")
        paths[links[str(link)]] = (time, np.column_stack((x, y, np.unwrap(angle))))
    return paths
