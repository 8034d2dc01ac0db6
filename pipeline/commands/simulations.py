"""Simulation of designs in an environment: one, with a film or a page of it, or a table of them."""

import stat
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipeline.commands.options import SettingsOptions
from pipeline.config.settings import DEEPEST, RESIDUAL_ENVIRONMENTS, Settings
from pipeline.errors import PuddleError
from pipeline.report.films import render_gif, render_mp4
from pipeline.report.page import render_robot
from pipeline.report.replay import Overlay, Replay, replay_of
from pipeline.stages import environments
from pipeline.stages.collect import COLLECT
from pipeline.stages.data_sets import DataSetId, NetworkId, data_sets, ensemble_ids, main_data_set
from pipeline.stages.replays import doubts, push_of, surroundings_in
from pipeline.stages.train import TRAIN
from pipeline.store import disk
from pipeline.store.design_file import read_design
from pipeline.store.design_table import read_designs
from pipeline.store.encoding import encode_table
from pipeline.store.store import Store
from pipeline.store.tables import Columns, csv_of
from pipeline.workflow.graph import survey
from pipeline.workflow.identity import Arm
from pipeline.workflow.stage import Execution, Files, MissingInputs
from tasks.analysis.filmed import NO_MEMBER, median_member
from tasks.design import Designs
from tasks.evolution import OBJECTIVES
from tasks.simulation import OK, Rollouts, simulate
from tasks.world import ENVIRONMENTS, Environment, EnvironmentName

_RENDERERS = {".gif": render_gif, ".mp4": render_mp4}
_PAGE = ".html"
_AT_ONCE = 4096  # designs simulated in one call, to bound the memory
_UNITS = {
    "design": "row of the table, from 0",
    "diverged": "",
    "displacement": "m, of the root; of each member",
    "com_displacement": "m, of the centre of mass; of each member",
}
_Networks = dict[NetworkId, Files]


def simulate_design(
    path: Path, environment: str, depth: float, out: Path | None, options: SettingsOptions
) -> Iterator[str]:
    """Simulate the design in a file, and show it if asked to; yield lines that state its displacement.

    Args:
        path: the design file.
        environment: dry_land, true_slush, residual_slush, or another registered one.
        depth: depth of the ground below the surface [m], 0 to DEEPEST.
        out: the GIF, MP4 or HTML file to write, if any; in an ensemble it shows the median member.
        options: settings, which choose the length of the rollout and the networks; and the store with the networks.

    Raises:
        PuddleError: an argument is invalid, networks are missing, the rollout diverges, or a file can't be written.
    """
    settings, design, name = options.settings(), read_design(path), _checked(environment, depth)
    kind = "" if out is None else _kind_of(out)
    networks: _Networks = {}
    if name in RESIDUAL_ENVIRONMENTS:
        networks = _required_networks(options, settings, name)
    elif kind == _PAGE:
        networks = _optional_networks(options, settings)
    shown = _Simulated(settings, design, depth, networks)
    rollouts = shown.rollouts(name, trace=out is not None)
    if not (rollouts.status == OK).all():
        raise PuddleError(f"{path}: the rollout diverged: a state is not finite, so there is no displacement.")
    label, n_steps = ENVIRONMENTS[name].label, settings.rollout.n_measure
    lines = [f"{label}, {depth:g} m deep, {n_steps * settings.physics.time_step:.0f} s:"]
    root, whole = np.mean(rollouts.displacement), np.mean(rollouts.com_displacement)
    lines.append(f"  root {root:+.3f} m, centre of mass {whole:+.3f} m")
    if ENVIRONMENTS[name].is_ensemble:
        fitness = environments.fitness_spec(settings, name)
        simulation, at = shown.environment(name)
        scores = environments.evaluate_designs(design, simulation, Execution(settings.work.engine), at, fitness)
        members = ", ".join(f"{value:+.2f}" for value in scores.displacement[0])
        objective = OBJECTIVES[fitness.objective]
        lines.append(
            f"  members {members} m; fitness ({objective.label.lower()}) {scores.fitness[0]:+.3f} {objective.unit}"
        )
    yield from lines
    if out is None:
        return
    replay = shown.replay(name, rollouts, path.stem, seen_from_networks=kind == _PAGE)
    if kind in _RENDERERS:
        content = _RENDERERS[kind]([replay])
    else:
        content = render_robot(replay, lines, shown.beside(name, path.stem)).encode()
    with disk.explained(f"--out: writing {out}", out, advice="choose another file"):
        out.write_bytes(content)
    yield f"  shown in {out}"


