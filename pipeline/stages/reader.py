"""The one reader of studies: what analyses, the page, films, summaries and a user read, out of files.

``CONTENTS`` declares what there is to read and which files it is in. From it follow the inputs of an item that reads
some of it on a worker, and where the process that has the store finds it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import nan
from typing import Any

import numpy as np
from numpy.random import Generator

from pipeline.config.settings import Settings
from pipeline.stages import environments
from pipeline.stages.data_sets import (
    AssessmentId,
    ChunkId,
    DataSetId,
    NetworkId,
    data_set_of,
    data_sets,
    ensemble_ids,
    networks_of,
    own_network,
    replicate_of,
)
from pipeline.stages.environments import FitnessSpec, SimulationSpec
from pipeline.stages.files import CHAMPION, CURVE, POPULATION, PREDICTIONS, SCORE, TRANSITIONS, WEIGHTS
from pipeline.stages.segments import population_of
from pipeline.stages.trial_scores import Scores, decode_scores
from pipeline.store.design_file import design_from
from pipeline.store.store import Store
from pipeline.store.tables import Columns
from pipeline.workflow.identity import ChainId, InputName, TrialId, arms_of, trials_of
from pipeline.workflow.stage import Execution, Files, Input, Inputs, Results, Sources, StoredFiles, Upstream
from tasks.analysis.scores import Champion, ScoredTrial
from tasks.analysis.study import AnalysisSettings, Assessed, StudyData
from tasks.arrays import Float64
from tasks.design import Designs
from tasks.evolution import OBJECTIVES, Objective, Population
from tasks.residual import Learner, MeasuredTransitions, Transitions, arm_kind
from tasks.seeding import generator
from tasks.simulation import Conditions, Rollouts, simulate
from tasks.simulation.engine import EngineName
from tasks.world import EnsembleMedium, Environment, EnvironmentName, Physics, Slush
from tasks.world.slush import PAPERS_TARGET

Chains = Callable[[Settings, Sequence[TrialId], Results], Iterable[ChainId]]


def _all_done(settings: Settings, trials: Sequence[TrialId], results: Results) -> Iterable[ChainId]:
    return results.done


def _done_of_trials(settings: Settings, trials: Sequence[TrialId], results: Results) -> Iterable[ChainId]:
    of_stage = (trial.in_stage(results.stage) for trial in trials)
    return (trial for trial in of_stage if trial in results.done)


def _networks_that_serve(settings: Settings, trials: Sequence[TrialId], results: Results) -> Iterable[ChainId]:
    """List the ensembles of some trials and of the target, and the networks of single-member trials.

    Trials that need no networks are served by the main ensemble.
    """
    learners, known, target = settings.arm_learners, data_sets(settings), settings.learner(settings.target)
    if not learners:
        return ()
    served = {data_set_of(trial, learners.get(trial.environment), known[0].learner) for trial in trials}
    served |= {DataSetId(target.data_set, 0)} if target else set()
    members = [network for data_set in known if data_set in served for network in ensemble_ids(settings, data_set)]
    single = [network for trial in trials for network in networks_of(trial, learners.get(trial.environment))]
    return dict.fromkeys([*members, *single])


def _main_throws(settings: Settings, trials: Sequence[TrialId], results: Results) -> Iterable[ChainId]:
    return chunks_of(data_sets(settings)[0], results) if settings.needs_ensemble else ()


def chunks_of(data_set: DataSetId, collected: Results) -> list[ChunkId]:
    """List the chunks of a whole data set, also those that are not done."""
    chunks = (*collected.done, *collected.unfinished, *collected.failed)
    return [chunk for chunk in chunks if isinstance(chunk, ChunkId) and chunk.data_set == data_set]


@dataclass(frozen=True)
class Content:
    """What is read under one name: files of a stage's items."""

    stage: str
    files: tuple[str, ...] = ()  # where a chain has them; all files if none are named
    chains: Chains = _all_done  # which an item reads for some trials; each must be complete
    only_last: bool = False  # whether only the last item of each chain is read


CONTENTS: Mapping[str, Content] = {
    "throws": Content("collect", (TRANSITIONS.name,), _main_throws),
    "networks": Content("train", (WEIGHTS,), _networks_that_serve),
    "curves": Content("evolve", (CURVE.name,), _done_of_trials),
    "populations": Content("evolve", (POPULATION,), _done_of_trials, only_last=True),
    "adaptations": Content("adapt", (CURVE.name,), _done_of_trials),
    "champions": Content("transfer", (SCORE, CHAMPION), _done_of_trials),
    "predictions": Content("assess", (PREDICTIONS.name,)),
    "tables": Content("analyse"),
}
"""What there is to read of a study, by the name that an analysis declares."""


