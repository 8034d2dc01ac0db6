"""evolve: the evolution of bodies and controllers, every trial of every depth and environment. Paper, "Evolution"."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages import divergence, segments
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.stage import Chain, Input, Item, Results, Stage, Summary, TrialSummary, Upstream
from tasks.evolution import OPERATORS

NAME, VERSION = "evolve", 2

DIVERGED = "n_designs_diverged"
"""What MLflow calls the designs of a trial that diverged, of all its generations."""


def reads(settings: Settings) -> tuple[str, ...]:
    """Residual environments need the networks; the others need nothing."""
    return ("train",) if settings.needs_ensemble else ()


def plan(settings: Settings) -> Sequence[Chain]:
    """Give every trial its chain of segments."""
    chains = []
    for environment, depth, trial in settings.grid.trials():
        spec = segments.segment_spec(
            settings, stage=NAME, environment=environment, world=environment, depth=depth, trial=trial
        )
        label = segments.trial_label(environment, depth, trial)
        lengths = segments.segment_lengths(settings, settings.evolution.n_generations)
        chains.append(segments.chain_of(settings, label, spec, lengths))
    return chains


def item(settings: Settings, chain: Chain, index: int, previous: Manifest | None, upstream: Upstream) -> Item:
    """Specify a trial's next segment."""
    trial = chain.spec["identity"][-1]
    inputs = segments.world_inputs(settings, chain.spec["world"], trial, upstream)
    if previous is not None:
        inputs[segments.BEFORE] = Input(previous, (segments.POPULATION,))
    generations = segments.generations_of(settings, settings.evolution.n_generations, index)
    return Item(
        stage=NAME,
        version=VERSION,
        label=f"{chain.label}/segment-{index}",
        spec={**chain.spec, **generations},
        inputs=inputs,
        execution=segments.execution(settings, chain.spec["world"]),
    )


def summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Report each arm's best fitness, and each trial's curves."""
    trials, best = [], dict[tuple[str, float], list[float]]()
    drawn, rejected = dict.fromkeys(OPERATORS, 0), dict.fromkeys(OPERATORS, 0)
    for environment, depth, trial in settings.grid.trials():
        label = segments.trial_label(environment, depth, trial)
        if label not in results.done:
            continue
        curve = segments.read_curve(store, results.done[label])
        final = float(curve["best_fitness"][-1])
        best.setdefault((environment, depth), []).append(final)
        curves = {name: curve[name].astype(np.float64) for name in ("best_fitness", "median_fitness")}
        for operator in OPERATORS:
            drawn[operator] += int(curve[segments.drawn_column(operator)].sum())
            rejected[operator] += int(curve[segments.rejected_column(operator)].sum())
        params: dict[str, str | int | float] = {"environment": environment, "depth": depth, "trial": trial}
        of_trial = {"champion_fitness": final, DIVERGED: float(curve["n_diverged"].sum())}
        trials.append(TrialSummary(name=label, params=params, metrics=of_trial, curves=curves))
    lines = []
    metrics = {"n_diverged": sum(trial.metrics[DIVERGED] for trial in trials)}
    for (world, depth), of in best.items():
        known = [fitness for fitness in of if np.isfinite(fitness)]
        said = f"{segments.mean_and_deviation(known)} m (n = {len(known)})" if known else "     -"
        lost = f"; in {len(of) - len(known)} of {len(of)} trials every design diverged" if len(known) < len(of) else ""
        lines.append(f"{world:>15} at {depth:g} m: champions' fitness {said}{lost}")
        if known:
            metrics[f"champion_fitness.{world}.{depth:g}m"] = float(np.mean(known))
    shares = {operator: rejected[operator] / drawn[operator] for operator in OPERATORS if rejected[operator]}
    if shares:
        said = ", ".join(f"{share:.1%} of {drawn[operator]:,} by {operator}" for operator, share in shares.items())
        lines.append(f"drawn again because unjoined links overlapped at rest: {said}")
        metrics |= {f"rejected_share.{operator}": share for operator, share in shares.items()}
    return Summary(lines=lines, metrics=metrics, trials=trials)


def diverged(settings: Settings, results: Results, store: Store) -> dict[str, str]:
    """Say what diverged in trials, by label."""
    return {
        label: said
        for label, trial in results.done.items()
        if (said := divergence.in_trial(segments.read_curve(store, trial)))
    }


STAGE = Stage(
    name=NAME,
    version=VERSION,
    unit="generations",
    reads=reads,
    plan=plan,
    item=item,
    compute=segments.compute_segment,
    compute_batch=segments.compute_segments,
    summarise=summarise,
    diverged=diverged,
)
