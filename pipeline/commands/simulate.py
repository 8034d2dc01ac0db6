"""puddle simulate: how far one design gets, with a film or a page of it."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pipeline.commands.chosen_environment import (
    DepthOption,
    EngineOption,
    EnvironmentOption,
    Networks,
    checked_environment,
    optional_networks,
    required_networks,
)
from pipeline.commands.options import SettingsOptions, output_suffix, with_options
from pipeline.commands.terminal import to_stdout
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.report.films import RENDERERS
from pipeline.report.page import render_robot
from pipeline.stages import environments
from pipeline.stages.replays import replay_in
from pipeline.store import disk
from pipeline.store.design_file import load_design
from pipeline.workflow.stage import Execution
from tasks.design import Designs
from tasks.evolution import OBJECTIVES
from tasks.residual import arm_kind
from tasks.simulation import OK, Rollouts
from tasks.world import EnsembleMedium, Environment, EnvironmentName

_PAGE = ".html"


@with_options
def simulate(
    path: Annotated[Path, typer.Argument(metavar="DESIGN", help="A design file (design.json).")],
    depth: DepthOption,
    options: SettingsOptions,
    environment: EnvironmentOption = None,
    engine: EngineOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write a film (.gif, .mp4) or a page (.html).")] = None,
) -> None:
    """Simulate one design, print its displacement, and show it.

    The settings choose the length of the rollout. residual_slush uses the networks that the store holds for these
    settings. Where there are networks, a page shows the design in the target and residual_slush side by side, and by
    colours where the networks disagree. Of an ensemble the film shows the median member.
    """
    settings, design = options.settings(to_compute=False), load_design(path)
    name = checked_environment(settings, environment, depth)
    suffix = "" if out is None else output_suffix(out, (*RENDERERS, _PAGE))
    networks: Networks = {}
    if name in settings.learners:
        networks = required_networks(options, settings, name)
    elif suffix == _PAGE:
        networks = optional_networks(options, settings)
    ensemble = environments.ensemble_of(networks) if networks else None
    execution = Execution(engine or settings.work.engine)
    at, rollouts = _rolled_out(settings, execution, design, name, depth, ensemble, trace=out is not None)
    if not (rollouts.status == OK).all():
        raise PuddleError(f"{path}: the rollout diverged: a state is not finite, so there is no displacement.")
    label, n_steps = arm_kind(name, settings.arm_learners).label, settings.rollout.n_measure
    lines = [f"{label}, {depth:g} m deep, {n_steps * settings.physics.time_step:.0f} s:"]
    root, whole = np.mean(rollouts.displacement), np.mean(rollouts.com_displacement)
    lines.append(f"  root {root:+.3f} m, centre of mass {whole:+.3f} m")
    objective = settings.evolution.maximised
    if (at.is_ensemble or not objective.is_papers) and objective.name in OBJECTIVES:
        fitness, simulation = environments.fitness_spec(settings, name), environments.simulation_spec(settings, name)
        scores = environments.evaluate_designs(design, simulation, execution, at, fitness)
        members = ", ".join(f"{value:+.2f}" for value in scores.displacement[0])
        said = f"fitness ({objective.label.lower()}) {scores.fitness[0]:+.3f} {objective.unit}".strip()
        lines.append(f"  members {members} m; {said}" if at.is_ensemble else f"  {said}")
    to_stdout(*lines)
    if out is None:
        return
    is_page = suffix == _PAGE
    seen, replays = [(name, at, rollouts)], []
    if is_page and networks and (other := _other(settings.target, name, networks)):
        seen.append((other, *_rolled_out(settings, execution, design, other, depth, ensemble, trace=True)))
    for where, there, rolled_out in seen:
        kind, shown = arm_kind(where, settings.arm_learners), ensemble if is_page else None
        simulation = environments.simulation_spec(settings, where)
        replays.append(replay_in(design, rolled_out, kind, there, simulation, title=path.stem, ensemble=shown))
    first, *beside = (replay for replay in replays if replay)
    content = RENDERERS[suffix]([first]) if suffix in RENDERERS else render_robot(first, lines, beside).encode()
    disk.write(out, content)
    to_stdout(f"  shown in {out}")


def _rolled_out(
    settings: Settings,
    execution: Execution,
    design: Designs,
    name: EnvironmentName,
    depth: float,
    ensemble: EnsembleMedium | None,
    *,
    trace: bool,
) -> tuple[Environment, Rollouts]:
    """Simulate a design in an environment."""
    simulation = environments.simulation_spec(settings, name)
    at = environments.environment_of(simulation.media, name, depth, ensemble)
    return at, environments.roll_out(simulation, execution, at, design, trace=trace)


def _other(target: EnvironmentName, name: EnvironmentName, networks: Networks) -> EnvironmentName | None:
    """Return the environment to show beside one: the networks' for the target, the target for a network's."""
    if name == target:
        return next(iter(networks)).data_set.learner
    return target if arm_kind(name).learned else None
