"""One design, simulated and filmed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np

from pipeline import disk
from pipeline.design_file import read_design
from pipeline.errors import PuddleError
from pipeline.report import render_gif, render_mp4, replay_of
from pipeline.report.data import ENVIRONMENTS as STYLES
from pipeline.settings import ENVIRONMENTS, EnvironmentName, Settings
from pipeline.stage import MissingInputs
from pipeline.stages import STAGES
from pipeline.stages.analyses.films import median_member
from pipeline.stages.segments import WEIGHTS, segment_spec, world_inputs, world_of
from pipeline.store import Store
from pipeline.study import survey
from tasks.evolution import evaluate
from tasks.simulation import OK, simulate

WORLDS = tuple(name for name in ENVIRONMENTS if name != "single_member")

FORMATS = {".gif": render_gif, ".mp4": render_mp4}
"""How a film is made, by the end of its file's name."""


def simulate_design(
    path: Path,
    environment: str,
    depth: float,
    out: Path | None,
    *,
    settings: Settings,
    open_store: Callable[[], Store],
    how_to_run: Callable[[str], str],
) -> list[str]:
    """Simulate the design in a file, and film it if asked to.

    Args:
        path: of the design file.
        environment: dry_land, true_slush or residual_slush.
        depth: of the ground [m].
        out: where to put a GIF or an MP4, if anywhere; in Residual Slush, of the median member's world.
        settings: how long the design is watched, and which networks residual_slush means.
        open_store: gives the store that holds the networks.
        how_to_run: gives the command line that runs a stage, for messages.

    Returns:
        Lines that say how far the design got.
    """
    design = read_design(path)
    if environment not in WORLDS:
        raise PuddleError(f"--environment: expected one of {', '.join(WORLDS)}, came {environment!r}")
    world = cast(EnvironmentName, environment)
    if out is not None and (out.suffix.lower() not in FORMATS or not out.parent.is_dir()):
        ends = " or ".join(FORMATS)
        raise PuddleError(f"--out: expected a file name that ends in {ends}, in a folder that exists, came {out}")
    spec = segment_spec(settings, stage="simulate", environment=world, world=world, depth=depth, trial=0)
    files = {}
    if world == "residual_slush":
        store = open_store()
        upstream = survey(settings, STAGES[:2], store, say=lambda line: None)
        try:
            inputs = world_inputs(settings, world, 0, upstream)
        except MissingInputs as missing:
            raise PuddleError(f"{missing}. `{how_to_run('study')}` makes it.") from None
        files = {name: {WEIGHTS: store.read(source.manifest, WEIGHTS)} for name, source in inputs.items()}
    try:
        place = world_of(spec, files)
    except ValueError as error:
        raise PuddleError(f"--depth: {error}") from None
    rollouts = simulate(
        design,
        place,
        n_settle=settings.rollout.n_settle,
        n_measure=settings.rollout.n_measure,
        engine=settings.work.engine,
        trace=out is not None,
        physics=settings.physics,
    )
    if not (rollouts.status == OK).all():
        raise PuddleError(f"{path}: the rollout diverged: a state became non-finite. There is nothing to measure.")
    lines = [f"{STYLES[world].label}, {depth:g} m deep, {settings.rollout.n_measure / 60:.0f} s:"]
    evaluation = evaluate(rollouts, disagreement_penalty=settings.ensemble.disagreement_penalty)
    root, whole = np.mean(rollouts.displacement), np.mean(rollouts.com_displacement)
    lines.append(f"  root {root:+.3f} m, whole robot {whole:+.3f} m")
    if world == "residual_slush":
        members = ", ".join(f"{value:+.2f}" for value in evaluation.displacement[0])
        lines.append(f"  members {members} m; fitness {evaluation.fitness[0]:+.3f} m")
    if out is not None and rollouts.trace is not None:
        trace, words = rollouts.trace[0], STYLES[world].label
        if world == "residual_slush":
            member = median_member(rollouts.displacement[:, 0])
            trace, words = rollouts.trace[member, 0], f"{words} (member {member})"
        replay = replay_of(
            design,
            trace,
            title=path.stem,
            environment=world,
            world=words,
            depth=depth,
            has_medium=world != "dry_land",
            imagined=world == "residual_slush",
            n_settle=settings.rollout.n_settle,
        )
        with disk.explained("writing the film", out):
            out.write_bytes(FORMATS[out.suffix.lower()]([replay]))
        lines.append(f"  filmed in {out}")
    return lines
