"""One design, simulated and shown: how far it gets, a film, a page with what networks say of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np

from pipeline.config.settings import DEEPEST, ENVIRONMENTS, RESIDUAL_ENVIRONMENTS, EnvironmentName, Settings
from pipeline.errors import PuddleError
from pipeline.report import Replay, render_gif, render_mp4, render_robot, replay_of
from pipeline.report.data import ENVIRONMENTS as STYLES
from pipeline.stages import collect, train
from pipeline.stages.analyses.filmed_rollouts import NOBODY, median_member
from pipeline.stages.collect import data_set
from pipeline.stages.report_replays import looked_at, push_of
from pipeline.stages.segments import segment_spec, world_inputs, world_of
from pipeline.store.design_file import read_design
from pipeline.store.store import Store
from pipeline.workflow.graph import survey
from pipeline.workflow.stage import Files, MissingInputs
from tasks.evolution import evaluate
from tasks.simulation import OK, simulate

WORLDS = tuple(name for name in ENVIRONMENTS if name != "single_member")

FILMS = {".gif": render_gif, ".mp4": render_mp4}
"""How a film is made, by the end of its file's name."""
PAGE = ".html"


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
    """Simulate the design in a file, and show it if asked to.

    A page shows beside the robot what the networks' members disagree about at each link, and how far its state is from
    the throws: in any world, as long as the store holds networks for these settings.

    Args:
        path: of the design file.
        environment: dry_land, true_slush or residual_slush.
        depth: of the ground [m], 0 to DEEPEST.
        out: where to put a GIF, an MP4 or a page, if anywhere; in Residual Slush, of the median member's world.
        settings: how long the design is watched, and which networks residual_slush means.
        open_store: gives the store that holds the networks.
        how_to_run: gives the command line that runs a stage, for messages.

    Returns:
        Lines that say how far the design got.
    """
    design = read_design(path)
    if environment not in WORLDS:
        raise PuddleError(f"--environment: expected one of {', '.join(WORLDS)}, came {environment!r}")
    if not 0.0 <= depth <= DEEPEST:
        raise PuddleError(f"--depth: expected 0 to {DEEPEST:g} m, came {depth:g}")
    world = cast(EnvironmentName, environment)
    kind = None if out is None else out.suffix.lower()
    if out is not None and (kind not in (*FILMS, PAGE) or not out.parent.is_dir()):
        ends = " or ".join((*FILMS, PAGE))
        raise PuddleError(f"--out: expected a file name that ends in {ends}, in a folder that exists, came {out}")
    spec = segment_spec(settings, stage="simulate", environment=world, world=world, depth=depth, trial=0)
    spec["held_out"] = settings.training.held_out
    files: dict[str, Files] = {}
    why = ""
    if world == "residual_slush" or kind == PAGE:
        try:
            files = _learned(settings, open_store, throws=kind == PAGE)
        except PuddleError as missing:
            advice = f". `{how_to_run('study')}` makes it." if isinstance(missing, MissingInputs) else ""
            why = f"{missing}{advice}"
            if world == "residual_slush":
                raise PuddleError(why) from None
    rollouts = simulate(
        design,
        world_of(spec, files),
        n_settle=settings.rollout.n_settle,
        n_measure=settings.rollout.n_measure,
        engine=settings.work.engine,
        trace=out is not None,
        physics=settings.physics,
    )
    if not (rollouts.status == OK).all():
        raise PuddleError(f"{path}: the rollout diverged: a state became non-finite. There is nothing to measure.")
    measured_seconds = settings.rollout.n_measure * settings.physics.time_step
    lines = [f"{STYLES[world].label}, {depth:g} m deep, {measured_seconds:.0f} s:"]
    evaluation = evaluate(rollouts, disagreement_penalty=settings.ensemble.disagreement_penalty)
    root, whole = np.mean(rollouts.displacement), np.mean(rollouts.com_displacement)
    lines.append(f"  root {root:+.3f} m, whole robot {whole:+.3f} m")
    if world == "residual_slush":
        members = ", ".join(f"{value:+.2f}" for value in evaluation.displacement[0])
        lines.append(f"  members {members} m; fitness {evaluation.fitness[0]:+.3f} m")
    if out is not None and rollouts.trace is not None:
        member = median_member(rollouts.displacement[:, 0]) if world == "residual_slush" else NOBODY
        trace = rollouts.trace if member == NOBODY else rollouts.trace[member]
        replay = replay_of(
            design,
            trace[0],
            title=path.stem,
            environment=world,
            world=STYLES[world].label if member == NOBODY else f"{STYLES[world].label} (member {member})",
            depth=depth,
            has_medium=world != "dry_land",
            imagined=world == "residual_slush",
            other_medium=world != "true_slush",
            n_settle=settings.rollout.n_settle,
            time_step=settings.physics.time_step,
            overlays=looked_at(spec, design, trace, files) if kind == PAGE and files else (),
            push=push_of(spec, member, design, trace, files) if kind == PAGE else None,
        )
        if kind == PAGE and why:
            lines.append(f"  shown without what networks say of it: {why}")
        shown = _shown(replay, lines, kind)
        try:
            out.write_bytes(shown)
        except OSError as error:
            raise PuddleError(f"--out: {out} can't be written: {error.strerror}. Name another place.") from None
        lines.append(f"  shown in {out}")
    return lines


def _learned(settings: Settings, open_store: Callable[[], Store], *, throws: bool) -> dict[str, Files]:
    """Read every member of the ensemble, and the throws that they learned from if asked to.

    Raises:
        MissingInputs: names what the store does not hold.
        PuddleError: these settings ask for none; or names what of it is damaged; or `puddle gc` is at work.
    """
    if not settings.needs_ensemble:
        raise PuddleError(
            f"study {settings.name} trains no networks: expected one of {', '.join(RESIDUAL_ENVIRONMENTS)} in "
            f"grid.environments, or a depth of the grid in grid.single_member_depths. Choose the settings of a study "
            f"that trains some: --preset, --settings, --set."
        )
    store = open_store()
    damage: list[str] = []
    with store.lock_to_read():
        upstream = survey(settings, (collect.STAGE, train.STAGE), store, say=damage.append)
        if damage:
            raise PuddleError(damage[0])
        inputs = world_inputs(settings, "residual_slush", 0, upstream)
        if throws:
            inputs |= data_set(upstream["collect"])
        return {name: {file: store.read(of.manifest, file) for file in of.files} for name, of in inputs.items()}


def _shown(replay: Replay, lines: list[str], kind: str | None) -> bytes:
    return render_robot(replay, lines).encode() if kind == PAGE else FILMS[str(kind)]([replay])
