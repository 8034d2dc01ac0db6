"""A small study, run stage by stage in this process by the tests of the workflow."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from pipeline.cluster import Cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.dispatcher import Dispatcher
from pipeline.workflow.graph import StageRun, results_of
from pipeline.workflow.identity import ChainId
from pipeline.workflow.stage import AnyStage, Files, Inputs, Item, Results

Value = TypeVar("Value")

ON_DRY_LAND = """name: tiny
grid: {depths: [1.0], environments: [dry_land], single_member_depths: [], n_trials: 1}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 4, afpo: {population_size: 4}}
transfer: {n_generations: 2}
assess: {n_designs: 8}
work: {generations_per_item: 2, engine: reference}
"""
"""Settings of a study that takes seconds."""

TINY = """name: tiny
throws: {n_throws: 6, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 20, batch_size: 64}
ensemble: {n_members: 2}
grid: {depths: [1.0], single_member_depths: [1.0], n_trials: 2}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 4, afpo: {population_size: 4}}
transfer: {n_generations: 3, adapted_environments: [dry_land]}
assess: {n_designs: 21}
work: {throws_per_item: 2, generations_per_item: 3}
"""
"""Settings of a small study with every kind of environment and all stages."""

ON_REFERENCE = ("work.generations_per_item=2", "work.engine=reference")
"""Overrides for two work items per trial, and for the engine that compiles nothing."""


def tiny(*overrides: str) -> Settings:
    """Return the settings of the study of every stage."""
    return parse(Settings, TINY, name="tiny", overrides=overrides)


def one_trial(*overrides: str) -> Settings:
    """Return its settings with one trial of two work items per arm, on the engine that compiles nothing."""
    return tiny("grid.n_trials=1", *ON_REFERENCE, *overrides)


class Terminal:
    """A terminal and a tracker in one, which record the lines shown."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def say(self, line: str) -> None:
        self.said.append(line)

    @contextlib.contextmanager
    def stage(self, *arguments, **options):
        yield ignored

    def mirror(self, *runs) -> None: ...


def silent(line: str) -> None: ...


def ignored(work: float) -> None: ...


def run(
    settings: Settings,
    store: Store,
    cluster: Cluster,
    stages: Sequence[AnyStage] = STAGES,
    say: Callable[[str], None] = silent,
) -> dict[str, Results]:
    """Run stages one after the other and return the results of each."""
    upstream: dict[str, Results] = {}
    for stage in stages:
        stage_run = StageRun(stage, settings, upstream, store, say)
        chains = stage_run.chains()
        Dispatcher(stage_run, cluster, ignored).run(chains)
        upstream[stage.name] = results_of(stage, chains)
    return upstream


def labelled(by_chain: Mapping[ChainId, Value]) -> dict[str, Value]:
    """Return a mapping from chains as one from their labels."""
    return {chain.label: value for chain, value in by_chain.items()}


def digests(upstream: dict[str, Results]) -> dict[str, list[str]]:
    """Return the digests of each chain's items, by stage and label."""
    return {
        f"{stage}/{label}": [manifest.digest for manifest in manifests]
        for stage, results in upstream.items()
        for label, manifests in labelled(results.done).items()
    }


def files_of(store: Store, manifest: Manifest) -> Files:
    """Read all files of an item."""
    return {name: store.read(manifest, name) for name in manifest.files}


def inputs_of(store: Store, item: Item) -> Inputs:
    """Read the inputs of an item."""
    return {name: {file: store.read(of.manifest, file) for file in of.files} for name, of in item.inputs.items()}


def n_items(store: Store) -> int:
    return len(list(store.items()))
