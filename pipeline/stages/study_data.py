"""What analyses and the page read of a study: scores, champions, networks, throws and predictions, out of files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from numpy.random import Generator

from pipeline.config.settings import Settings
from pipeline.stages import environments
from pipeline.stages.assess import ASSESSED, PREDICTIONS, AssessmentId, read_predictions
from pipeline.stages.data_sets import (
    DataSetId,
    NetworkId,
    data_set_of,
    data_sets,
    ensemble_ids,
    networks_of,
    own_network,
)
from pipeline.stages.environments import FitnessSpec, SimulationSpec, network_inputs, networks_among
from pipeline.stages.segments import POPULATION, population_of
from pipeline.stages.transfer import CHAMPION, SCORED
from pipeline.stages.trial_scores import SCORE, scored_trial
from pipeline.store.design_file import design_from
from pipeline.workflow.identity import InputName, TrialId, arms_of
from pipeline.workflow.stage import Execution, Files, Input, Inputs, Sources, Upstream
from tasks.analysis.registry import AnalysisSettings, Assessed
from tasks.analysis.scores import Champion, ScoredTrial
from tasks.arrays import Float64
from tasks.design import Designs
from tasks.evolution import OBJECTIVES, Objective, Population
from tasks.residual import Learner, arm_kind
from tasks.seeding import generator
from tasks.simulation import Rollouts, simulate
from tasks.world import EnsembleMedium, Environment, EnvironmentName, Physics, Slush
from tasks.world.slush import PAPERS_TARGET

EVOLVED = "evolved"  # role of the inputs that are what a trial's search knows at its end


@dataclass(frozen=True)
class DataSpec:
    """What of the settings decides the data, for some trials."""

    seed: int
    trials: tuple[TrialId, ...]
    simulation: SimulationSpec
    settings: AnalysisSettings
    target: EnvironmentName
    fitness: FitnessSpec  # in the target


def data_spec(settings: Settings, trials: Sequence[TrialId]) -> DataSpec:
    """Select what decides the data."""
    return DataSpec(
        settings.seed,
        tuple(trials),
        environments.simulation_spec(settings, settings.target, *(arm.environment for arm in arms_of(trials))),
        AnalysisSettings(
            settings.assessed_depth,
            settings.arm_learners,
            settings.ensemble.deviation,
            settings.tank,
            settings.physics,
            settings.rollout.n_settle,
        ),
        settings.target,
        environments.fitness_spec(settings, settings.target),
    )


def data_inputs(settings: Settings, trials: Sequence[TrialId], reads: Sequence[str], upstream: Upstream) -> Sources:
    """Return the files of some trials that the data of some stages are in.

    Trials that need no networks are served by the main ensemble.

    Raises:
        MissingInputs: a network that serves the trials is missing.
    """
    inputs: Sources = {}
    for trial in trials:
        if trial in upstream["transfer"].done:
            scored = upstream["transfer"].done[trial][-1]
            inputs[InputName(SCORED, trial)] = Input(scored, tuple(f for f in (SCORE, CHAMPION) if f in scored.files))
    if "evolve" in reads:
        for trial in trials:
            if evolved := upstream["evolve"].done.get(trial.in_stage("evolve")):
                inputs[InputName(EVOLVED, trial)] = Input(evolved[-1], (POPULATION,))
    if "assess" in reads:  # in the order of their labels: resampling depends on the order of designs
        for assessed, (share,) in sorted(upstream["assess"].done.items(), key=lambda entry: entry[0].label):
            inputs[InputName(ASSESSED, assessed)] = Input(share, (PREDICTIONS,))
    target = settings.learner(settings.target)
    if "train" in reads or target:
        learners, known = settings.arm_learners, data_sets(settings)
        served = {data_set_of(trial, learners.get(trial.environment), known[0].learner) for trial in trials}
        served |= {DataSetId(target.data_set, 0)} if target else set()
        listed = [data_set for data_set in known if data_set in served]
        members = [network for data_set in listed for network in ensemble_ids(settings, data_set)]
        own = [network for trial in trials for network in networks_of(trial, learners.get(trial.environment))]
        inputs |= network_inputs(dict.fromkeys([*members, *own]), upstream)
    return inputs


@dataclass(frozen=True, eq=False)
class StudyFiles:
    """The data of some trials, decoded when they are asked for; see :class:`tasks.analysis.registry.StudyData`."""

    spec: DataSpec
    execution: Execution
    inputs: Inputs

    @property
    def settings(self) -> AnalysisSettings:
        return self.spec.settings

    @property
    def has_networks(self) -> bool:
        """Whether every network is there that some trial evolved in."""
        needed = any(arm_kind(trial.environment).learned for trial in self.spec.trials)
        return bool(self.networks) or not needed

    @cached_property
    def networks(self) -> dict[NetworkId, Files]:
        """The members of ensembles, and the networks of single-member trials."""
        return networks_among(self.inputs)

    @cached_property
    def trials(self) -> Sequence[ScoredTrial]:
        return [scored_trial(trial, self.inputs.get(InputName(SCORED, trial))) for trial in self.spec.trials]

    @cached_property
    def champions(self) -> Sequence[Champion]:
        found = []
        for trial, scored in zip(self.spec.trials, self.trials, strict=True):
            if scored.status == "ok":
                files = self.inputs[InputName(SCORED, trial)]
                design = design_from(files[CHAMPION], trial.label)
                found.append(Champion(**vars(scored), design=design))
        return found

    @cached_property
    def populations(self) -> Mapping[tuple[EnvironmentName, float, int], Population]:
        found = {name.chain: files for name, files in self.inputs.items() if name.role == EVOLVED}
        return {trial: population_of(found[one]) for trial, one in self._trials.items() if one in found}

    def assessed(self, learner: EnvironmentName) -> Assessed | None:
        shares = [
            files
            for name, files in self.inputs.items()
            if name.role == ASSESSED and isinstance(name.chain, AssessmentId) and name.chain.data_set.learner == learner
        ]
        if not shares:
            return None
        table = read_predictions(shares)
        trial = [f"{environment}/{k}" for environment, k in zip(table["environment"], table["trial"], strict=True)]
        replicate = table["trial"] % self.spec.trials[0].n_replicates
        return Assessed(table["predicted"].T, table["true"], trial, replicate)

    @property
    def target(self) -> EnvironmentName:
        return self.spec.target

    @property
    def objective(self) -> Objective:
        return OBJECTIVES[self.spec.fitness.objective]

    @property
    def has_papers_target(self) -> bool:
        slush, is_papers = self.spec.simulation.media[self.target], self.objective.is_papers
        return is_papers and self.target == PAPERS_TARGET and isinstance(slush, Slush) and slush.is_papers

    def at_target(self, depth: float) -> Environment:
        target = self.settings.learners.get(self.target)
        networks = self._members(DataSetId(target.data_set, 0)) if target else {}
        return environments.build_environment(self.spec.simulation.media, self.target, depth, networks)

    def home(self, champion: Champion) -> Environment:
        """Return where a champion evolved."""
        own = networks_of(self.trial_of(champion), self._learner(champion))
        networks = {network: self.networks[network] for network in own}
        media = self.spec.simulation.media
        return environments.build_environment(media, champion.environment, champion.depth, networks)

    def member(self, champion: Champion) -> int | None:
        """Return the number of the network that a champion evolved in, if it was a single one."""
        learner = self._learner(champion)
        return own_network(self.trial_of(champion)) if learner and learner.is_single else None

    def ensemble(self, champion: Champion | None = None) -> EnsembleMedium:
        data_set = self.data_set(champion)
        if data_set not in self._ensembles:
            self._ensembles[data_set] = environments.ensemble_of(self._members(data_set))
        return self._ensembles[data_set]

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
            physics=physics or self.settings.physics,
        )

    def score(self, environment: Environment, designs: Designs) -> Float64:
        spec = self.spec
        return environments.evaluate_designs(designs, spec.simulation, self.execution, environment, spec.fitness).scores

    def rng(self, *identity: str | float) -> Generator:
        return generator(self.spec.seed, "analyse", *identity)

    def trial_of(self, champion: Champion) -> TrialId:
        """Return a champion's trial."""
        return self._trials[champion.environment, champion.depth, champion.trial]

    def data_set(self, champion: Champion | None) -> DataSetId:
        """Return the data set whose ensemble serves a champion; by default the main one."""
        main = next(iter(self.networks)).data_set
        if champion is None:
            return main
        return data_set_of(self.trial_of(champion), self._learner(champion), main.learner)

    def _members(self, data_set: DataSetId) -> dict[NetworkId, Files]:
        """Return the members of the ensemble of a data set, without further networks of single-member trials."""
        n_members = next(one.n_members for one in self.settings.learners.values() if one.data_set == data_set.learner)
        return {
            one: files for one, files in self.networks.items() if one.data_set == data_set and one.index < n_members
        }

    def _learner(self, champion: Champion) -> Learner | None:
        return self.settings.learners.get(champion.environment)

    @cached_property
    def _trials(self) -> Mapping[tuple[str, float, int], TrialId]:
        return {(trial.environment, trial.depth, trial.index): trial for trial in self.spec.trials}

    @cached_property
    def _ensembles(self) -> dict[DataSetId, EnsembleMedium]:
        return {}