def inputs_of(settings: Settings, trials: Sequence[TrialId], reads: Iterable[str], upstream: Upstream) -> Sources:
    """Return what is read of some trials as inputs of an item. A learned target is read with everything.

    Raises:
        MissingInputs: a network or a throw is missing.
    """
    inputs: Sources = {}
    for name in dict.fromkeys([*reads, *(["networks"] if settings.learner(settings.target) else [])]):
        content, results = CONTENTS[name], upstream[CONTENTS[name].stage]
        for chain in content.chains(settings, trials, results):
            for number, manifest in enumerate(_read_of(content, results.chain(chain))):
                files = [file for file in content.files or manifest.files if file in manifest.files]
                inputs[InputName(name, chain, number)] = Input(manifest, tuple(files))
    return inputs


def read_transitions(chunks: Sequence[Files]) -> Transitions:
    """Decode and join the chunks of a data set."""
    table = TRANSITIONS.read(chunks)
    kind: type[Transitions] = MeasuredTransitions if "residual_sd" in table else Transitions
    return kind(**table)


def _read_of(content: Content, items: Sequence[Any]) -> Sequence[Any]:
    return items[-1:] if content.only_last else items


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
            settings.assessed_depth, settings.arm_learners, settings.tank, settings.physics, settings.rollout.n_settle
        ),
        settings.target,
        environments.fitness_spec(settings, settings.target),
    )


def read_inputs(spec: DataSpec, execution: Execution, inputs: Inputs) -> "StudyReader":
    """Read what an item has among its inputs."""
    contents: dict[str, dict[ChainId, list[Files]]] = {}
    for name, files in inputs.items():
        if name.chain is not None:
            contents.setdefault(name.role, {}).setdefault(name.chain, []).append(files)
    return StudyReader(spec, execution, contents)


def read_study(settings: Settings, upstream: Upstream, store: Store) -> "StudyReader":
    """Read what a store has of a study; its files are read when they are asked for."""
    main = set(_main_throws(settings, (), upstream["collect"])) if "collect" in upstream else set()
    contents = {
        name: {
            chain: [StoredFiles(store, item) for item in _read_of(content, items)]
            for chain, items in upstream[content.stage].done.items()
            if name != "throws" or chain in main
        }
        for name, content in CONTENTS.items()
        if content.stage in upstream
    }
    spec = data_spec(settings, trials_of(settings, "transfer"))
    return StudyReader(spec, Execution(settings.work.engine), contents)


