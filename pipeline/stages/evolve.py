"""evolve: the evolution of bodies and controllers, every trial of every depth and environment. Paper, "Evolution"."""

from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.config.settings import Settings
from pipeline.mlflow.run import CurvePoints
from pipeline.stages import divergence, environments, segments
from pipeline.stages.data_sets import networks_of
from pipeline.stages.segments import SegmentSpec, TrialSpec
from pipeline.store.design_file import design_json
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.identity import Arm, ChainId, trials_of
from pipeline.workflow.stage import Chain, Item, Results, Stage, Summary, Upstream


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


def _summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Report each arm's best fitness, and each trial's curves."""
    curves, best = [], dict[Arm, list[float]]()
    for trial in trials_of(settings, "evolve"):
        if trial not in results.done:
            continue
        curve = segments.read_curve(store, results.done[trial])
        final = float(curve["best_fitness"][-1])
        best.setdefault(trial.arm, []).append(final)
        curves.append(curve)
    unit = settings.evolution.maximised.unit
    lines = [settings.evolution.maximised.with_unit(f"fitness: {settings.selected_for}")] if best else []
    metrics = {"n_diverged": float(sum(curve["n_diverged"].sum() for curve in curves))}
    for arm, fitness in best.items():
        known = [value for value in fitness if np.isfinite(value)]
        shown = f"{segments.mean_and_deviation(known)} {unit} (n = {len(known)})" if known else "     -"
        n_lost = len(fitness) - len(known)
        lost = f"; in {n_lost} of {len(fitness)} trials every design diverged" if n_lost else ""
        lines.append(f"{arm.environment:>15} at {arm.depth:g} m: champions' fitness {shown}{lost}")
        if known:
            metrics[f"champion_fitness.{arm.environment}.{arm.depth:g}m"] = float(np.mean(known))
    rejecting = {operator: counts for operator, counts in segments.draws_of(curves).items() if counts[1]}
    if rejecting:
        listed = ", ".join(f"{n / of:.1%} of {of:,} by {operator}" for operator, (of, n) in rejecting.items())
        lines.append(f"drawn again because evolution.morphology did not allow them: {listed}")
        metrics |= {f"rejected_share.{operator}": n / of for operator, (of, n) in rejecting.items()}
    return Summary(lines, metrics)


def _curves(store: Store, segment: Manifest) -> CurvePoints:
    curve = segments.read_curve(store, [segment])
    return CurvePoints(curve["generation"].tolist(), {name: curve[name] for name in ("best_fitness", "median_fitness")})


def _summarise_trial(store: Store, trial: ChainId, parts: Sequence[Manifest]) -> Summary:
    """Report a trial's champion."""
    curve = segments.read_curve(store, parts)
    best, n_diverged = float(curve["best_fitness"][-1]), float(curve["n_diverged"].sum())
    files = {segments.POPULATION: store.read(parts[-1], segments.POPULATION)}
    champion = segments.champion_of(segments.population_of(files))
    artifacts = {} if champion is None else {"champion.json": design_json(champion)}
    return Summary(metrics={"champion_fitness": best, "n_designs_diverged": n_diverged}, artifacts=artifacts)


def _diverged(settings: Settings, results: Results, store: Store) -> Mapping[ChainId, str]:
    return {
        trial: message
        for trial, parts in results.done.items()
        if (message := divergence.in_trial(segments.read_curve(store, parts)))
    }


EVOLVE = Stage(
    name="evolve",
    version=2,
    unit="generations",
    reads=lambda settings: ("train",) if settings.needs_ensemble else (),
    plan=_plan,
    item=_item,
    compute=segments.compute_segment,
    compute_batch=segments.compute_segments,
    summarise=_summarise,
    diverged=_diverged,
    curves=_curves,
    summarise_trial=_summarise_trial,
)
