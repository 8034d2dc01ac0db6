"""The trained networks of a study, for commands that simulate designs in Residual Slush."""

from collections.abc import Callable

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS, Settings
from pipeline.errors import PuddleError
from pipeline.stages import environments
from pipeline.stages.collect import COLLECT, data_set
from pipeline.stages.train import TRAIN
from pipeline.store.store import Store
from pipeline.workflow.graph import survey
from pipeline.workflow.identity import InputName
from pipeline.workflow.stage import Files


def trained_networks(settings: Settings, open_store: Callable[[], Store], *, throws: bool) -> dict[InputName, Files]:
    """Return every member of the ensemble, and the throws that they learned from if asked to.

    Args:
        settings: the settings of the networks.
        open_store: opens the store that holds them.
        throws: whether to read the throws, too.

    Raises:
        PuddleError: the settings train no networks, a network is missing, or the store is damaged.
    """
    if not settings.needs_ensemble:
        raise PuddleError(
            f"study {settings.name} trains no networks: expected one of {', '.join(RESIDUAL_ENVIRONMENTS)} in "
            f"grid.environments, or a depth of the grid in grid.single_member_depths. Choose the settings of a study "
            f"that trains networks: --preset, --settings, --set."
        )
    store = open_store()
    damage: list[str] = []
    with store.lock_to_read():
        upstream = survey(settings, (COLLECT, TRAIN), store, say=damage.append)
        if damage:
            raise PuddleError(damage[0])
        inputs = environments.member_inputs(settings, "residual_slush", 0, upstream)
        if throws:
            inputs |= data_set(upstream["collect"])
        return {name: {file: store.read(of.manifest, file) for file in of.files} for name, of in inputs.items()}
