"""A study from its settings to its results, in this process: what the tests of the middleware run."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pipeline.cluster import Cluster
from pipeline.progress import Work
from pipeline.settings import Settings
from pipeline.stage import Results, Stage
from pipeline.stages import STAGES
from pipeline.store import Store
from pipeline.study import follow, results_of, run_stage


class NoBar:
    def advance(self, work: Work) -> None: ...


def silent(line: str) -> None: ...


def run(
    settings: Settings,
    store: Store,
    cluster: Cluster,
    stages: Sequence[Stage] = STAGES,
    say: Callable[[str], None] = silent,
) -> dict[str, Results]:
    """Run stages one after the other; give what came of each."""
    upstream: dict[str, Results] = {}
    for stage in stages:
        walks = follow(stage, settings, store, upstream, say=say)
        run_stage(settings, stage, walks, upstream, store=store, cluster=cluster, bar=NoBar(), say=say)
        upstream[stage.name] = results_of(stage, walks)
    return upstream


def digests(upstream: dict[str, Results]) -> dict[str, list[str]]:
    """Give the digests of each chain's items, by stage and label."""
    return {
        f"{stage}/{label}": [manifest.digest for manifest in manifests]
        for stage, results in upstream.items()
        for label, manifests in results.done.items()
    }
