"""What the tests of the pipeline share: one study, as small as can be, with every stage done; and a browser."""

from collections.abc import Iterator

import pytest
from browser import CHROMIUM, Browser

from pipeline.cluster import serial_cluster
from pipeline.configuration import parse
from pipeline.settings import Settings
from pipeline.stages import STAGES
from pipeline.store import Store
from pipeline.study import follow, results_of, run_stage

TINY = """
name: tiny
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


class NoBar:
    def advance(self, work: float) -> None: ...


def silent(line: str) -> None: ...


@pytest.fixture(scope="session")
def settings() -> Settings:
    return parse(Settings, TINY, name="tiny")


@pytest.fixture(scope="session")
def study(settings, tmp_path_factory):
    """A store with every stage done, and what came of each."""
    store = Store.open(tmp_path_factory.mktemp("stages") / "store", create=True)
    upstream = {}
    with serial_cluster() as cluster:
        for stage in STAGES:
            walks = follow(stage, settings, store, upstream, say=silent)
            run_stage(settings, stage, walks, upstream, store=store, cluster=cluster, bar=NoBar(), say=silent)
            upstream[stage.name] = results_of(stage, walks)
    return store, upstream


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    started = Browser(tmp_path_factory.mktemp("profile"))
    yield started
    started.close()
