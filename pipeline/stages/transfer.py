"""transfer: how champions do in the true slush, where they have never been. Paper, "Evolution" and Fig. 4.

The champion of every trial is scored zero-shot in True Slush at its own depth. Then its body is frozen and its
controller is evolved from scratch in True Slush: what is still missing after that is the body's fault.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.config.settings import Settings
from pipeline.stages import divergence, segments
from pipeline.stages.segments import CHAMPION_OF, POPULATION
from pipeline.store.design_file import design_document
from pipeline.store.encoding import decode_json, encode_json
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.stage import Chain, Files, Input, Item, Job, Results, Stage, Summary, TrialSummary, Upstream
from tasks.design import Designs

NAME, VERSION = "transfer", 1

ADAPTED_TO = "adapted"
"""Name of an input: the last segment of the adaptation."""

SCORING = 2 / 64
"""What scoring a champion before and after costs: two rollouts, of the 64 or so of a generation."""

ADAPTED_DIVERGED = "adapted_n_designs_diverged"
"""What MLflow calls the designs of an adaptation that diverged, of all its generations."""

SCORE, CHAMPION, ADAPTED = "score.json", "champion.json", "adapted.json"


def reads(settings: Settings) -> tuple[str, ...]:
    """Champions come out of evolution."""
    return ("evolve",)


def plan(settings: Settings) -> Sequence[Chain]:
    """Give every trial the segments of its adaptation, if it has one, and then a piece that scores its champions."""
    chains = []
    for environment, depth, trial in settings.grid.trials():
        spec = segments.segment_spec(
            settings, stage=NAME, environment=environment, world="true_slush", depth=depth, trial=trial
        )
        label = segments.trial_label(environment, depth, trial)
        adapted = environment in settings.transfer.adapted_environments
        adaptation = segments.segment_lengths(settings, settings.transfer.n_generations) if adapted else ()
        chains.append(segments.chain_of(settings, label, spec, (*adaptation, SCORING)))
    return chains


def item(settings: Settings, chain: Chain, index: int, previous: Manifest | None, upstream: Upstream) -> Item:
    """Specify the next segment of an adaptation, or the scoring at its end."""
    champion = Input(upstream["evolve"].chain(chain.label)[-1], (POPULATION,))
    inputs = {CHAMPION_OF: champion}
    spec = dict(chain.spec)
    if index < chain.n_items - 1:
        label = f"{chain.label}/adaptation-{index}"
        spec |= segments.generations_of(settings, settings.transfer.n_generations, index)
        if previous is not None:
            inputs[segments.BEFORE] = Input(previous, (POPULATION,))
    else:
        label = f"{chain.label}/score"
        if previous is not None:
            inputs[ADAPTED_TO] = Input(previous, (POPULATION,))
    execution = segments.execution(settings, "true_slush")
    return Item(stage=NAME, version=VERSION, label=label, spec=spec, inputs=inputs, execution=execution)


def compute(job: Job, inputs: Mapping[str, Files]) -> Files:
    """Advance an adaptation, or score a trial's champion before and after it."""
    if _is_adaptation(job):
        return segments.compute_segment(job, inputs)
    evolved = segments.population_of(inputs[CHAMPION_OF])
    champion = segments.champion_of(evolved)
    if champion is None:
        return {SCORE: encode_json({"status": divergence.NO_CHAMPION})}
    files = {CHAMPION: encode_json(design_document(champion))}
    scores: dict[str, Any] = {"status": "ok", "predicted": float(evolved.fitness[evolved.champion()])}
    scores |= _in_true_slush(job, champion, "zero_shot")
    if ADAPTED_TO in inputs:
        adapted = segments.champion_of(segments.population_of(inputs[ADAPTED_TO]))
        if adapted is not None:
            files[ADAPTED] = encode_json(design_document(adapted))
            scores |= _in_true_slush(job, adapted, "adapted")
    return {**files, SCORE: encode_json(scores)}


