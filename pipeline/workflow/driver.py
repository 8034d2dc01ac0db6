"""The driver: the one process that runs a study's stages, keeps their results and mirrors them to MLflow."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from typing import Any

from pydantic import ValidationError

from pipeline.cluster import Cluster
from pipeline.cluster.process import signals_unwind
from pipeline.config.settings import Settings
from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.store.encoding import canonical_json, digest, encode_json
from pipeline.store.store import FailedChain, Store, StudyItem, StudyRecord
from pipeline.tracking.mirror import Run, Tracker
from pipeline.workflow.background import Background
from pipeline.workflow.dispatcher import Limits, run_stage
from pipeline.workflow.graph import StageRun, require, results_of
from pipeline.workflow.progress import NOTHING, Bar, Progress, Work
from pipeline.workflow.stage import AnyStage, Results, Summary, Upstream
from tasks.simulation import batch


def drive(
    settings: Settings,
    wanted: Sequence[AnyStage],
    *,
    stages: Sequence[AnyStage],
    store: Store,
    open_cluster: Callable[[], AbstractContextManager[Cluster]],
    tracker: Tracker,
    progress: Progress,
    how_to_run: Callable[[str], str],
    limits: Limits = Limits(),  # noqa: B008 (frozen)
) -> Upstream:
    """Do what is missing of some stages, and show what came of them.

    The cluster is opened only once there is something to compute, so that a study that is done says so at once. MLflow
    hears of a stage while the next one computes: a study of hundreds of trials has hundreds of thousands of points.

    Args:
        settings: the study's.
        wanted: stages to run; those before them must be done, or be wanted too.
        stages: all stages of a study, in order.
        store: where results are kept.
        open_cluster: starts or joins the cluster.
        tracker: MLflow.
        progress: the terminal.
        how_to_run: returns the command line that runs a stage, for messages.
        limits: how long an item may take.

    Returns:
        Results of every stage up to the last one wanted; of those wanted with what diverged in them.
    """
    with (
        store.lock_study(settings.name),
        signals_unwind(),
        Background("bringing the record of runs and curves up to date", progress.say) as background,
        contextlib.ExitStack() as stack,
    ):
        cluster: list[Cluster] = []

        def the_cluster() -> Cluster:
            if not cluster:
                progress.say("starting the cluster")
                if not batch.is_compiled():
                    progress.say("each machine compiles the kernels at their first use: half a minute without progress")
                cluster.append(stack.enter_context(open_cluster()))
            return cluster[0]

        def mirror(study: Run, stage: Run, trials: Sequence[Run]) -> None:
            background.do(partial(tracker.mirror, study, stage, trials))

        _introduce(settings, store, progress.say)
        discarded: set[tuple[str, str]] = set()
        while True:
            try:
                return _drive(settings, wanted, stages, store, the_cluster, mirror, progress, how_to_run, limits)
            except DamagedArtifact as damage:
                if damage.stage is None or damage.key is None or (damage.stage, damage.key) in discarded:
                    raise  # not an item's, or made anew and damaged again: the disk can't be trusted
                progress.say(f"{damage}")
                store.discard(damage.stage, damage.key)
                discarded.add((damage.stage, damage.key))
                for one in cluster:
                    one.cancel_all()  # what comes next knows nothing of what is under way, and submits it again


def _drive(
    settings: Settings,
    wanted: Sequence[AnyStage],
    stages: Sequence[AnyStage],
    store: Store,
    the_cluster: Callable[[], Cluster],
    mirror: Callable[[Run, Run, Sequence[Run]], None],
    progress: Progress,
    how_to_run: Callable[[str], str],
    limits: Limits,
) -> Upstream:
    upstream: dict[str, Results] = {}
    last = max(wanted, key=stages.index)
    for stage in stages[: 1 + stages.index(last)]:
        run = StageRun(stage, settings, upstream, store, progress.say)
        chains = run.chains()
        if stage not in wanted:
            upstream[stage.name] = results_of(stage, chains)
            continue
        require(settings, stage, stages, upstream, how_to_run=how_to_run)
        all_done = False
        try:
            if any(chain.open for chain in chains):
                left = sum((chain.left for chain in chains if chain.open), NOTHING)
                done = sum((chain.done for chain in chains), NOTHING)
                cluster = the_cluster()
                with progress.stage(stage.name, unit=stage.unit, total=left + done, done=done) as bar:
                    noting = _Noting(bar, settings, store)
                    run_stage(run, chains, cluster=cluster, bar=noting, limits=limits)
            all_done = stage is last
        finally:  # however it ended, `puddle status` needs to know what failed
            upstream[stage.name] = results_of(stage, chains)
            if all_done or _recorded(settings, store) is not None:
                _keep_record(settings, upstream, store)
        found = upstream[stage.name]
        upstream[stage.name] = replace(found, diverged=stage.diverged(settings, found, store))
        summary = stage.summarise(settings, found, store)
        progress.say(f"{stage.name}:\n" + "\n".join(f"  {line}" for line in summary.lines))
        mirror(*_runs(settings, stage, upstream, summary, finished=stage is stages[-1]))
    return upstream


def _introduce(settings: Settings, store: Store, say: Callable[[str], None]) -> None:
    """Put the study's settings on record before its first piece; where its name had others, say so and leave them.

    What is on record is what `puddle gc` keeps, so others stay there until these have a result, or need none.
    """
    chosen = settings.model_dump(mode="json")
    try:
        before = store.read_study(settings.name)
    except DamagedArtifact as damage:
        say(f"{damage}")
        before = None
    if before is not None and before.settings == chosen:
        return
    if before is not None:
        differ = _differences(before.settings, chosen)
        listed = ", ".join(differ[:4]) + (f" and {len(differ) - 4} more" if len(differ) > 4 else "")
        say(
            f"study {settings.name} had other settings until now ({listed}). Its report will be replaced. What it "
            f"computed stays: those settings bring the old report back in seconds, until `puddle gc`. To keep both "
            f"reports, stop (Ctrl-C) before the first result is in, and add --set name=ANOTHER."
        )
        return
    store.write_study(settings.name, chosen, ())


class _Noting:
    """A stage's bar that puts the study's settings on record once the stage's first piece is kept."""

    def __init__(self, bar: Bar, settings: Settings, store: Store) -> None:
        self._bar, self._settings, self._store = bar, settings, store
        self._on_record = _recorded(settings, store) is not None

    def advance(self, work: Work) -> None:
        if not self._on_record:
            self._store.write_study(self._settings.name, self._settings.model_dump(mode="json"), ())
            self._on_record = True
        self._bar.advance(work)


