"""The trained networks of a study, for commands that simulate designs in Residual Slush."""

from collections.abc import Callable

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS, Settings
from pipeline.errors import PuddleError
from pipeline.stages import environments
from pipeline.stages.collect import COLLECT
from pipeline.stages.data_sets import DataSetId, data_sets, main_data_set
from pipeline.stages.train import TRAIN
from pipeline.store.store import Store
from pipeline.workflow.identity import InputName
from pipeline.workflow.recorded import recorded_results
from pipeline.workflow.stage import Files
from tasks.world import ENVIRONMENTS, EnvironmentName


def trained_networks(
    settings: Settings, open_store: Callable[[], Store], environment: EnvironmentName
) -> dict[InputName, Files]:
    """Return every member of an environment's ensemble.

    With several replicates it is the ensemble of the first.

    Args:
        settings: the settings of the networks.
        open_store: opens the store that holds them.
        environment: residual_slush, designed_throws, or one without networks, which gets the main ensemble.

    Raises:
        PuddleError: the settings train no networks, a network is missing, or the store is damaged.
    """
    if not settings.needs_ensemble:
        raise PuddleError(
            f"study {settings.name} trains no networks: expected one of {', '.join(RESIDUAL_ENVIRONMENTS)} in "
            f"grid.environments, or a depth of the grid in grid.single_member_depths. Choose the settings of a study "
            f"that trains networks: --preset, --settings, --set."
        )
    kind, main = ENVIRONMENTS[environment], main_data_set(settings)
    data_set = main if kind.networks == "none" else DataSetId(kind.learns_from, 0)
    if data_set not in data_sets(settings):
        raise PuddleError(
            f"study {settings.name} trains no networks for {environment}: expected it in grid.environments. Choose the "
            f"settings of another study: --preset, --settings, --set."
        )
    store = open_store()
    damage: list[str] = []
    with store.lock_to_read():
        record = store.read_study(settings.name)
        upstream = recorded_results(settings, record, (COLLECT, TRAIN), store, say=damage.append).upstream
        if damage:
            raise PuddleError(damage[0])
        inputs = environments.ensemble_inputs(settings, data_set, upstream)
        return {
            name: {file: store.read(source.manifest, file) for file in source.files} for name, source in inputs.items()
        }
