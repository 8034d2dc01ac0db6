"""Simulation of designs in an environment: one, with a film or a page of it, or a table of them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipeline.commands.options import SettingsOptions, output_suffix
from pipeline.commands.terminal import to_stderr
from pipeline.config.settings import DEEPEST, Settings
from pipeline.errors import PuddleError
from pipeline.report.films import RENDERERS
from pipeline.report.page import render_robot
from pipeline.stages import environments
from pipeline.stages.collect import COLLECT
from pipeline.stages.data_sets import DataSetId, NetworkId, data_sets, ensemble_ids
from pipeline.stages.replays import replay_in
from pipeline.stages.train import TRAIN
from pipeline.store import disk
from pipeline.store.design_file import columns_of_designs, load_design, open_designs
from pipeline.store.encoding import encode_table
from pipeline.store.store import Store
from pipeline.store.tables import Columns, csv_of
from pipeline.workflow.graph import survey
from pipeline.workflow.stage import Execution, Files, MissingInputs
from tasks.design import Designs
from tasks.discovery import FAILURES
from tasks.evolution import OBJECTIVES
from tasks.residual import arm_kind, ensemble_of_data_set
from tasks.simulation import OK, Rollouts
from tasks.world import EnsembleMedium, Environment, EnvironmentName, environment_kind

_PAGE = ".html"
_AT_ONCE, _WITH_TRACE = 4096, 64  # designs simulated in one call, to bound the memory
_UNITS = {
    "design": "row of the table, from 0",
    "diverged": "",
    "displacement": "m, of the root; of each member",
    "com_displacement": "m, of the centre of mass; of each member",
}
_Networks = dict[NetworkId, Files]


def simulate_design(
    path: Path, environment: str | None, depth: float, out: Path | None, options: SettingsOptions
) -> Iterator[str]:
    """Simulate the design in a file, and show it if asked to; yield lines that state its displacement.

    In an ensemble the median member is shown.
    """
    settings, design = options.settings(to_compute=False), load_design(path)
    name = _checked(settings, environment, depth)
    suffix = "" if out is None else output_suffix(out, (*RENDERERS, _PAGE))
    networks: _Networks = {}
    if environment_kind(name).learned:
        networks = _required_networks(options, settings, name)
    elif suffix == _PAGE:
        networks = _optional_networks(options, settings)
    ensemble = environments.ensemble_of(networks) if networks else None
    at, rollouts = _rolled_out(settings, design, name, depth, ensemble, trace=out is not None)
    if not (rollouts.status == OK).all():
        raise PuddleError(f"{path}: the rollout diverged: a state is not finite, so there is no displacement.")
    label, n_steps = arm_kind(name, settings.arm_learners).label, settings.rollout.n_measure
    lines = [f"{label}, {depth:g} m deep, {n_steps * settings.physics.time_step:.0f} s:"]
    root, whole = np.mean(rollouts.displacement), np.mean(rollouts.com_displacement)
    lines.append(f"  root {root:+.3f} m, centre of mass {whole:+.3f} m")
    objective = settings.evolution.maximised
    if (at.is_ensemble or not objective.is_papers) and objective.name in OBJECTIVES:
        fitness, simulation = environments.fitness_spec(settings, name), environments.simulation_spec(settings, name)
        scores = environments.evaluate_designs(design, simulation, Execution(settings.work.engine), at, fitness)
        members = ", ".join(f"{value:+.2f}" for value in scores.displacement[0])
        said = f"fitness ({objective.label.lower()}) {scores.fitness[0]:+.3f} {objective.unit}".strip()
        lines.append(f"  members {members} m; {said}" if at.is_ensemble else f"  {said}")
    yield from lines
    if out is None:
        return
    is_page = suffix == _PAGE
    seen, replays = [(name, at, rollouts)], []
    if is_page and networks and (other := _other(settings.target, name, networks)):
        seen.append((other, *_rolled_out(settings, design, other, depth, ensemble, trace=True)))
    for where, there, rolled_out in seen:
        kind, shown = arm_kind(where, settings.arm_learners), ensemble if is_page else None
        simulation = environments.simulation_spec(settings, where)
        replays.append(replay_in(design, rolled_out, kind, there, simulation, title=path.stem, ensemble=shown))
    first, *beside = (replay for replay in replays if replay)
    content = RENDERERS[suffix]([first]) if suffix in RENDERERS else render_robot(first, lines, beside).encode()
    disk.write(out, content)
    yield f"  shown in {out}"


def _rolled_out(
    settings: Settings,
    design: Designs,
    name: EnvironmentName,
    depth: float,
    ensemble: EnsembleMedium | None,
    *,
    trace: bool,
) -> tuple[Environment, Rollouts]:
    """Simulate a design in an environment."""
    simulation = environments.simulation_spec(settings, name)
    at = environment_kind(name).environment(depth, simulation.media, ensemble)
    return at, environments.roll_out(simulation, Execution(settings.work.engine), at, design, trace=trace)


def _other(target: EnvironmentName, name: EnvironmentName, networks: _Networks) -> EnvironmentName | None:
    """Return the environment to show beside one: the networks' for the target, the target for a network's."""
    if name == target:
        return ensemble_of_data_set(next(iter(networks)).data_set.group)
    return target if environment_kind(name).learned else None


def score_designs(
    path: Path, environment: str | None, depth: float, out: Path | None, options: SettingsOptions
) -> Iterator[str]:
    """Score the designs of a table; yield lines that summarise the scores."""
    settings = options.settings(to_compute=False)
    name, objective = _checked(settings, environment, depth), settings.evolution.maximised
    if objective.name not in OBJECTIVES:
        raise PuddleError(f"study {settings.name}: expected the code of its objective {objective.name}, found none")
    if out is not None:
        output_suffix(out, (".parquet", ".csv"))
    designs = open_designs(path)
    networks = _required_networks(options, settings, name) if environment_kind(name).learned else {}
    simulation = environments.simulation_spec(settings, name)
    at = environments.build_environment(simulation.media, name, depth, networks)
    execution, fitness = Execution(settings.work.engine), environments.fitness_spec(settings, name)
    parts: list[Columns] = []
    at_once = _WITH_TRACE if objective.trace else _AT_ONCE
    for first in range(0, len(designs), at_once):
        scores = environments.evaluate_designs(designs[first : first + at_once], simulation, execution, at, fitness)
        parts.append(
            {
                "diverged": np.isneginf(scores.fitness),
                "fitness": scores.fitness,
                "displacement": scores.displacement if at.is_ensemble else scores.displacement[:, 0],
                "com_displacement": scores.com_displacement if at.is_ensemble else scores.com_displacement[:, 0],
            }
        )
    table = {column: np.concatenate([part[column] for part in parts]) for column in parts[0]}
    table = {"design": np.arange(len(designs)), **table}
    label, n_diverged = arm_kind(name, settings.arm_learners).label, int(table["diverged"].sum())
    yield f"{label}, {depth:g} m deep: {len(designs)} design{'s' * (len(designs) != 1)}, {n_diverged} diverged"
    finite = table["fitness"][~table["diverged"]]
    if len(finite):
        mean, median, best = (
            f"{value:z.2f} {objective.unit}".strip() for value in (finite.mean(), np.median(finite), finite.max())
        )
        yield f"  fitness ({objective.label.lower()}): mean {mean}, median {median}"
        yield f"  best: design {int(np.argmax(table['fitness']))}, {best}"
    if out is not None:
        units = {**_UNITS, "fitness": objective.unit}
        table = {**columns_of_designs(path), **table}
        content = encode_table(table, schema="scores", version=1, producer=str(path), units=units)
        disk.write(out, content if out.suffix == ".parquet" else csv_of(table))
        yield f"  scores in {out}"


def _checked(settings: Settings, environment: str | None, depth: float) -> EnvironmentName:
    """Return the name of an environment, by default the target; refuse an unknown one, and a depth out of range."""
    environment = settings.target if environment is None else environment
    known = {name: settings.learner(name) for name in settings.simulated_environments}
    names = [name for name, learner in known.items() if learner is None or not learner.is_single]
    if environment not in names:
        mistake = f"--environment: expected one of {', '.join(names)}, got {environment!r}"
        raise PuddleError("; ".join([mistake, *FAILURES]))
    if not 0.0 <= depth <= DEEPEST:
        raise PuddleError(f"--depth: expected 0 to {DEEPEST:g} m, got {depth:g}")
    return environment


# -- networks --------------------------------------------------------------------------------------------------------


def _required_networks(options: SettingsOptions, settings: Settings, environment: EnvironmentName) -> _Networks:
    """Return every member of an environment's ensemble; of several replicates, that of the first."""
    learner = settings.learner(environment)
    data_set = DataSetId(learner.data_set if learner else "", 0)
    if data_set not in data_sets(settings):
        raise PuddleError(
            f"study {settings.name} trains no networks for {environment}: expected it in grid.environments. Choose the "
            f"settings of a study that does: --study, --preset, --settings, --set. {_studies(options)}"
        )
    try:
        return _networks(settings, options.open_store(), data_set)
    except MissingInputs as missing:
        raise PuddleError(f"{missing}. `{options.command('study')}` computes it. {_studies(options)}") from None


def _studies(options: SettingsOptions) -> str:
    names = store.studies() if (store := options.find_store()) else []
    return f"{options.store} holds studies, for --study: {', '.join(names) or 'none'}"


def _optional_networks(options: SettingsOptions, settings: Settings) -> _Networks:
    """Return the main ensemble, or nothing if the store has none for these settings."""
    store = options.find_store() if settings.needs_ensemble else None
    try:
        return {} if store is None else _networks(settings, store, data_sets(settings)[0])
    except MissingInputs:
        return {}


def _networks(settings: Settings, store: Store, data_set: DataSetId) -> _Networks:
    damage: list[str] = []
    record = store.read_study(settings.name)
    found = survey(settings, (COLLECT, TRAIN), store, record=record, say=damage.append)
    if damage:
        raise PuddleError(damage[0])
    networks = environments.read_networks(ensemble_ids(settings, data_set), found.upstream, store)
    if record is not None and (note := found.note(settings.name)):
        to_stderr(note)
    return networks