class _Simulated:
    """One design in several environments at one depth."""

    def __init__(self, settings: Settings, design: Designs, depth: float, networks: _Networks) -> None:
        self._settings, self._design, self._depth, self._networks = settings, design, depth, networks

    def environment(self, name: EnvironmentName) -> tuple[environments.SimulationSpec, Environment]:
        """Return the settings of simulations in an environment, and the environment."""
        simulation = environments.simulation_spec(self._settings, name)
        return simulation, environments.build_environment(simulation.media, name, self._depth, self._networks)

    def rollouts(self, name: EnvironmentName, *, trace: bool) -> Rollouts:
        """Simulate the design in an environment."""
        settings = self._settings
        return simulate(
            self._design,
            self.environment(name)[1],
            n_settle=settings.rollout.n_settle,
            n_measure=settings.rollout.n_measure,
            engine=settings.work.engine,
            trace=trace,
            physics=settings.physics,
        )

    def replay(self, name: EnvironmentName, rollouts: Rollouts, title: str, *, seen_from_networks: bool) -> Replay:
        """Return the replay of a rollout: of the median member in an ensemble."""
        assert rollouts.trace is not None
        settings, kind = self._settings, ENVIRONMENTS[name]
        member = median_member(rollouts.displacement[:, 0]) if kind.is_ensemble else NO_MEMBER
        trace = rollouts.trace if member == NO_MEMBER else rollouts.trace[member]
        overlays: tuple[Overlay, ...] = ()
        push = None
        if seen_from_networks:
            simulation, _ = self.environment(name)
            learned = None
            if self._networks:
                overlays = doubts(simulation, self._design, trace, environments.ensemble_of(self._networks))
                learned = environments.ensemble_of(dict([list(self._networks.items())[member]]))
            push = push_of(simulation, Arm(name, self._depth), member, self._design, trace, learned)
        return replay_of(
            self._design,
            trace[0],
            title=title,
            environment="",  # where it evolved, which a design file does not say
            seen_in=kind.label if member == NO_MEMBER else f"{kind.label} (member {member})",
            depth=self._depth,
            surroundings=surroundings_in(name),
            n_settle=settings.rollout.n_settle,
            time_step=settings.physics.time_step,
            overlays=overlays,
            push=push,
        )

    def beside(self, name: EnvironmentName, title: str) -> list[Replay]:
        """Return the replay in the other environment: the networks' for True Slush, True Slush for a network's."""
        if not self._networks or (ENVIRONMENTS[name].networks == "none" and name != "true_slush"):
            return []
        other: EnvironmentName = "true_slush"
        if name == other:
            group = next(iter(self._networks)).data_set.group
            other = next(n for n, kind in ENVIRONMENTS.items() if kind.networks == "all" and kind.learns_from == group)
        rollouts = self.rollouts(other, trace=True)
        finite = bool((rollouts.status == OK).all())
        return [self.replay(other, rollouts, title, seen_from_networks=True)] if finite else []


