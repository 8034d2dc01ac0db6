"""The environment that `puddle simulate` and `puddle score` simulate in, and the networks of it."""

from typing import Annotated

import typer

from pipeline.commands.options import SettingsOptions
from pipeline.commands.terminal import to_stderr
from pipeline.config.settings import DEEPEST, Settings
from pipeline.errors import PuddleError
from pipeline.stages import environments
from pipeline.stages.collect import COLLECT
from pipeline.stages.data_sets import DataSetId, NetworkId, data_sets, ensemble_ids
from pipeline.stages.train import TRAIN
from pipeline.store.store import Store
from pipeline.workflow.graph import survey
from pipeline.workflow.stage import Files, MissingInputs
from tasks.discovery import with_failures
from tasks.world import EnvironmentName

EnvironmentOption = Annotated[
    str | None, typer.Option("--environment", help="The environment, by default the target; a wrong name lists all.")
]
DepthOption = Annotated[float, typer.Option("--depth", help="Depth of the ground below the surface [m].")]
EngineOption = Annotated[str | None, typer.Option("--engine", help="Simulate in another engine, such as mujoco.")]
Networks = dict[NetworkId, Files]


def checked_environment(settings: Settings, environment: str | None, depth: float) -> EnvironmentName:
    """Return the name of an environment, by default the target; refuse an unknown one, and a depth out of range."""
    environment = settings.target if environment is None else environment
    known = {name: settings.learner(name) for name in settings.simulated_environments}
    names = [name for name, learner in known.items() if learner is None or not learner.is_single]
    if environment not in names:
        raise PuddleError(with_failures(f"--environment: expected one of {', '.join(names)}, got {environment!r}"))
    if not 0.0 <= depth <= DEEPEST:
        raise PuddleError(f"--depth: expected 0 to {DEEPEST:g} m, got {depth:g}")
    return environment


def required_networks(options: SettingsOptions, settings: Settings, environment: EnvironmentName) -> Networks:
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
        raise PuddleError(
            f"{missing}. `puddle study` with the same settings computes it. {_studies(options)}"
        ) from None


def _studies(options: SettingsOptions) -> str:
    names = store.studies() if (store := options.find_store()) else []
    return f"{options.store} holds studies, for --study: {', '.join(names) or 'none'}"


def optional_networks(options: SettingsOptions, settings: Settings) -> Networks:
    """Return the main ensemble, or nothing if the store has none for these settings."""
    store = options.find_store() if settings.needs_ensemble else None
    try:
        return {} if store is None else _networks(settings, store, data_sets(settings)[0])
    except MissingInputs:
        return {}


def _networks(settings: Settings, store: Store, data_set: DataSetId) -> Networks:
    damage: list[str] = []
    record = store.read_study(settings.name)
    found = survey(settings, (COLLECT, TRAIN), store, record=record, say=damage.append)
    if damage:
        raise PuddleError(damage[0])
    networks = environments.read_networks(ensemble_ids(settings, data_set), found.upstream, store)
    if record is not None and (note := found.note(settings.name)):
        to_stderr(note)
    return networks
