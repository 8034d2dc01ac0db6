"""transfer: how champions do in the target, where they have never been. Paper, "Evolution" and Fig. 4.

The champion of every trial is scored where it evolved (predicted: the mean over the members of an ensemble) and
zero-shot in the target at its own depth. Then its body is frozen and its controller is evolved from scratch in the
target: the gap that remains is the body's fault.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from pipeline.config.settings import Settings
from pipeline.mlflow.run import CurvePoints
from pipeline.report.render import as_text
from pipeline.stages import divergence, environments, segments
from pipeline.stages.data_sets import networks_of
from pipeline.stages.environments import SimulationSpec
from pipeline.stages.segments import CHAMPION_OF, POPULATION, SegmentSpec, TrialSpec
from pipeline.stages.trial_scores import SCORE, TrialScores, decode_scores, encode_scores, scored_trial
from pipeline.store.design_file import design_json
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import ChainId, InputName, trials_of
from pipeline.workflow.stage import (
    Chain,
    Execution,
    Files,
    Input,
    Inputs,
    Item,
    Results,
    Sources,
    Stage,
    Summary,
    Upstream,
)
from tasks.analysis.registry import scored_by
from tasks.analysis.scores import ScoredTrial
from tasks.analysis.tables.transfer import TOO_WIDE, TransferRow, transfer_rows
from tasks.design import Designs
from tasks.evolution import OBJECTIVES, Deviation, ObjectiveName, disagreement

SCORED = "scored"  # role of the inputs of later stages that are a trial's scores and champion
_ADAPTED_TO = InputName("adapted")  # the last segment of the adaptation
_SCORING_UNITS = 2 / 64  # cost of scoring a champion before and after: two rollouts, of about 64 in a generation
_ADAPTED_DIVERGED = "adapted_n_designs_diverged"  # MLflow metric: designs of an adaptation that diverged
CHAMPION, ADAPTED = "champion.json", "adapted.json"


@dataclass(frozen=True)
class ScoreSpec:
    """The scores of a trial's champion where it evolved, and in the target before and after its adaptation."""

    trial: TrialSpec
    home: SimulationSpec  # of the environment where it evolved
    deviation: Deviation  # what σ over its members is
    objective: ObjectiveName  # what its scores are of


TransferSpec = SegmentSpec | ScoreSpec  # A segment of an adaptation, or the scoring at its end


def _plan(settings: Settings) -> Sequence[Chain[TrialSpec]]:
    """Plan the segments of each trial's adaptation, if it has one, and then an item that scores its champions."""
    chains = []
    for trial in trials_of(settings, "transfer"):
        adapted = settings.is_adapted(trial.environment)
        adaptation = segments.segment_lengths(settings, settings.transfer.n_generations) if adapted else ()
        spec = segments.trial_spec(settings, trial, settings.target)
        chains.append(segments.trial_chain(settings, spec, (*adaptation, _SCORING_UNITS)))
    return chains