def score_designs(
    path: Path, environment: str, depth: float, out: Path | None, options: SettingsOptions
) -> Iterator[str]:
    """Score the designs of a table; yield lines that summarise the scores.

    Args:
        path: the table of designs; see :func:`pipeline.store.design_table.read_designs`.
        environment: dry_land, true_slush, residual_slush, or another registered one.
        depth: depth of the ground below the surface [m], 0 to DEEPEST.
        out: the Parquet or CSV file to write, if any.
        options: settings, which choose the length of the rollout and the networks; and the store with the networks.

    Raises:
        PuddleError: an argument is invalid, networks are missing, or a file can't be read or written.
    """
    settings, name = options.settings(), _checked(environment, depth)
    if out is not None and (out.suffix not in (".parquet", ".csv") or not out.parent.is_dir() or out.is_dir()):
        raise PuddleError(
            f"--out: expected a file name that ends in .parquet or .csv, in an existing folder, got {out}"
        )
    designs = read_designs(path)
    networks = _required_networks(options, settings, name) if name in RESIDUAL_ENVIRONMENTS else {}
    simulation = environments.simulation_spec(settings, name)
    at = environments.build_environment(simulation.media, name, depth, networks)
    execution, fitness = Execution(settings.work.engine), environments.fitness_spec(settings, name)
    parts: list[Columns] = []
    for first in range(0, len(designs), _AT_ONCE):
        scores = environments.evaluate_designs(designs[first : first + _AT_ONCE], simulation, execution, at, fitness)
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
    label, n_diverged = ENVIRONMENTS[name].label, int(table["diverged"].sum())
    yield f"{label}, {depth:g} m deep: {len(designs)} design{'s' * (len(designs) != 1)}, {n_diverged} diverged"
    objective = OBJECTIVES[settings.evolution.objective]
    finite = table["fitness"][~table["diverged"]]
    if len(finite):
        mean, median, best = (
            f"{value:z.2f} {objective.unit}" for value in (finite.mean(), np.median(finite), finite.max())
        )
        yield f"  fitness ({objective.label.lower()}): mean {mean}, median {median}"
        yield f"  best: design {int(np.argmax(table['fitness']))}, {best}"
    if out is not None:
        units = {**_UNITS, "fitness": objective.unit}
        content = encode_table(table, schema="scores", version=1, producer=str(path), units=units)
        with disk.explained("writing scores", out, advice="choose another file"):
            out.write_bytes(content if out.suffix == ".parquet" else csv_of(table))
        yield f"  scores in {out}"


def _checked(environment: str, depth: float) -> EnvironmentName:
    """Return the name of an environment; refuse an unknown one, and a depth outside of the allowed range."""
    names: dict[str, EnvironmentName] = {name: name for name, kind in ENVIRONMENTS.items() if kind.networks != "one"}
    if environment not in names:
        raise PuddleError(f"--environment: expected one of {', '.join(names)}, got {environment!r}")
    if not 0.0 <= depth <= DEEPEST:
        raise PuddleError(f"--depth: expected 0 to {DEEPEST:g} m, got {depth:g}")
    return names[environment]


def _kind_of(out: Path) -> str:
    """Return the suffix of the file to write; refuse a path that can't be one before anything is simulated."""
    kind = out.suffix.lower()
    try:
        if kind not in (*_RENDERERS, _PAGE) or not out.parent.is_dir():
            suffixes = " or ".join((*_RENDERERS, _PAGE))
            raise PuddleError(f"--out: expected a file name that ends in {suffixes}, in an existing folder, got {out}")
        if not stat.S_ISREG(out.stat().st_mode):  # writing to a pipe would wait for its reader
            raise PuddleError(f"--out: expected a new file or one to replace, got {out}, which is not a regular file")
    except FileNotFoundError:
        pass
    except OSError as error:
        raise PuddleError(f"--out: can't write {out}: {error.strerror}. Choose another file.") from None
    return kind


# -- networks --------------------------------------------------------------------------------------------------------


def _required_networks(options: SettingsOptions, settings: Settings, environment: EnvironmentName) -> _Networks:
    """Return every member of an environment's ensemble.

    With several replicates it is the ensemble of the first.

    Raises:
        PuddleError: the settings train no such networks, a network is missing, or the store is damaged.
    """
    data_set = DataSetId(ENVIRONMENTS[environment].learns_from, 0)
    if data_set not in data_sets(settings):
        raise PuddleError(
            f"study {settings.name} trains no networks for {environment}: expected it in grid.environments. Choose the "
            f"settings of a study that does: --study, --preset, --settings, --set."
        )
    try:
        return _networks(settings, options.open_store(), data_set)
    except MissingInputs as missing:
        raise PuddleError(f"{missing}. `{options.command('study')}` computes it.") from None


def _optional_networks(options: SettingsOptions, settings: Settings) -> _Networks:
    """Return the main ensemble, or nothing if the store has none for these settings."""
    store = options.find_store() if settings.needs_ensemble else None
    try:
        return {} if store is None else _networks(settings, store, main_data_set(settings))
    except MissingInputs:
        return {}


def _networks(settings: Settings, store: Store, data_set: DataSetId) -> _Networks:
    damage: list[str] = []
    with store.lock_to_read():
        record = store.read_study(settings.name)
        upstream = survey(settings, (COLLECT, TRAIN), store, record=record, say=damage.append).upstream
        if damage:
            raise PuddleError(damage[0])
        inputs = environments.network_inputs(ensemble_ids(settings, data_set), upstream)
        return environments.networks_among({name: source.read(store) for name, source in inputs.items()})
