"""Data sets of throws, and the networks that learn from them: which of them each trial uses.

A study has one data set for each settings group of throws and each replicate.
"""

from dataclasses import dataclass

from pipeline.config.settings import Settings
from pipeline.workflow.identity import TrialId, trials_of
from tasks.world import ENVIRONMENTS

PAPERS_GROUP = "throws"


@dataclass(frozen=True)
class DataSetId:
    """One replicate of the throws of one settings group."""

    group: str
    replicate: int

    @property
    def parts(self) -> tuple[str, ...]:
        """What tells it from the first replicate of the paper's throws: its group, and its replicate."""
        group = () if self.group == PAPERS_GROUP else (self.group,)
        return (*group, f"replicate-{self.replicate}") if self.replicate else group

    @property
    def prefix(self) -> str:
        """Prefix of the labels of its parts; "" for the first replicate of the paper's throws."""
        return "".join(f"{part}/" for part in self.parts)

    @property
    def label(self) -> str:
        """Name in messages and tables."""
        return "/".join(self.parts) or PAPERS_GROUP


@dataclass(frozen=True)
class ChunkId:
    """Throws of a data set, from number ``first`` on."""

    data_set: DataSetId
    first: int

    @property
    def label(self) -> str:
        """Name for display."""
        return f"{self.data_set.prefix}throws-{self.first}"


@dataclass(frozen=True)
class NetworkId:
    """A network that learns from a data set. The first ``ensemble.n_members`` of them are an ensemble."""

    data_set: DataSetId
    index: int

    @property
    def label(self) -> str:
        """Name for display."""
        return f"{self.data_set.prefix}member-{self.index:02d}"


def data_sets(settings: Settings) -> list[DataSetId]:
    """List the data sets of a study, the main one first."""
    return [DataSetId(group, k) for group in settings.throw_groups for k in range(settings.replicates)]


def main_data_set(settings: Settings) -> DataSetId:
    """Return the data set of the ensemble that predictions are assessed with where a trial has none of its own.

    Raises:
        ValueError: no trial of the study needs networks.
    """
    if not settings.needs_ensemble:
        raise ValueError(f"study {settings.name} has no data set, expected a trial that needs networks")
    return data_sets(settings)[0]


def data_set_of(trial: TrialId, group: str) -> DataSetId:
    """Return the data set that a trial uses: that of its own environment, or of a given group if it needs none."""
    kind = ENVIRONMENTS[trial.environment]
    return DataSetId(group if kind.networks == "none" else kind.learns_from, trial.replicate)


def replicate_of(trial: TrialId) -> int:
    """Return the replicate that a trial depends on; 0 for all trials of an environment without networks."""
    return 0 if ENVIRONMENTS[trial.environment].networks == "none" else trial.replicate


def own_network(trial: TrialId) -> int:
    """Return the number of the network that a single-member trial has for itself in its data set."""
    return trial.index // trial.n_replicates


def ensemble_ids(settings: Settings, data_set: DataSetId) -> list[NetworkId]:
    """List the members of a data set's ensemble."""
    return [NetworkId(data_set, index) for index in range(settings.ensemble.n_members)]


def networks_of(settings: Settings, trial: TrialId) -> list[NetworkId]:
    """List the networks that a trial evolves in."""
    kind = ENVIRONMENTS[trial.environment]
    if kind.networks == "none":
        return []
    data_set = data_set_of(trial, kind.learns_from)
    return [NetworkId(data_set, own_network(trial))] if kind.networks == "one" else ensemble_ids(settings, data_set)


def network_ids(settings: Settings) -> list[NetworkId]:
    """List every network of a study: the ensemble of each data set, and the networks of single-member trials."""
    ensembles = [member for data_set in data_sets(settings) for member in ensemble_ids(settings, data_set)]
    single = [network for trial in trials_of(settings, "evolve") for network in networks_of(settings, trial)]
    listed = data_sets(settings)
    return sorted({*ensembles, *single}, key=lambda network: (listed.index(network.data_set), network.index))