def compute_batch(jobs: Sequence[Job], inputs: Sequence[Mapping[str, Files]]) -> list[Files]:
    """Advance adaptations side by side; champions are scored one after another, which takes but milliseconds."""
    if _is_adaptation(jobs[0]):
        return segments.compute_segments(jobs, inputs)
    return [compute(job, of) for job, of in zip(jobs, inputs, strict=True)]


def _is_adaptation(job: Job) -> bool:
    return "n_generations" in job.spec


def _in_true_slush(job: Job, design: Designs, name: str) -> dict[str, float | None]:
    """Displacement of a design's root and centre of mass; null where it diverged."""
    rollouts = segments.roll_out(job.spec, job.execution, segments.world_of(job.spec, {}), design)
    root, whole = float(rollouts.displacement[0]), float(rollouts.com_displacement[0])
    return {name: root, f"{name}_com": whole} if np.isfinite(root) else {name: None, f"{name}_com": None}


def read_scores(settings: Settings, results: Results, store: Store) -> list[dict[str, Any]]:
    """Read every trial's scores, with its environment, depth [m] and trial."""
    rows = []
    for environment, depth, trial in settings.grid.trials():
        label = segments.trial_label(environment, depth, trial)
        if label in results.done:
            scores = decode_json(store.read(results.done[label][-1], SCORE), label)
            rows.append({"environment": environment, "depth": depth, "trial": trial, **scores})
    return rows


def summarise(settings: Settings, results: Results, store: Store) -> Summary:
    """Tabulate champions in True Slush by depth and environment."""
    rows = read_scores(settings, results, store)
    lines = [f"{'depth':>7}  {'evolved in':<15} {'n':>3}  {'predicted':>14}  {'zero-shot':>14}  {'adapted':>14}   [m]"]
    metrics = {}
    for depth in settings.grid.depths:
        for environment in dict.fromkeys(e for e, d, _ in settings.grid.trials() if d == depth):
            arm = [row for row in rows if row["environment"] == environment and row["depth"] == depth]
            cells = []
            for name in ("predicted", "zero_shot", "adapted"):
                values = [row[name] for row in arm if row.get(name) is not None]
                cells.append(segments.mean_and_deviation(values))
                if values:
                    metrics[f"{name}.{environment}.{depth:g}m"] = float(np.mean(values))
            lines.append(f"{depth:7g}  {environment:<15} {len(arm):>3}  " + "  ".join(f"{cell:>14}" for cell in cells))
    trials = [_of_trial(row, results, store) for row in rows]
    metrics["n_diverged"] = sum(trial.metrics.get(ADAPTED_DIVERGED, 0.0) for trial in trials)
    return Summary(lines=lines, metrics=metrics, trials=trials)


def _of_trial(row: Mapping[str, Any], results: Results, store: Store) -> TrialSummary:
    """Sum up a trial's scores, and its adaptation where there was one."""
    name = segments.trial_label(row["environment"], row["depth"], row["trial"])
    metrics = {k: v for k, v in row.items() if isinstance(v, float) and k != "depth"}
    curves = {}
    if adaptation := results.done[name][:-1]:
        curve = segments.read_curve(store, adaptation)
        curves = {"adapted_best_fitness": curve["best_fitness"].astype(np.float64)}
        metrics[ADAPTED_DIVERGED] = float(curve["n_diverged"].sum())
    return TrialSummary(name, {key: row[key] for key in ("environment", "depth", "trial")}, metrics, curves)


def diverged(settings: Settings, results: Results, store: Store) -> dict[str, str]:
    """Say what diverged in True Slush, by trial's label."""
    lines = {}
    for label, (*adaptation, scored) in results.done.items():
        scores = decode_json(store.read(scored, SCORE), label)
        curve = segments.read_curve(store, adaptation) if adaptation else None
        if said := divergence.in_transfer(scores, curve):
            lines[label] = said
    return lines


STAGE = Stage(
    name=NAME,
    version=VERSION,
    unit="generations",
    reads=reads,
    plan=plan,
    item=item,
    compute=compute,
    compute_batch=compute_batch,
    summarise=summarise,
    diverged=diverged,
)
