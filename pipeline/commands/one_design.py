"""Simulation of one design: its displacement, a film of it, or a page with what the networks say about it."""

import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.commands.trained_networks import trained_networks
from pipeline.config.settings import DEEPEST, Settings
from pipeline.errors import PuddleError
from pipeline.report.films import render_gif, render_mp4
from pipeline.report.page import render_robot
from pipeline.report.replay import replay_of
from pipeline.stages import environments
from pipeline.stages.data_sets import NetworkId
from pipeline.stages.replays import doubts, push_of, surroundings_in
from pipeline.store.design_file import read_design
from pipeline.store.store import Store
from pipeline.workflow.identity import Arm, InputName
from pipeline.workflow.stage import Execution, Files, MissingInputs
from tasks.analysis.filmed import NO_MEMBER, median_member
from tasks.evolution import OBJECTIVES
from tasks.simulation import OK, simulate
from tasks.world import ENVIRONMENTS

_ENVIRONMENTS = tuple(name for name, kind in ENVIRONMENTS.items() if kind.networks != "one")
_RENDERERS = {".gif": render_gif, ".mp4": render_mp4}
_PAGE_SUFFIX = ".html"


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
    """Return lines that state the displacement of the design in a file, and show it if asked to.

    A page shows the members' disagreement at each link, in any environment, as long as the store holds networks for
    these settings.

    Args:
        path: the design file.
        environment: dry_land, true_slush, residual_slush, or another registered one.
        depth: depth of the ground below the surface [m], 0 to DEEPEST.
        out: the GIF, MP4 or HTML file to write, if any; in an ensemble it shows the median member.
        settings: they choose the length of the rollout, and the networks of residual_slush.
        open_store: opens the store that holds the networks.
        how_to_run: returns the command line that runs a command, for messages.

    Raises:
        PuddleError: an argument is invalid, networks are missing, the rollout diverges, or a file can't be written.
    """
    design = read_design(path)
    if environment not in _ENVIRONMENTS:
        raise PuddleError(f"--environment: expected one of {', '.join(_ENVIRONMENTS)}, got {environment!r}")
    if not 0.0 <= depth <= DEEPEST:
        raise PuddleError(f"--depth: expected 0 to {DEEPEST:g} m, got {depth:g}")
    kind = None if out is None else _kind_of(out)
    simulation = environments.simulation_spec(settings, environment)
    files: dict[InputName, Files] = {}
    why, is_page = "", kind == _PAGE_SUFFIX
    needs_networks = ENVIRONMENTS[environment].networks == "all"
    if needs_networks or is_page:
        try:
            files = trained_networks(settings, open_store, environment)
        except PuddleError as missing:
            advice = f". `{how_to_run('study')}` computes it." if isinstance(missing, MissingInputs) else ""
            why = f"{missing}{advice}"
            if needs_networks:
                raise PuddleError(why) from None
    at = environments.build_environment(simulation.media, environment, depth, files)
    rollouts = simulate(
        design,
        at,
        n_settle=settings.rollout.n_settle,
        n_measure=settings.rollout.n_measure,
        engine=settings.work.engine,
        trace=out is not None,
        physics=settings.physics,
    )
    if not (rollouts.status == OK).all():
        raise PuddleError(f"{path}: the rollout diverged: a state is not finite, so there is no displacement.")
    measured_seconds = settings.rollout.n_measure * settings.physics.time_step
    label = ENVIRONMENTS[environment].label
    lines = [f"{label}, {depth:g} m deep, {measured_seconds:.0f} s:"]
    root, whole = np.mean(rollouts.displacement), np.mean(rollouts.com_displacement)
    lines.append(f"  root {root:+.3f} m, whole robot {whole:+.3f} m")
    if ENVIRONMENTS[environment].is_ensemble:
        fitness, execution = environments.fitness_spec(settings, environment), Execution(settings.work.engine)
        evaluation = environments.evaluate_designs(design, simulation, execution, at, fitness)
        members = ", ".join(f"{value:+.2f}" for value in evaluation.displacement[0])
        objective = OBJECTIVES[fitness.objective]
        lines.append(
            f"  members {members} m; fitness ({objective.label.lower()}) {evaluation.fitness[0]:+.3f} {objective.unit}"
        )
    if out is not None and rollouts.trace is not None:
        member = median_member(rollouts.displacement[:, 0]) if ENVIRONMENTS[environment].is_ensemble else NO_MEMBER
        trace = rollouts.trace if member == NO_MEMBER else rollouts.trace[member]
        network = NetworkId(environments.main_data_set_among(files), member) if files else None
        replay = replay_of(
            design,
            trace[0],
            title=path.stem,
            environment="",  # where it evolved, which a design file does not say
            seen_in=label if member == NO_MEMBER else f"{label} (member {member})",
            depth=depth,
            surroundings=surroundings_in(environment),
            n_settle=settings.rollout.n_settle,
            time_step=settings.physics.time_step,
            overlays=doubts(simulation, design, trace, environments.ensemble_of(files)) if is_page and files else (),
            push=push_of(simulation, Arm(environment, depth), member, design, trace, files, network)
            if is_page
            else None,
        )
        if is_page and why:
            lines.append(f"  shown without the networks' view: {why}")
        content = _RENDERERS[kind]([replay]) if kind in _RENDERERS else render_robot(replay, lines).encode()
        try:
            out.write_bytes(content)
        except OSError as error:
            raise PuddleError(f"--out: can't write {out}: {error.strerror}. Choose another file.") from None
        lines.append(f"  shown in {out}")
    return lines


def _kind_of(out: Path) -> str:
    """Return the suffix of the file to write; refuse a path that can't be one before anything is simulated."""
    kind = out.suffix.lower()
    try:
        if kind not in (*_RENDERERS, _PAGE_SUFFIX) or not out.parent.is_dir():
            suffixes = " or ".join((*_RENDERERS, _PAGE_SUFFIX))
            raise PuddleError(f"--out: expected a file name that ends in {suffixes}, in an existing folder, got {out}")
        if not stat.S_ISREG(out.stat().st_mode):  # writing to a pipe would wait for its reader
            raise PuddleError(f"--out: expected a new file or one to replace, got {out}, which is not a regular file")
    except FileNotFoundError:
        pass
    except OSError as error:
        raise PuddleError(f"--out: can't write {out}: {error.strerror}. Choose another file.") from None
    return kind
