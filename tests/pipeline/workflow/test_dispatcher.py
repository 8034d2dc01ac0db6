"""The dispatcher: retries of items that fail, and batches of items that are faster together."""

import dataclasses
from collections.abc import Sequence

import pytest
from small_study import ON_DRY_LAND, digests, run
from small_study import tiny as small

from pipeline.cluster import Cluster, Ticket, serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages.adapt import ADAPT
from pipeline.stages.evolve import EVOLVE
from pipeline.stages.train import TRAIN
from pipeline.store.store import Store
from pipeline.workflow.dispatcher import _take_batch
from pipeline.workflow.graph import ChainProgress
from pipeline.workflow.stage import AnyStage, Files, Inputs, Item


def tiny(*overrides: str) -> Settings:
    two_whole_trials = ("grid.n_trials=2", "work.generations_per_item=4")
    return parse(Settings, ON_DRY_LAND, name="tiny", overrides=(*two_whole_trials, *overrides))


BATCHED = ("work.engine=batch", "grid.n_trials=5", "work.generations_per_item=2", "evolution.afpo.population_size=2")
"""Ten items, of which the lanes of any machine hold at least four."""


class Batches:
    """A cluster that reports some number of cores and notes which trials are batched."""

    n_gpus = 0.0

    def __init__(self, inner: Cluster, n_cores: float = 1.0) -> None:
        self.inner, self.n_cores, self.batches = inner, n_cores, list[list[int]]()
        self.batched = set[str]()  # stages with batches

    def submit(self, function, compute, compute_batch, items, *rest, **options) -> Ticket:
        self.batches.append([item.spec.trial.identity.index for item in items])
        if len(items) > 1:
            self.batched.add(items[0].stage)
        return self.inner.submit(function, compute, compute_batch, items, *rest, **options)

    def __getattr__(self, name: str):
        return getattr(self.inner, name)


def _batched(root, *overrides: str, stage: AnyStage = EVOLVE, n_cores: float = 1.0):
    """Evolve, and return the results and the batches."""
    with serial_cluster() as inner:
        cluster = Batches(inner, n_cores)
        found = run(tiny(*BATCHED, *overrides), Store.open(root, create=True), cluster, [stage])
    return found, cluster.batches


def test_adaptations_are_batched_too(tmp_path):
    settings, stages = tiny(*BATCHED), (EVOLVE, ADAPT)
    unbatched = [dataclasses.replace(stage, compute_batch=None) for stage in stages]
    with serial_cluster() as inner:
        alone = run(settings, Store.open(tmp_path / "alone", create=True), inner, unbatched)
        cluster = Batches(inner)
        together = run(settings, Store.open(tmp_path / "together", create=True), cluster, stages)
    assert digests(together) == digests(alone)
    assert cluster.batched == {"evolve", "adapt"}


def test_the_items_of_a_batch_share_its_time(tmp_path):
    class OfAHundredSeconds(Batches):
        def submit(self, function, *rest, **options) -> Ticket:
            return super().submit(lambda *given: (function(*given)[0], 100.0), *rest, **options)

    with serial_cluster() as inner:
        cluster = OfAHundredSeconds(inner)
        found = run(tiny(*BATCHED), Store.open(tmp_path / "store", create=True), cluster, [EVOLVE])["evolve"]
    assert len(cluster.batches) < 10 and found.seconds == pytest.approx(100 * len(cluster.batches))


def test_batches_leave_no_core_without_work(tmp_path):
    _, batches = _batched(tmp_path / "two", n_cores=2.0)
    assert batches[:4] == [[0, 1], [2], [3], [4]]  # two items for each core


@pytest.mark.parametrize(
    ("overrides", "n_cores"),
    [
        ([], 3.0),
        (["work.engine=reference"], 1.0),
        (["physics.link_collisions=true"], 1.0),
        (["evolution.afpo.population_size=64"], 1.0),
        (["grid.depths=[1,2,3,4,5]", "grid.n_trials=1"], 1.0),
    ],
)
def test_trials_are_not_batched_where_lanes_are_full_or_missing_or_environments_differ(overrides, n_cores, tmp_path):
    _, batches = _batched(tmp_path, *overrides, "rollout.n_measure=3", n_cores=n_cores)
    assert {len(batch) for batch in batches} == {1}


def _bad(stage: AnyStage, trial: int) -> AnyStage:
    """Return the stage with a computation that fails for one trial."""

    def compute(item: Item, inputs: Inputs) -> Files:
        if item.spec.trial.identity.index == trial:
            raise ArithmeticError("no such luck")
        return stage.compute(item, inputs)

    def compute_batch(items: Sequence[Item], inputs: Sequence[Inputs]) -> Sequence[Files]:
        if trial in [item.spec.trial.identity.index for item in items]:
            raise ArithmeticError("no such luck")
        return stage.compute_batch(items, inputs)

    return dataclasses.replace(stage, compute=compute, compute_batch=compute_batch)


def test_items_of_a_failed_batch_are_retried_one_by_one(tmp_path):
    sound, _ = _batched(tmp_path / "sound")
    found, batches = _batched(tmp_path / "bad", stage=_bad(EVOLVE, 2))
    assert batches[0] == [0, 1, 2, 3]
    assert sum(batch == [2] for batch in batches) == 2  # attempts by itself
    assert all(len(batch) == 1 or 2 not in batch for batch in batches[1:])
    assert any(len(batch) > 1 for batch in batches[1:])  # the others are batched again
    ((trial, failure),) = found["evolve"].failed.items()
    why = failure.reason
    assert trial.label == "dry_land/1m/trial-2" and "2 attempts" in why and "no such luck" in why
    del sound["evolve"].done[trial]
    assert digests(found) == digests(sound)


@pytest.mark.parametrize(("device", "expected"), [("cuda", [3, 3, 1, 1]), ("cpu", [1] * 8)])
def test_networks_of_a_data_set_are_one_batch_on_a_gpu_though_cores_have_no_work(device, expected):
    settings = small(
        f"training.device={device}",
        "ensemble.n_members=3",
        "replicates=2",
        "grid={environments: [true_slush, residual_slush, designed_throws], single_member_depths: []}",
        "learners.designed_throws={n_members: 1}",
    )
    ready = [ChainProgress(chain) for chain in TRAIN.plan(settings)]
    batches = []
    while ready:
        batches.append([progress.chain.identity.data_set for progress in _take_batch(ready, -30)])
        assert len(set(batches[-1])) == 1
    assert [len(batch) for batch in batches] == expected
