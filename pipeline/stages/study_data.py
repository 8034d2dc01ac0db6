"""What analyses and the page read of a study: scores, champions, networks, throws and predictions, out of files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from numpy.random import Generator

from pipeline.config.settings import RESIDUAL_ENVIRONMENTS, Settings
from pipeline.stages import environments
from pipeline.stages.assess import ASSESSED, PREDICTIONS, assessed_among, read_predictions
from pipeline.stages.collect import read_transitions, throws_among, throws_inputs
from pipeline.stages.data_sets import DataSetId, data_set_of, main_data_set, own_network
from pipeline.stages.environments import SimulationSpec
from pipeline.stages.transfer import CHAMPION, SCORED, scores_inputs
from pipeline.stages.trial_scores import scored_trial
from pipeline.store.design_file import design_from
from pipeline.store.encoding import decode_json
from pipeline.workflow.identity import InputName, TrialId, arms_of
from pipeline.workflow.stage import Execution, Input, Inputs, Upstream
from tasks.analysis.registry import Assessed, Champion
from tasks.analysis.scores import ScoredTrial
from tasks.analysis.tank import Tank
from tasks.design import Designs
from tasks.evolution import Deviation
from tasks.residual import Transitions, split_throws
from tasks.seeding import generator, replicate_seed
from tasks.simulation import Rollouts, simulate
from tasks.world import ENVIRONMENTS, EnsembleMedium, Environment, Physics


@dataclass(frozen=True)
class DataSpec:
    """What of the settings decides the data, for some trials."""

    seed: int
    trials: tuple[TrialId, ...]
    simulation: SimulationSpec
    depths: tuple[float, ...]
    assessed_depth: float
    throw_groups: tuple[str, ...]
    deviation: Deviation
    held_out: float
    tank: Tank | None


def data_spec(settings: Settings, trials: Sequence[TrialId]) -> DataSpec:
    """Select what decides the data."""
    return DataSpec(
        settings.seed,
        tuple(trials),
        environments.simulation_spec(settings, "true_slush", *(arm.environment for arm in arms_of(trials))),
        settings.grid.depths,
        settings.assessed_depth,
        settings.throw_groups,
        settings.ensemble.deviation,
        settings.training.held_out,
        settings.tank,
    )


def data_inputs(
    settings: Settings, trials: Sequence[TrialId], reads: Sequence[str], upstream: Upstream
) -> dict[InputName, Input]:
    """Return the files of some trials that the data of some stages are in.

    Args:
        settings: the study's settings.
        trials: the trials.
        reads: names of the stages.
        upstream: results of the stages before.

    Raises:
        MissingInputs: a network or throws that serve the trials are missing.
    """
    inputs = scores_inputs(trials, upstream)
    if "assess" in reads:  # in the order of their labels: resampling depends on the order of designs
        for trial, (share,) in sorted(upstream["assess"].done.items(), key=lambda entry: entry[0].label):
            inputs[InputName(ASSESSED, trial)] = Input(share, (PREDICTIONS,))
    if "train" in reads:
        inputs |= environments.networks_inputs(settings, trials, upstream)
    if "collect" in reads:
        for data_set in dict.fromkeys(data_set_of(trial, main_data_set(settings).group) for trial in trials):
            inputs |= throws_inputs(upstream["collect"], data_set)
    return inputs


@dataclass(frozen=True, eq=False)
class StudyFiles:
    """The data of some trials, decoded when they are asked for; see :class:`tasks.analysis.registry.StudyData`."""

    spec: DataSpec
    execution: Execution
    inputs: Inputs

    @property
    def depths(self) -> Sequence[float]:
        return self.spec.depths

    @property
    def assessed_depth(self) -> float:
        return self.spec.assessed_depth

    @property
    def throw_groups(self) -> Sequence[str]:
        return self.spec.throw_groups

    @property
    def deviation(self) -> Deviation:
        return self.spec.deviation

    @property
    def tank(self) -> Tank | None:
        return self.spec.tank

    @property
    def physics(self) -> Physics:
        return self.spec.simulation.physics

    @property
    def n_settle(self) -> int:
        return self.spec.simulation.rollout.n_settle

    @property
    def has_networks(self) -> bool:
        """Whether every network is there that some trial evolved in."""
        needed = any(trial.environment in RESIDUAL_ENVIRONMENTS for trial in self.spec.trials)
        return bool(environments.networks_among(self.inputs)) or not needed

    @cached_property
    def trials(self) -> Sequence[ScoredTrial]:
        return [scored_trial(trial, self.inputs.get(InputName(SCORED, trial))) for trial in self.spec.trials]

    @cached_property
    def champions(self) -> Sequence[Champion]:
        found = []
        for trial, scored in zip(self.spec.trials, self.trials, strict=True):
            if scored.status == "ok":
                files = self.inputs[InputName(SCORED, trial)]
                design = design_from(decode_json(files[CHAMPION], trial.label), trial.label)
                known = scored.fitness, scored.predicted, scored.zero_shot
                found.append(Champion(trial.environment, trial.depth, trial.index, design, *known))
        return found

    def assessed(self, group: str) -> Assessed | None:
        shares = assessed_among(self.inputs, group)
        if not shares:
            return None
        table = read_predictions(shares)
        trial = [f"{environment}/{k}" for environment, k in zip(table["environment"], table["trial"], strict=True)]
        replicate = table["trial"] % self.spec.trials[0].n_replicates
        return Assessed(table["predicted"].T, table["true"], trial, replicate)

    def true_slush(self, depth: float) -> Environment:
        return environments.true_slush(self.spec.simulation.media, depth)

    def home(self, champion: Champion) -> Environment:
        networks = environments.home_networks_among(self.inputs, self.trial_of(champion))
        key = champion.environment, champion.depth, *networks
        if key not in self._homes:
            media = self.spec.simulation.media
            built = environments.build_environment(media, champion.environment, champion.depth, networks)
            self._homes[key] = built
        return self._homes[key]

    def member(self, champion: Champion) -> int:
        one = ENVIRONMENTS[champion.environment].networks == "one"
        return own_network(self.trial_of(champion)) if one else -1

    def ensemble(self, champion: Champion | None = None) -> EnsembleMedium:
        data_set = self.data_set(champion)
        if data_set not in self._ensembles:
            self._ensembles[data_set] = environments.ensemble_of(environments.ensemble_among(self.inputs, data_set))
        return self._ensembles[data_set]

    def throws(self, champion: Champion | None = None) -> tuple[Transitions, Transitions]:
        data_set = self.data_set(champion)
        if data_set not in self._throws:
            transitions = read_transitions(throws_among(self.inputs, data_set))
            seed = replicate_seed(self.spec.seed, data_set.replicate)
            learned, held_out = split_throws(transitions.throw, self.spec.held_out, seed=seed)
            self._throws[data_set] = transitions[learned], transitions[held_out]
        return self._throws[data_set]

    def simulate(
        self,
        environment: Environment,
        designs: Designs,
        *,
        trace: bool = False,
        physics: Physics | None = None,
        n_measure: int | None = None,
    ) -> Rollouts:
        rollout = self.spec.simulation.rollout
        return simulate(
            designs,
            environment,
            n_settle=rollout.n_settle,
            n_measure=n_measure or rollout.n_measure,
            engine=self.execution.engine,
            trace=trace,
            physics=physics or self.physics,
        )

    def rng(self, *identity: str | float) -> Generator:
        return generator(self.spec.seed, "analyse", *identity)

    def trial_of(self, champion: Champion) -> TrialId:
        """Return a champion's trial."""
        return self._trials[champion.environment, champion.depth, champion.trial]

    def data_set(self, champion: Champion | None) -> DataSetId:
        """Return the data set whose ensemble serves a champion; by default the main one."""
        if champion is None:
            return environments.main_data_set_among(self.inputs)
        return environments.data_set_among(self.inputs, self.trial_of(champion))

    @cached_property
    def _trials(self) -> Mapping[tuple[str, float, int], TrialId]:
        return {(trial.environment, trial.depth, trial.index): trial for trial in self.spec.trials}

    @cached_property
    def _homes(self) -> dict[Any, Environment]:
        return {}

    @cached_property
    def _ensembles(self) -> dict[DataSetId, EnsembleMedium]:
        return {}

    @cached_property
    def _throws(self) -> dict[DataSetId, tuple[Transitions, Transitions]]:
        return {}
