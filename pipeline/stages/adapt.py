"""adapt: new controllers for champions in the target. Paper, "Evolution".

A champion's body is frozen and its controller is evolved from scratch in the target, where it has never been: the gap
that remains to designs of the target is the body's fault.
"""

from collections.abc import Sequence
from dataclasses import replace

from pipeline.config.settings import Settings
from pipeline.mlflow.run import CurvePoints
from pipeline.stages import divergence, environments, segments
from pipeline.stages.data_sets import networks_of
from pipeline.stages.files import CURVE, POPULATION
from pipeline.stages.reader import read_study
from pipeline.stages.segments import CHAMPION_OF, SegmentSpec, TrialSpec
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import ChainId, trials_of
from pipeline.workflow.stage import Chain, Files, Input, Item, Stage, Summary, Upstream

_SEED = "transfer"  # what its random numbers are for: the adaptation is a part of a champion's transfer


def _plan(settings: Settings) -> Sequence[Chain[TrialSpec]]:
    lengths = segments.segment_lengths(settings, settings.transfer.n_generations)
    chains = []
    for trial in trials_of(settings, "adapt"):
        if settings.is_adapted(trial.environment):
            spec = segments.trial_spec(settings, trial.in_stage(_SEED), settings.target)
            chains.append(replace(segments.trial_chain(settings, spec, lengths), identity=trial))
    return chains


def _item(
    settings: Settings, chain: Chain[TrialSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[SegmentSpec]:
    trial = chain.spec.identity
    evolved = upstream["evolve"].chain(trial.in_stage("evolve"))[-1]
    networks = networks_of(trial, settings.learner(settings.target))
    return Item(
        ADAPT.name,
        ADAPT.version,
        label=f"{chain.label}/segment-{index}",
        spec=segments.segment_of(chain, index),
        inputs={
            CHAMPION_OF: Input(evolved, (POPULATION,)),
            **environments.network_inputs(networks, upstream),
            **segments.before_input(previous),
        },
        execution=environments.execution_options(settings, settings.target),
    )


def _summarise(settings: Settings, upstream: Upstream, store: Store) -> Summary:
    """Count the adaptations, and the designs that diverged."""
    curves = read_study(settings, upstream, store).curves("adaptations").values()
    if not curves:
        return Summary(["no champion adapts"])
    n_diverged = float(sum(curve["n_diverged"].sum() for curve in curves))
    generations = f"{settings.transfer.n_generations} generations"
    return Summary(
        [f"{len(curves)} champions adapted to {settings.target_label} in {generations}"], {"n_diverged": n_diverged}
    )


def _curves(segment: Files) -> CurvePoints:
    curve = CURVE.read([segment])
    return CurvePoints(curve["generation"].tolist(), {"adapted_best_fitness": curve["best_fitness"]})


def _summarise_trial(trial: ChainId, adaptation: Sequence[Files]) -> Summary:
    n_diverged = CURVE.read(adaptation, trial.label)["n_diverged"].sum()
    return Summary(metrics={"adapted_n_designs_diverged": float(n_diverged)})


ADAPT = Stage(
    name="adapt",
    version=1,
    unit="generations",
    reads=lambda settings: ("train", "evolve") if settings.learner(settings.target) else ("evolve",),
    plan=_plan,
    item=_item,
    compute=segments.compute_segment,
    compute_batch=segments.compute_segments,
    summarise=_summarise,
    diverged=divergence.in_stage("adapt"),
    curves=_curves,
    summarise_trial=_summarise_trial,
)