def _item(
    settings: Settings, chain: Chain[TrialSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[TransferSpec]:
    evolved = upstream["evolve"].chain(chain.spec.identity.in_stage("evolve"))[-1]
    inputs: Sources = {CHAMPION_OF: Input(evolved, (POPULATION,))}
    in_target = networks_of(chain.spec.identity, settings.learner(settings.target))
    spec: TransferSpec
    if index < chain.n_items - 1:
        inputs |= environments.network_inputs(in_target, upstream)
        label, spec = f"{chain.label}/adaptation-{index}", segments.segment_of(chain, index)
        inputs |= segments.before_input(previous)
    else:
        trial = chain.spec.identity
        home = environments.simulation_spec(settings, trial.environment)
        deviation = environments.fitness_spec(settings, trial.environment).deviation
        label, spec = f"{chain.label}/score", ScoreSpec(chain.spec, home, deviation, chain.spec.fitness.objective)
        networks = networks_of(trial, settings.learner(trial.environment))
        inputs |= environments.network_inputs(networks, upstream)
        inputs |= environments.network_inputs(in_target, upstream, environments.OF_TARGET)
        if previous is not None:
            inputs[_ADAPTED_TO] = Input(previous, (POPULATION,))
    execution = environments.execution_options(settings, settings.target)
    return Item(TRANSFER.name, TRANSFER.version, label, spec, inputs, execution)


def _compute(item: Item[TransferSpec], inputs: Inputs) -> Files:
    return _compute_batch([item], [inputs])[0]


def _compute_batch(items: Sequence[Item[TransferSpec]], inputs: Sequence[Inputs]) -> list[Files]:
    """Advance adaptations together, or score champions one after another, which takes only milliseconds."""
    if isinstance(items[0].spec, SegmentSpec):
        return segments.compute_segments(cast(Sequence[Item[SegmentSpec]], items), inputs)
    return [
        _score(item.spec, item.execution, item_inputs)
        for item, item_inputs in zip(items, inputs, strict=True)
        if isinstance(item.spec, ScoreSpec)
    ]


def _score(spec: ScoreSpec, execution: Execution, inputs: Inputs) -> Files:
    """Score a trial's champion where it evolved, and before and after its adaptation."""
    trial, home = spec.trial, spec.home
    evolved = segments.population_of(inputs[CHAMPION_OF])
    champion = segments.champion_of(evolved)
    if champion is None:
        return {SCORE: encode_scores(None)}
    files = {CHAMPION: design_json(champion)}
    networks = environments.networks_among(inputs)
    at_home = environments.build_environment(home.media, trial.identity.environment, trial.identity.depth, networks)
    evaluation = environments.evaluate_designs(champion, home, execution, at_home, trial.fitness)
    has_sd, found = at_home.is_ensemble and at_home.n_members > 1, dict[str, Any]()
    for suffix, (values,) in {"": evaluation.displacement, "_score": evaluation.scores}.items():
        found[f"predicted{suffix}"] = float(values.mean())
        found[f"predicted_sd{suffix}"] = float(disagreement(values[None], spec.deviation)[0]) if has_sd else None
    found |= _in_target("zero_shot", spec, execution, champion, inputs)
    if _ADAPTED_TO in inputs:
        adapted = segments.champion_of(segments.population_of(inputs[_ADAPTED_TO]))
        if adapted is not None:
            files[ADAPTED] = design_json(adapted)
            found |= _in_target("adapted", spec, execution, adapted, inputs)
    if OBJECTIVES[spec.objective].is_papers:
        found = {name: value for name, value in found.items() if not name.endswith("_score")}
    return {**files, SCORE: encode_scores(TrialScores(float(evolved.fitness[evolved.champion()]), **found))}


def _in_target(
    quantity: str, spec: ScoreSpec, execution: Execution, design: Designs, inputs: Inputs
) -> dict[str, float]:
    """Return what :class:`TrialScores` says of a design in the target; NaN where it diverged.

    The trial is an adaptation, so that its environment is the target.
    """
    trial, target = spec.trial, spec.trial.at_home(environments.networks_among(inputs, environments.OF_TARGET))
    found = environments.evaluate_designs(design, trial.simulation, execution, target, trial.fitness)
    values = {"": found.displacement, "_com": found.com_displacement, "_score": found.scores}
    return {f"{quantity}{suffix}": float(value[0, 0]) for suffix, value in values.items()}


def read_trials(settings: Settings, results: Results, store: Store, displacement: bool = False) -> list[ScoredTrial]:
    """Return what is known of every trial's champion, in the order of the trials; see :func:`scored_trial`."""
    files = {trial: {SCORE: store.read(parts[-1], SCORE)} for trial, parts in results.done.items()}
    return [scored_trial(trial, files.get(trial), displacement) for trial in trials_of(settings, "transfer")]


def _read_scores(store: Store, trial: ChainId, scored: Manifest) -> TrialScores | None:
    return decode_scores(store.read(scored, SCORE), trial.label)


def _summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Tabulate champions in the target by depth and environment."""
    rows = transfer_rows(read_trials(settings, results, store), settings.target)
    suffix = "" if settings.evolution.maximised.is_papers else "_score"  # as in a trial's metrics
    metrics = {
        f"{quantity}{suffix}.{row.environment}.{row.depth:g}m": mean.value
        for row in rows
        for quantity, mean in (("predicted", row.predicted), ("zero_shot", row.zero_shot), ("adapted", row.adapted))
        if mean.value is not None
    }
    trials = [_summarise_trial(store, trial, done) for trial, done in results.done.items()]
    metrics["n_diverged"] = sum(trial.metrics.get(_ADAPTED_DIVERGED, 0.0) for trial in trials)
    kind = scored_by(settings.evolution.maximised, TransferRow)
    return Summary(as_text(kind, rows, TOO_WIDE, learners=settings.arm_learners), metrics)


def _curves(store: Store, part: Manifest) -> CurvePoints:
    if segments.CURVE not in part.files:  # the scores
        return CurvePoints()
    curve = segments.read_curve(store, [part])
    return CurvePoints(curve["generation"].tolist(), {"adapted_best_fitness": curve["best_fitness"]})


def _summarise_trial(store: Store, trial: ChainId, parts: Sequence[Manifest]) -> Summary:
    """Report a trial's scores and designs, and its adaptation where there was one."""
    *adaptation, scored = parts
    scores = _read_scores(store, trial, scored)
    known = scores.by_name() if scores is not None else {}
    metrics = {name: value for name, value in known.items() if value is not None}
    if adaptation:
        metrics[_ADAPTED_DIVERGED] = float(segments.read_curve(store, adaptation)["n_diverged"].sum())
    designs = {name: store.read(scored, name) for name in (CHAMPION, ADAPTED) if name in scored.files}
    return Summary(metrics=metrics, artifacts=designs)


def _diverged(settings: Settings, results: Results, store: Store) -> Mapping[ChainId, str]:
    messages = {}
    for trial, (*adaptation, scored) in results.done.items():
        scores = _read_scores(store, trial, scored)
        curve = segments.read_curve(store, adaptation) if adaptation else None
        if message := divergence.in_transfer(scores, curve):
            messages[trial] = message
    return messages


TRANSFER = Stage(
    name="transfer",
    version=1,
    unit="generations",
    reads=lambda settings: ("train", "evolve") if settings.needs_ensemble else ("evolve",),
    plan=_plan,
    item=_item,
    compute=_compute,
    compute_batch=_compute_batch,
    summarise=_summarise,
    diverged=_diverged,
    curves=_curves,
    summarise_trial=_summarise_trial,
)
