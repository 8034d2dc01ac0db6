"""Data sets of throws, and the networks that learn from them: which of them each trial uses.

A study has one data set for each learner with an ensemble and each replicate.
"""

from dataclasses import dataclass

from pipeline.config.settings import Settings
from pipeline.workflow.identity import TrialId, trials_of
from tasks.residual import Learner
from tasks.world import ENVIRONMENTS, EnvironmentName


@dataclass(frozen=True)
class DataSetId:
    """One replicate of the throws of one learner."""

    learner: EnvironmentName
    replicate: int

    @property
    def label(self) -> str:
        """Name in messages and tables."""
        return f"{self.learner}/replicate-{self.replicate}" if self.replicate else self.learner


@dataclass(frozen=True)
class ChunkId:
    """Throws of a data set, from number ``first`` on."""

    data_set: DataSetId
    first: int

    @property
    def label(self) -> str:
        """Name for display."""
        return f"{self.data_set.label}/throws-{self.first}"


@dataclass(frozen=True)
class NetworkId:
    """A network that learns from a data set. The first ``ensemble.n_members`` of them are an ensemble."""

    data_set: DataSetId
    index: int

    @property
    def label(self) -> str:
        """Name for display."""
        return f"{self.data_set.label}/member-{self.index:02d}"


@dataclass(frozen=True)
class AssessmentId:
    """A trial's share of the assessed designs, predicted by the ensemble of a data set."""

    trial: TrialId
    data_set: DataSetId

    @property
    def label(self) -> str:
        """Name for display."""
        return f"{self.data_set.learner}/{self.trial.label}"


def data_sets(settings: Settings) -> list[DataSetId]:
    """List the data sets of a study, the main one first."""
    return [DataSetId(name, k) for name in settings.ensembles for k in range(settings.replicates)]


def data_set_of(trial: TrialId, learner: Learner | None, main: EnvironmentName) -> DataSetId:
    """Return the data set that a trial uses: that of its own learner, or of the main one if it has none."""
    return DataSetId(learner.data_set if learner else main, trial.replicate)


def replicate_of(trial: TrialId) -> int:
    """Return the replicate that a trial depends on; 0 for all trials of an environment without networks."""
    return 0 if trial.environment in ENVIRONMENTS else trial.replicate


def own_network(trial: TrialId) -> int:
    """Return the number of the network that a single-member trial has for itself in its data set."""
    return trial.index // trial.n_replicates


def ensemble_ids(settings: Settings, data_set: DataSetId) -> list[NetworkId]:
    """List the members of a data set's ensemble."""
    return [NetworkId(data_set, index) for index in range(settings.ensembles[data_set.learner].n_members)]


def networks_of(trial: TrialId, learner: Learner | None) -> list[NetworkId]:
    """List the networks that a trial of a learner evolves in."""
    if learner is None:
        return []
    data_set = DataSetId(learner.data_set, trial.replicate)
    numbers = [own_network(trial)] if learner.is_single else range(learner.n_members)
    return [NetworkId(data_set, number) for number in numbers]


def network_ids(settings: Settings) -> list[NetworkId]:
    """List every network of a study: the ensemble of each data set, and the networks of single-member trials."""
    ensembles = [member for data_set in data_sets(settings) for member in ensemble_ids(settings, data_set)]
    learners = settings.arm_learners
    single = [
        network
        for trial in trials_of(settings, "evolve")
        for network in networks_of(trial, learners.get(trial.environment))
    ]
    listed = data_sets(settings)
    return sorted({*ensembles, *single}, key=lambda network: (listed.index(network.data_set), network.index))