def settings_of(record: StudyRecord) -> Settings:
    """Return the settings that a study has on record.

    Raises:
        PuddleError: they are of another puddle, with other fields; names the first.
    """
    try:
        return Settings.model_validate(record.settings)
    except ValidationError as error:
        first = error.errors()[0]
        raise PuddleError(
            f"study {record.name}: expected settings of this puddle, came those of another "
            f"({'.'.join(map(str, first['loc']))}: {first['msg']}). The puddle that made the study can read them."
        ) from None


def _differences(old: Any, new: Any, name: str = "") -> list[str]:
    """Name the settings that differ, with both values."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        names = [*new, *(gone for gone in old if gone not in new)]
        return [line for one in names for line in _differences(old.get(one), new.get(one), f"{name}.{one}".strip("."))]
    return [] if old == new else [f"{name}: {json.dumps(old)} → {json.dumps(new)}"]


def _keep_record(settings: Settings, upstream: Upstream, store: Store) -> None:
    """Write down what the study is made of, and what it lacks; of later stages, what was written down before."""
    before = _recorded(settings, store)
    items = [
        StudyItem(name, f"{chain.label}#{index}", manifest.key)
        for name, results in upstream.items()
        for chain, manifests in results.done.items()
        for index, manifest in enumerate(manifests)
    ]
    failed = [
        FailedChain(name, of.label, why) for name, results in upstream.items() for of, why in results.failed.items()
    ]
    if before is not None:
        items += [item for item in before.items if item.stage not in upstream]
        failed += [lost for lost in before.failed if lost.stage not in upstream]
    store.write_study(settings.name, settings.model_dump(mode="json"), items, failed)


def _recorded(settings: Settings, store: Store) -> StudyRecord | None:
    """Return what was written down of this study; None where that is damaged or of other settings."""
    try:
        record = store.read_study(settings.name)
    except DamagedArtifact:
        return None
    return record if record is not None and record.settings == settings.model_dump(mode="json") else None


def _runs(
    settings: Settings, stage: AnyStage, upstream: Upstream, summary: Summary, *, finished: bool
) -> tuple[Run, Run, list[Run]]:
    """Say what MLflow is to show: the study, the stage, and its trials."""
    chosen = settings.model_dump(mode="json")
    results = upstream[stage.name]
    study = Run(
        name=settings.name,
        key=digest(canonical_json(chosen)),
        params=chosen,
        metrics=summary.metrics if summary.of_study else {},
        artifacts={"settings.json": encode_json(chosen), **(summary.artifacts if summary.of_study else {})},
        status="FINISHED" if finished else None,
    )
    run = Run(
        name=stage.name,
        key=stage.name,
        metrics={**summary.metrics, "core_seconds": results.seconds, "n_set_aside": len(results.failed)},
        inputs={name: _digest_of(upstream[name]) for name in stage.reads(settings)},
        outputs={stage.name: _digest_of(results)},
        artifacts=summary.artifacts,
        status="FAILED" if results.failed else "FINISHED",
    )
    trials = [
        Run(
            name=trial.chain.label,
            key=trial.chain.label,
            params=trial.params,
            metrics=trial.metrics,
            curves={name: curve.tolist() for name, curve in trial.curves.items()},
            steps=trial.steps,
            outputs={trial.chain.label: results.done[trial.chain][-1].digest},
            status="FINISHED",
        )
        for trial in summary.trials
    ]
    return study, run, trials


def _digest_of(results: Results) -> str:
    """One SHA-256 for all that a stage made."""
    return digest(canonical_json({chain.label: [m.digest for m in done] for chain, done in results.done.items()}))
