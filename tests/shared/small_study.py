"""A study from its settings to its results, in this process: what the tests of the middleware run."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pipeline.cluster import Cluster
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow.dispatcher import run_stage
from pipeline.workflow.graph import follow, results_of
from pipeline.workflow.progress import Work
from pipeline.workflow.stage import Results, Stage

ON_DRY_LAND = """name: tiny
grid: {depths: [1.0], environments: [dry_land], single_member_depths: [], n_trials: 1}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 4, afpo: {population_size: 4}}
transfer: {n_generations: 2}
assess: {n_designs: 8}
work: {generations_per_item: 2, engine: reference}
"""
"""Settings of a study that takes seconds."""


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


def n_items(store: Store) -> int:
    return sum(1 for stage in store.stages() for _ in store.keys(stage))