@dataclass(frozen=True, eq=False)
class StudyReader(StudyData):
    """The contents of a study or of some of its trials, decoded when they are asked for."""

    spec: DataSpec
    execution: Execution
    contents: Mapping[str, Mapping[ChainId, Sequence[Files]]]  # files of each item that is there, by name and chain

    # -- what there is -----------------------------------------------------------------------------------------------

    def items(self, name: str) -> Mapping[Any, Sequence[Files]]:
        """Return the files of the items under one of the names in CONTENTS, by chain."""
        return self.contents.get(name, {})

    @cached_property
    def throws(self) -> Transitions | None:
        """The main throws, or those of the chunks that are there."""
        chunks = [files for (files,) in self.items("throws").values()]
        return read_transitions(chunks) if chunks else None

    @cached_property
    def networks(self) -> dict[NetworkId, Files]:
        """The members of ensembles, and the networks of single-member trials."""
        return {network: files for network, (files,) in self.items("networks").items()}

    def curves(self, name: str = "curves") -> dict[TrialId, Columns]:
        """Return the curve of each trial, or of its adaptation."""
        return {trial: CURVE.read(segments, trial.label) for trial, segments in self.items(name).items()}

    @cached_property
    def populations(self) -> Mapping[tuple[EnvironmentName, float, int], Population]:
        trials = {trial.in_stage("evolve"): at for at, trial in self._trials.items()}
        return {trials[trial]: population_of(files) for trial, (files,) in self.items("populations").items()}

    @cached_property
    def scores(self) -> dict[TrialId, Scores | None]:
        """The scores of every trial that is done, None of one without a champion."""
        done = self.items("champions").items()
        return {trial: decode_scores(items[-1][SCORE], trial.label) for trial, items in done}

    @cached_property
    def trials(self) -> Sequence[ScoredTrial]:
        return self.scored_trials()

    @cached_property
    def in_engines(self) -> Mapping[EngineName, Sequence[ScoredTrial]]:
        names = (name.partition(".") for scores in self.scores.values() for name in scores or ())
        others = dict.fromkeys(engine for engine, dot, _ in names if dot)
        return {"Box2D": self.trials, **{engine: self.scored_trials(engine=engine) for engine in others}}

    def scored_trials(self, *, displacement: bool = False, engine: EngineName = "") -> list[ScoredTrial]:
        """Return what the objective scores of every trial's champion, or displacements in any case."""
        listed = []
        for trial in self.spec.trials:
            identity = trial.environment, trial.depth, trial.index, replicate_of(trial)
            scores = self.scores.get(trial)
            if scores is None:
                listed.append(ScoredTrial(*identity, status="no champion" if trial in self.scores else "not done"))
                continue
            suffix = "" if displacement or "predicted_score" not in scores else "_score"
            names = {name: name + suffix for name in ("predicted", "predicted_sd", "zero_shot", "adapted", "passive")}
            if engine:
                names |= {name: f"{engine}.{names[name]}" for name in ("zero_shot", "adapted")}
            known = {name: scores.get(source) for name, source in {"fitness": "fitness", **names}.items()}
            finite: dict[str, Any] = {name: nan if value is None else value for name, value in known.items()}
            listed.append(ScoredTrial(*identity, status="ok", **finite))
        return listed

    @cached_property
    def champions(self) -> Sequence[Champion]:
        return [
            Champion(**vars(scored), design=self.design(trial))
            for trial, scored in zip(self.spec.trials, self.trials, strict=True)
            if scored.status == "ok"
        ]

    def champion_files(self, trial: TrialId) -> Files:
        """Return the files of a trial's scores and champions; there are none before it is done."""
        return self.items("champions").get(trial, [{}])[-1]

    def design(self, trial: TrialId, file: str = CHAMPION) -> Designs:
        """Return a trial's champion, which one of its files holds."""
        return design_from(self.champion_files(trial)[file], trial.label)

    @cached_property
    def predictions(self) -> dict[AssessmentId, Columns]:
        """The shares of assessed designs, in the order of their labels: resampling depends on the order of designs."""
        shares = sorted(self.items("predictions").items(), key=lambda share: str(share[0].label))
        return {share: PREDICTIONS.read(files) for share, files in shares}

    def assessed(self, learner: EnvironmentName) -> Assessed | None:
        shares = [columns for share, columns in self.predictions.items() if share.data_set.learner == learner]
        if not shares:
            return None
        environment, number, predicted, true = (
            np.concatenate([columns[name] for columns in shares])
            for name in ("environment", "trial", "predicted", "true")
        )
        trial = [f"{name}/{k}" for name, k in zip(environment, number, strict=True)]
        return Assessed(predicted.T, true, trial, number % self.spec.trials[0].n_replicates)

    # -- what it takes to simulate designs as the study does ---------------------------------------------------------

    @property
    def settings(self) -> AnalysisSettings:
        return self.spec.settings

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

    @property
    def has_networks(self) -> bool:
        """Whether every network is there that some trial evolved in."""
        needed = any(arm_kind(trial.environment).learned for trial in self.spec.trials)
        return bool(self.networks) or not needed

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

    def score_under(self, conditions: Conditions, environment: Environment, designs: Designs) -> Float64:
        objective, simulation = self.objective, self.spec.simulation
        needed = {"trace": objective.trace, "motor_work": objective.motor_work}
        return objective.score(
            environments.roll_out(simulation, self.execution, environment, designs, conditions, **needed)
        )

    def rng(self, *identity: str | float) -> Generator:
        return generator(self.spec.seed, "analyse", *identity)

    def trial_of(self, champion: Champion) -> TrialId:
        """Return a champion's trial."""
        return self._trials[champion.key]

    def data_set(self, champion: Champion | None) -> DataSetId:
        """Return the data set whose ensemble serves a champion; by default the main one."""
        main = next(iter(self.networks)).data_set
        if champion is None:
            return main
        return data_set_of(self.trial_of(champion), self._learner(champion), main.learner)

    def _members(self, data_set: DataSetId) -> dict[NetworkId, Files]:
        """Return the members of the ensemble of a data set, without further networks of single-member trials."""
        learners = self.settings.learners.values()
        n_members = next(learner.n_members for learner in learners if learner.data_set == data_set.learner)
        of_data_set = {network: files for network, files in self.networks.items() if network.data_set == data_set}
        return {network: files for network, files in of_data_set.items() if network.index < n_members}

    def _learner(self, champion: Champion) -> Learner | None:
        return self.settings.learners.get(champion.environment)

    @cached_property
    def _trials(self) -> Mapping[tuple[str, float, int], TrialId]:
        return {(trial.environment, trial.depth, trial.index): trial for trial in self.spec.trials}

    @cached_property
    def _ensembles(self) -> dict[DataSetId, EnsembleMedium]:
        return {}
