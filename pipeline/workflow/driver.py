"""The driver: the one process that runs a study's stages, commits their results and mirrors them to MLflow."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pipeline.cluster import Cluster
from pipeline.cluster.process import signals_unwind
from pipeline.config.settings import Settings
from pipeline.errors import DamagedArtifact
from pipeline.store.store import Store
from pipeline.workflow.compiling import compile_kernels
from pipeline.workflow.dispatcher import Dispatcher
from pipeline.workflow.graph import ChainProgress, StageRun, other_code, require, results_of
from pipeline.workflow.progress import Progress
from pipeline.workflow.record import DrivenStudy
from pipeline.workflow.stage import AnyStage, Results, Upstream
from pipeline.workflow.study_mirror import StudyMirror

if TYPE_CHECKING:
    from pipeline.mlflow.mirror import Tracker


def drive(
    settings: Settings,
    wanted: Sequence[AnyStage],
    *,
    stages: Sequence[AnyStage],
    store: Store,
    open_cluster: Callable[[], AbstractContextManager[Cluster]],
    tracker: Tracker,
    progress: Progress,
    source: str = "",
    expected_seconds: Callable[[float], Mapping[str, float]] = lambda n_cores: {},
) -> Upstream:
    """Compute what is missing of some stages, and summarise their results.

    The cluster is opened only once there is something to compute. Trials are mirrored to MLflow while they are
    computed.

    Args:
        settings: the study's settings.
        wanted: stages to run; the stages before them must be done, or wanted too.
        stages: all stages of a study, in order.
        store, tracker, progress: where results are committed, mirrored and announced.
        open_cluster: starts or joins the cluster.
        source: where the settings come from, for the record: "preset laptop", or the path of a file.
        expected_seconds: returns about how long what is left of each stage takes on a number of cores [s].

    Returns:
        Results of every stage up to the last one wanted, by name; those of wanted stages say what diverged.

    Raises:
        PuddleError: results of an earlier stage are missing, the cluster can't be used, or the store is damaged in a
            way that computing an item again does not mend.
    """
    mirror = StudyMirror(settings, store, tracker, source=source)
    with store.lock_study(settings.name), signals_unwind(), contextlib.ExitStack() as stack:

        @functools.cache
        def cluster() -> Cluster:
            compile_kernels(settings.physics)
            progress.say("starting the cluster")
            return stack.enter_context(open_cluster())

        record = DrivenStudy(settings, store, progress.say, source)
        times = functools.cache(lambda: expected_seconds(cluster().n_cores))
        driver = _Driver(settings, stages, store, record, cluster, mirror, progress, times)
        discarded: set[tuple[str, str]] = set()
        while True:
            try:
                upstream = driver.run(wanted)
                break
            except DamagedArtifact as damage:
                if damage.stage is None or damage.key is None or (damage.stage, damage.key) in discarded:
                    raise  # not an item, or computed anew and damaged again: the disk can't be trusted
                progress.say(f"{damage}")
                store.discard(damage.stage, damage.key)
                discarded.add((damage.stage, damage.key))
        stack.close()  # before the wait for MLflow
        mirror.close(progress.say)
    return upstream


@dataclass(frozen=True)
class _Driver:
    settings: Settings
    stages: Sequence[AnyStage]
    store: Store
    record: DrivenStudy
    cluster: Callable[[], Cluster]
    mirror: StudyMirror
    progress: Progress
    times: Callable[[], Mapping[str, float]]

    def run(self, wanted: Sequence[AnyStage]) -> Upstream:
        upstream: dict[str, Results] = {}
        last = max(wanted, key=self.stages.index)
        for stage in self.stages[: 1 + self.stages.index(last)]:
            run = StageRun(stage, self.settings, upstream, self.store, self.progress.say)
            chains = run.chains()
            if stage not in wanted:
                upstream[stage.name] = results_of(stage, chains)
                continue
            require(self.settings, stage, self.stages, upstream)
            self.mirror.start(stage, chains)
            try:
                self._compute(run, chains, wanted)
            finally:  # `puddle status` needs to know what failed, however the stage ended
                upstream[stage.name] = results_of(stage, chains)
                self.record.update(upstream)
            found = upstream[stage.name]
            upstream[stage.name] = replace(found, diverged=stage.diverged(self.settings, upstream, self.store))
            summary = stage.summarise(self.settings, upstream, self.store)
            self.progress.say(f"{stage.name}:\n" + "\n".join(f"  {line}" for line in summary.lines))
            self.mirror.finish(stage, found, summary, is_last=stage is self.stages[-1])
        if line := other_code(upstream):
            self.progress.say(line)
        return upstream

    def _compute(self, run: StageRun, chains: Sequence[ChainProgress], wanted: Sequence[AnyStage]) -> None:
        if not any(chain.open for chain in chains):
            return
        left = sum(chain.left for chain in chains if chain.open)
        done = sum(chain.done for chain in chains)
        cluster = self.cluster()
        number = self.stages.index(run.stage) + 1
        place = f"stage {number} of {len(self.stages)}, {run.stage.name}"
        later = sum(self.times().get(stage.name, 0.0) for stage in self.stages[number:] if stage in wanted)
        with self.progress.stage(place, total=left + done, done=done, later=later) as advance:
            Dispatcher(run, cluster, advance).run(chains)
