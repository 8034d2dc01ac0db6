"""evolve: the evolution of bodies and controllers, every trial of every depth and environment. Paper, "Evolution"."""

from collections.abc import Sequence

import numpy as np

from pipeline.config.settings import Settings
from pipeline.mlflow.run import CurvePoints
from pipeline.stages import divergence, environments, segments
from pipeline.stages.data_sets import networks_of
from pipeline.stages.files import CURVE
from pipeline.stages.reader import read_study
from pipeline.stages.segments import SegmentSpec, TrialSpec
from pipeline.store.design_file import design_json
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import Arm, ChainId, trials_of
from pipeline.workflow.stage import Chain, Files, Item, Stage, Summary, Upstream


def _plan(settings: Settings) -> Sequence[Chain[TrialSpec]]:
    lengths = segments.segment_lengths(settings, settings.evolution.n_generations)
    specs = [segments.trial_spec(settings, trial, trial.environment) for trial in trials_of(settings, "evolve")]
    return [segments.trial_chain(settings, spec, lengths) for spec in specs]


def _item(
    settings: Settings, chain: Chain[TrialSpec], index: int, previous: Manifest | None, upstream: Upstream
) -> Item[SegmentSpec]:
    trial = chain.spec
    networks = networks_of(trial.identity, settings.learner(trial.environment))
    members = environments.network_inputs(networks, upstream)
    return Item(
        EVOLVE.name,
        EVOLVE.version,
        label=f"{chain.label}/segment-{index}",
        spec=segments.segment_of(chain, index),
        inputs={**members, **segments.before_input(previous)},
        execution=environments.execution_options(settings, trial.environment),
    )


def _summarise(settings: Settings, upstream: Upstream, store: Store) -> Summary:
    """Report each arm's best fitness, and what diverged or was rejected."""
    curves, best = read_study(settings, upstream, store).curves(), dict[Arm, list[float]]()
    for trial, curve in curves.items():
        best.setdefault(trial.arm, []).append(float(curve["best_fitness"][-1]))
    unit = settings.evolution.maximised.unit
    lines = [settings.evolution.maximised.with_unit(f"fitness: {settings.selected_for}")] if best else []
    metrics = {"n_diverged": float(sum(curve["n_diverged"].sum() for curve in curves.values()))}
    for arm, fitness in best.items():
        known = [value for value in fitness if np.isfinite(value)]
        shown = f"{segments.mean_and_deviation(known)} {unit} (n = {len(known)})" if known else "     -"
        n_lost = len(fitness) - len(known)
        lost = f"; in {n_lost} of {len(fitness)} trials every design diverged" if n_lost else ""
        lines.append(f"{arm.environment:>15} at {arm.depth:g} m: champions' fitness {shown}{lost}")
        if known:
            metrics[f"champion_fitness.{arm.environment}.{arm.depth:g}m"] = float(np.mean(known))
    draws = segments.draws_of(list(curves.values())).items()
    rejecting = {operator: counts for operator, counts in draws if counts[1]}
    if rejecting:
        listed = ", ".join(f"{n / of:.1%} of {of:,} by {operator}" for operator, (of, n) in rejecting.items())
        lines.append(f"drawn again because evolution.morphology did not allow them: {listed}")
        metrics |= {f"rejected_share.{operator}": n / of for operator, (of, n) in rejecting.items()}
    return Summary(lines, metrics)


def _curves(segment: Files) -> CurvePoints:
    curve = CURVE.read([segment])
    return CurvePoints(curve["generation"].tolist(), {name: curve[name] for name in ("best_fitness", "median_fitness")})


def _summarise_trial(trial: ChainId, items: Sequence[Files]) -> Summary:
    """Report a trial's champion."""
    curve, champion = CURVE.read(items, trial.label), segments.champion_of(segments.population_of(items[-1]))
    best, n_diverged = float(curve["best_fitness"][-1]), float(curve["n_diverged"].sum())
    artifacts = {} if champion is None else {"champion.json": design_json(champion)}
    return Summary(metrics={"champion_fitness": best, "n_designs_diverged": n_diverged}, artifacts=artifacts)


EVOLVE = Stage(
    name="evolve",
    version=3,
    unit="generations",
    reads=lambda settings: ("train",) if settings.needs_ensemble else (),
    plan=_plan,
    item=_item,
    compute=segments.compute_segment,
    compute_batch=segments.compute_segments,
    summarise=_summarise,
    diverged=divergence.in_stage("evolve"),
    curves=_curves,
    summarise_trial=_summarise_trial,
)
