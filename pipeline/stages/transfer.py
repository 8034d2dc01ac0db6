"""transfer: how champions do in the target, where they have never been. Paper, "Evolution" and Fig. 4.

The champion of every trial is scored where it evolved (predicted: the mean over the members of an ensemble), zero-shot
in the target at its own depth, and there with its motors off (passive) and with the controller that the stage adapt
evolved. Scores in other engines have the engine's name before theirs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.config.settings import Settings
from pipeline.report.render import as_text
from pipeline.stages import divergence, environments
from pipeline.stages.cost import seconds_of_rollout
from pipeline.stages.data_sets import networks_of
from pipeline.stages.environments import FitnessSpec, SimulationSpec
from pipeline.stages.files import ADAPTED, CHAMPION, POPULATION, SCORE
from pipeline.stages.reader import read_study
from pipeline.stages.segments import champion_of, population_of
from pipeline.stages.trial_scores import decode_scores, encode_scores
from pipeline.store.design_file import design_json
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import ChainId, InputName, TrialId, trials_of
from pipeline.workflow.stage import Chain, Execution, Files, Input, Inputs, Item, Sources, Stage, Summary, Upstream
from tasks.analysis.columns import scored_by
from tasks.analysis.tables.transfer import TOO_WIDE, TransferRow, transfer_rows
from tasks.design import Designs, motors_off
from tasks.evolution import OBJECTIVES, disagreement
from tasks.simulation.engine import EngineName
from tasks.world import EnvironmentName

_EVOLVED, _ADAPTED = InputName("evolved"), InputName("adapted")  # the last segments of evolution and adaptation


@dataclass(frozen=True)
class ScoreSpec:
    """The scores of a trial's champion where it evolved, and in the target before and after its adaptation."""

    trial: TrialId
    target: EnvironmentName
    simulation: SimulationSpec  # in both environments
    fitness: FitnessSpec  # where it evolved


@dataclass(frozen=True)
class InEnginesSpec(ScoreSpec):
    """The same, with those in the target in other engines."""

    engines: tuple[EngineName, ...]


def _plan(settings: Settings) -> Sequence[Chain[ScoreSpec]]:
    chains = []
    for trial in trials_of(settings, "transfer"):
        simulation = environments.simulation_spec(settings, trial.environment, settings.target)
        fitness = environments.fitness_spec(settings, trial.environment)
        places = trial.environment, settings.target, settings.target
        cost = sum(seconds_of_rollout(settings, environment, trial.depth) for environment in places)
        spec = ScoreSpec(trial, settings.target, simulation, fitness)
        if engines := settings.transfer.other_engines:
            spec = InEnginesSpec(**vars(spec), engines=engines)
        chains.append(Chain(trial, (1,), spec, weight=cost))
    return chains


def _item(
    settings: Settings, chain: Chain[ScoreSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[ScoreSpec]:
    trial = chain.spec.trial
    inputs: Sources = {_EVOLVED: Input(upstream["evolve"].chain(trial.in_stage("evolve"))[-1], (POPULATION,))}
    if settings.is_adapted(trial.environment):
        inputs[_ADAPTED] = Input(upstream["adapt"].chain(trial.in_stage("adapt"))[-1], (POPULATION,))
    at_home, in_target = (networks_of(trial, settings.learner(name)) for name in (trial.environment, settings.target))
    inputs |= environments.network_inputs(at_home, upstream)
    inputs |= environments.network_inputs(in_target, upstream, environments.OF_TARGET)
    label, execution = f"{chain.label}/score", Execution(settings.work.engine)
    return Item(TRANSFER.name, TRANSFER.version, label, chain.spec, inputs, execution)


def _compute(item: Item[ScoreSpec], inputs: Inputs) -> Files:
    """Score a trial's champion where it evolved, and before and after its adaptation."""
    spec, evolved = item.spec, population_of(inputs[_EVOLVED])
    champion = champion_of(evolved)
    if champion is None:
        return {SCORE: encode_scores(None)}
    home, target = (
        environments.build_environment(spec.simulation.media, name, spec.trial.depth, networks)
        for name, networks in (
            (spec.trial.environment, environments.networks_among(inputs)),
            (spec.target, environments.networks_among(inputs, environments.OF_TARGET)),
        )
    )
    is_papers = OBJECTIVES[spec.fitness.objective].is_papers

    def in_target(quantity: str, design: Designs, *engines: EngineName) -> dict[str, float | None]:
        scores: dict[str, float | None] = {}
        for prefix, execution in {"": item.execution, **{f"{name}.": Execution(name) for name in engines}}.items():
            found = environments.evaluate_designs(design, spec.simulation, execution, target, spec.fitness)
            values = {"": found.displacement, "_com": found.com_displacement, "_score": found.scores}
            scores |= {f"{prefix}{quantity}{suffix}": float(value[0, 0]) for suffix, value in values.items()}
        return scores

    files = {CHAMPION: design_json(champion)}
    scores: dict[str, float | None] = {"fitness": float(evolved.fitness[evolved.champion()])}
    at_home = environments.evaluate_designs(champion, spec.simulation, item.execution, home, spec.fitness)
    has_sd = home.is_ensemble and home.n_members > 1
    for suffix, (values,) in {"": at_home.displacement, "_score": at_home.scores}.items():
        scores[f"predicted{suffix}"] = float(values.mean())
        sd = float(disagreement(values[None])[0]) if has_sd else None
        scores |= {f"predicted_sd{suffix}": sd} if has_sd or not suffix else {}
    others = spec.engines if isinstance(spec, InEnginesSpec) else ()
    scores |= in_target("zero_shot", champion, *others) | in_target("passive", motors_off(champion))
    if _ADAPTED in inputs and (adapted := champion_of(population_of(inputs[_ADAPTED]))) is not None:
        files[ADAPTED] = design_json(adapted)
        scores |= in_target("adapted", adapted, *others)
    if is_papers:
        scores = {name: value for name, value in scores.items() if not name.endswith("_score")}
    return {**files, SCORE: encode_scores(scores)}


def _summarise(settings: Settings, upstream: Upstream, store: Store) -> Summary:
    """Tabulate champions in the target by depth and environment."""
    rows = transfer_rows(read_study(settings, upstream, store).trials, settings.target)
    suffix = "" if settings.evolution.maximised.is_papers else "_score"  # as in a trial's metrics
    metrics = {
        f"{quantity}{suffix}.{row.environment}.{row.depth:g}m": mean.value
        for row in rows
        for quantity, mean in (("predicted", row.predicted), ("zero_shot", row.zero_shot), ("adapted", row.adapted))
        if mean.value is not None
    }
    kind = scored_by(settings.evolution.maximised, TransferRow)
    return Summary(as_text(kind, rows, TOO_WIDE, learners=settings.arm_learners), metrics)


def _summarise_trial(trial: ChainId, items: Sequence[Files]) -> Summary:
    """Report a trial's scores and designs."""
    (files,) = items
    scores = decode_scores(files[SCORE], trial.label) or {}
    metrics = {name: value for name, value in scores.items() if value is not None}
    return Summary(metrics=metrics, artifacts={name: files[name] for name in (CHAMPION, ADAPTED) if name in files})


TRANSFER = Stage(
    name="transfer",
    version=2,
    unit="champions",
    reads=lambda settings: ("train", "evolve", "adapt") if settings.needs_ensemble else ("evolve", "adapt"),
    plan=_plan,
    item=_item,
    compute=_compute,
    summarise=_summarise,
    diverged=divergence.in_stage("transfer"),
    summarise_trial=_summarise_trial,
)
