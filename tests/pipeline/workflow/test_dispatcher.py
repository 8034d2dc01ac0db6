"""The dispatcher: retries of items that hang or fail, and batches of items that are faster together."""

import dataclasses
from collections.abc import Sequence

import pytest
from small_study import ON_DRY_LAND, digests, run

from pipeline.cluster import Cluster, Handle, Outcome, Ticket, serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages.evolve import EVOLVE
from pipeline.stages.segments import SegmentSpec
from pipeline.stages.transfer import TRANSFER
from pipeline.store.store import Store
from pipeline.workflow import dispatcher
from pipeline.workflow.stage import AnyStage, Files, Inputs, Item


def tiny(*overrides: str) -> Settings:
    two_whole_trials = ("grid.n_trials=2", "work.generations_per_item=4")
    return parse(Settings, ON_DRY_LAND, name="tiny", overrides=(*two_whole_trials, *overrides))


class Stuck:
    """A simulated cluster of one core on which the items of some trials never end; another item takes 100 s."""

    n_cores, n_gpus = 1.0, 0.0

    def __init__(self, inner: Cluster, *stuck: str) -> None:
        self.inner, self.stuck = inner, stuck

    def share(self, value: object) -> Handle:
        return self.inner.share(value)

    def submit(self, function, *arguments, name="", seconds, **options) -> Ticket:
        def work(*given):
            if any(label in name for label in self.stuck):
                raise TimeoutError(f"ended after {seconds:.0f} s")
            return function(*given)[0], 100.0

        return self.inner.submit(work, *arguments, name=name)

    def next_done(self, timeout: float) -> tuple[Ticket, Outcome] | None:
        return self.inner.next_done(timeout)


def _evolve(settings: Settings, store: Store, *stuck: str) -> dict[str, str]:
    """Evolve where some trials hang, and return why each failed."""
    with serial_cluster() as inner:
        failed = run(settings, store, Stuck(inner, *stuck), [EVOLVE])["evolve"].failed
    return {trial.label: failure.reason for trial, failure in failed.items()}


@pytest.mark.parametrize(
    ("before", "now", "limit"),
    [
        ([], [], 2000),  # from the seconds of the other trial
        # Another engine takes a hundredth of the time, and batches take the longer, the fewer cores there are.
        ([], ["work.engine=batch"], 86400),
        ([], ["work.designs_per_batch=2"], 86400),
        (["work.designs_per_batch=2"], ["work.designs_per_batch=2"], 86400),
    ],
)
def test_an_item_that_hangs_is_ended_after_a_limit_from_the_seconds_of_others(before, now, limit, tmp_path):
    store = Store.open(tmp_path / "store", create=True)
    _evolve(tiny(*before), store, "trial-1")
    ((label, why),) = _evolve(tiny(*now), store, "trial-1").items()
    assert label == "dry_land/1m/trial-1" and f"ended after {limit} s" in why


def test_the_limit_of_unknown_items_grows_with_their_work(tmp_path):
    long = tiny("evolution.n_generations=2000", "work.generations_per_item=2000")
    (why, _) = _evolve(long, Store.open(tmp_path / "store", create=True), "trial-").values()
    assert "ended after 120000 s" in why


class Late(Stuck):
    """A cluster whose node with a core joins after some looks; before there are only nodes without."""

    def __init__(self, inner: Cluster, n_looks: int) -> None:
        super().__init__(inner)
        self.n_looks = n_looks

    @property
    def n_cores(self) -> float:
        self.n_looks -= 1
        return float(self.n_looks < 0)

    def next_done(self, timeout: float) -> tuple[Ticket, Outcome] | None:
        return super().next_done(timeout) if self.n_looks < 0 else None


@pytest.mark.parametrize(("n_looks", "n_said"), [(0, 0), (2, 0), (100, 1)])
def test_a_cluster_without_cores_is_reported_once_and_waited_for(n_looks, n_said, tmp_path, monkeypatch):
    monkeypatch.setattr(dispatcher, "_SECONDS_BETWEEN_CHECKS", 0.0)
    store, said = Store.open(tmp_path / "store", create=True), list[str]()
    with serial_cluster() as inner:
        found = run(tiny(), store, Late(inner, n_looks), [EVOLVE], said.append)
    assert not found["evolve"].failed and not found["evolve"].unfinished
    expected = "evolve waits: expected a cluster with at least one core"
    assert [line.startswith(expected) for line in said] == [True] * n_said


BATCHED = ("work.engine=batch", "grid.n_trials=5", "work.generations_per_item=2", "evolution.afpo.population_size=2")
"""Ten items, of which the lanes of any machine hold at least four."""


class Batches:
    """A cluster that reports some number of cores and notes which trials are batched."""

    n_gpus = 0.0

    def __init__(self, inner: Cluster, n_cores: float = 1.0) -> None:
        self.inner, self.n_cores, self.batches = inner, n_cores, list[list[int]]()
        self.batched = set[tuple[str, bool]]()
        """Stages with batches, and whether those were of segments."""

    def submit(self, function, compute, compute_batch, items, *rest, **options) -> Ticket:
        self.batches.append([item.spec.trial.identity.index for item in items])
        if len(items) > 1:
            self.batched.add((items[0].spec.trial.identity.stage, isinstance(items[0].spec, SegmentSpec)))
        return self.inner.submit(function, compute, compute_batch, items, *rest, **options)

    def __getattr__(self, name: str):
        return getattr(self.inner, name)


def _batched(root, *overrides: str, stage: AnyStage = EVOLVE, n_cores: float = 1.0):
    """Evolve, and return the results and the batches."""
    with serial_cluster() as inner:
        cluster = Batches(inner, n_cores)
        found = run(tiny(*BATCHED, *overrides), Store.open(root, create=True), cluster, [stage])
    return found, cluster.batches


def test_adaptations_and_scores_are_batched_too_and_on_ray(tmp_path, local_ray):
    settings, stages = tiny(*BATCHED), (EVOLVE, TRANSFER)
    with serial_cluster() as inner:
        alone = run(settings, Store.open(tmp_path / "alone", create=True), inner, list(map(_unbatched, stages)))
    cluster = Batches(local_ray)
    together = run(settings, Store.open(tmp_path / "together", create=True), cluster, stages)
    assert digests(together) == digests(alone)
    assert cluster.batched == {("evolve", True), ("transfer", True), ("transfer", False)}


def _unbatched(stage: AnyStage) -> AnyStage:
    """Return the stage without batches."""
    return dataclasses.replace(stage, compute_batch=None)


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
    _, batches = _batched(tmp_path, *overrides, "rollout.n_measure=2", n_cores=n_cores)
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
