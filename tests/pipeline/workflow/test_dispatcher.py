"""The dispatcher: what hangs or fails is tried again and set aside, and what is quickest side by side goes so."""

import dataclasses
import itertools
from collections.abc import Sequence

import pytest
from small_study import ON_DRY_LAND, digests, run

import pipeline.workflow.dispatcher
from pipeline.cluster import Cluster, Handle, Outcome, Ticket, serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow.stage import Files, Job, Stage

EVOLVE, TRANSFER = (stage for stage in STAGES if stage.name in ("evolve", "transfer"))


def tiny(*overrides: str) -> Settings:
    two_whole_trials = ("grid.n_trials=2", "work.generations_per_item=4")
    return parse(Settings, ON_DRY_LAND, name="tiny", overrides=(*two_whole_trials, *overrides))


class Stuck:
    """A cluster of one core, on which the pieces of some trials never end; and a clock that knows no other time.

    A piece that ends takes 100 s. Until ``free_at`` [s], the core is somebody else's.
    """

    n_cores, n_gpus = 1.0, 0.0

    def __init__(self, inner: Cluster, *stuck: str, free_at: float = 0.0) -> None:
        self.inner, self.stuck, self.now, self.numbers = inner, stuck, 0.0, itertools.count(-1, -1)
        self.free_at, self.hung = free_at, list[Ticket]()

    def monotonic(self) -> float:
        assert self.now < 1e6, "it waits for ever"
        return self.now

    perf_counter = monotonic

    def share(self, value: object) -> Handle:
        return self.inner.share(value)

    def submit(self, function, *arguments, name="", **options) -> Ticket:
        if any(label in name for label in self.stuck):
            self.hung.append(Ticket(next(self.numbers), name))
            return self.hung[-1]

        def slowly(*given):
            (files, _), begin = function(*given), self.now
            self.now += 100.0
            return files, self.now - begin

        return self.inner.submit(slowly, *arguments, name=name)

    def next_done(self, timeout: float) -> tuple[Ticket, Outcome] | None:
        finished = self.inner.next_done() if self.now >= self.free_at else None
        self.now += timeout if finished is None else 0.0
        return finished

    def started(self) -> set[Ticket]:
        return set(self.hung[:1]) if self.now >= self.free_at else set()

    def cancel(self, ticket: Ticket) -> None:
        assert self.hung.pop(0) is ticket, f"{ticket.name} works, or waits"


def _evolve(settings: Settings, store: Store, monkeypatch, *stuck: str, free_at: float = 0.0) -> dict[str, str]:
    """Evolve where some trials hang, and give why each was set aside."""
    with serial_cluster() as inner:
        cluster = Stuck(inner, *stuck, free_at=free_at)
        monkeypatch.setattr(pipeline.workflow.dispatcher, "time", cluster)
        return dict(run(settings, store, cluster, [EVOLVE])["evolve"].failed)


def test_a_piece_that_hangs_is_set_aside_by_every_driver_that_meets_it(tmp_path, monkeypatch):
    """The second finds the rest done: what it may take follows from what is kept, if it was made in the same way."""
    settings, store = tiny(), Store.open(tmp_path / "store", create=True)
    for _ in range(2):
        ((label, why),) = _evolve(settings, store, monkeypatch, "trial-1").items()
        assert label == "dry_land/1m/trial-1"
        assert "did not end within 2000 s" in why and "slowest piece of its stage took 100 s" in why


@pytest.mark.parametrize(
    ("before", "now"),
    [
        ([], ["work.engine=batch"]),
        ([], ["work.designs_per_batch=2"]),
        (["work.designs_per_batch=2"], ["work.designs_per_batch=2"]),
    ],
)
def test_what_was_made_in_another_way_says_nothing_of_how_long_a_piece_may_take(before, now, tmp_path, monkeypatch):
    """Another engine takes a hundredth of the time, and batches take the longer, the fewer cores there are."""
    store = Store.open(tmp_path / "store", create=True)
    _evolve(tiny(*before), store, monkeypatch, "trial-1")
    (why,) = _evolve(tiny(*now), store, monkeypatch, "trial-1").values()
    assert "did not end within 86400 s" in why and "none of its stage has ended" in why


def test_a_stage_whose_every_piece_hangs_ends(tmp_path, monkeypatch):
    store = Store.open(tmp_path / "store", create=True)
    assert set(_evolve(tiny(), store, monkeypatch, "trial-")) == {"dry_land/1m/trial-0", "dry_land/1m/trial-1"}
    long = tiny("evolution.n_generations=2000", "work.generations_per_item=2000")
    (why, _) = _evolve(long, store, monkeypatch, "trial-").values()
    assert "did not end within 120000 s" in why


def test_what_waits_for_a_core_that_is_somebody_elses_does_not_hang(tmp_path, monkeypatch):
    """Four days, of which another driver has the core for three: only from then on a piece may be too long."""
    store = Store.open(tmp_path / "store", create=True)
    assert not _evolve(tiny(), store, monkeypatch, free_at=3 * 86_400.0)
    other = Store.open(tmp_path / "other", create=True)
    assert list(_evolve(tiny(), other, monkeypatch, "trial-1", free_at=3 * 86_400.0)) == ["dry_land/1m/trial-1"]


class Late(Stuck):
    """A cluster whose node with a core joins when the core is free; before there are only nodes without."""

    @property
    def n_cores(self) -> float:
        return float(self.now >= self.free_at)


@pytest.mark.parametrize(("free_at", "n_said"), [(0.0, 0), (7.0, 0), (3600.0, 1)])
def test_a_cluster_without_cores_is_said_once_and_waited_for(free_at, n_said, tmp_path, monkeypatch):
    store, said = Store.open(tmp_path / "store", create=True), list[str]()
    with serial_cluster() as inner:
        cluster = Late(inner, free_at=free_at)
        monkeypatch.setattr(pipeline.workflow.dispatcher, "time", cluster)
        found = run(tiny(), store, cluster, [EVOLVE], said.append)
    assert not found["evolve"].failed and not found["evolve"].unfinished
    expected = "evolve waits: expected a cluster with at least one core"
    assert [line.startswith(expected) for line in said] == [True] * n_said


ABREAST = ("work.engine=batch", "grid.n_trials=5", "work.generations_per_item=2", "evolution.afpo.population_size=2")
"""Ten pieces, of which the lanes of any machine hold four at once, and more."""


class Parties:
    """A cluster of one core, or of what seems so many, that notes which trials go side by side."""

    n_gpus = 0.0

    def __init__(self, inner: Cluster, n_cores: float = 1.0) -> None:
        self.inner, self.n_cores, self.parties = inner, n_cores, list[list[int]]()
        self.in_company = set[tuple[str, bool]]()
        """Stages, and whether it evolved there."""

    def submit(self, function, compute, compute_batch, jobs, *rest, **options) -> Ticket:
        self.parties.append([job.spec["identity"][-1] for job in jobs])
        if len(jobs) > 1:
            self.in_company.add((jobs[0].spec["identity"][0], "n_generations" in jobs[0].spec))
        return self.inner.submit(function, compute, compute_batch, jobs, *rest, **options)

    def __getattr__(self, name: str):
        return getattr(self.inner, name)


def _abreast(root, *overrides: str, stage: Stage = EVOLVE, n_cores: float = 1.0):
    """Evolve, and give the results and the parties."""
    with serial_cluster() as inner:
        cluster = Parties(inner, n_cores)
        found = run(tiny(*ABREAST, *overrides), Store.open(root, create=True), cluster, [stage])
    return found, cluster.parties


def test_trials_that_fill_the_lanes_together_go_side_by_side_and_are_what_each_is_alone(tmp_path):
    alone, parties = _abreast(tmp_path / "alone", stage=_lonely(EVOLVE))
    assert parties == [[0], [1], [2], [3], [4], [0], [1], [2], [3], [4]]
    together, parties = _abreast(tmp_path / "together")
    assert parties[0] == [0, 1, 2, 3]  # a piece waits behind every core
    assert sorted(trial for party in parties for trial in party) == sorted([0, 1, 2, 3, 4] * 2)
    assert digests(together) == digests(alone)


def test_adaptations_and_scores_go_side_by_side_too_and_on_ray(tmp_path, local_ray):
    settings, stages = tiny(*ABREAST), (EVOLVE, TRANSFER)
    with serial_cluster() as inner:
        alone = run(settings, Store.open(tmp_path / "alone", create=True), inner, list(map(_lonely, stages)))
    cluster = Parties(local_ray)
    together = run(settings, Store.open(tmp_path / "together", create=True), cluster, stages)
    assert digests(together) == digests(alone)
    assert cluster.in_company == {("evolve", True), ("transfer", True), ("transfer", False)}


def test_trials_of_several_worlds_are_refused_side_by_side():
    """Silently they would be kept as what they are not."""
    jobs = [EVOLVE.item(tiny(f"grid.depths=[{depth}]"), *_first_chain(depth), {}).job for depth in (1.0, 2.0)]
    with pytest.raises(ValueError, match="differ in more than their identities"):
        EVOLVE.compute_batch(jobs, [{}, {}])


def _first_chain(depth: float):
    return EVOLVE.plan(tiny(f"grid.depths=[{depth}]"))[0], 0, None


def _lonely(stage: Stage) -> Stage:
    """Make the stage compute everything alone."""
    return dataclasses.replace(stage, compute_batch=None)


def test_no_core_is_left_without_work_for_company(tmp_path):
    _, parties = _abreast(tmp_path / "two", n_cores=2.0)
    assert parties[:4] == [[0, 1], [2], [3], [4]]  # two pieces for each core
    _, parties = _abreast(tmp_path / "three", n_cores=3.0)
    assert {len(party) for party in parties} == {1}


@pytest.mark.parametrize(
    "override",
    [
        "work.engine=reference",
        "physics.link_collisions=true",
        "evolution.afpo.population_size=64",
        "grid.depths=[1,2,3,4,5]",
    ],
)
def test_where_lanes_are_full_or_none_or_worlds_differ_trials_go_alone(override, tmp_path):
    of_each_depth = ["grid.n_trials=1"] if "depths" in override else []
    _, parties = _abreast(tmp_path, override, *of_each_depth, "rollout.n_measure=2")
    assert {len(party) for party in parties} == {1}


def _bad(stage: Stage, trial: int) -> Stage:
    """Make a stage that fails where a certain trial takes part."""

    def compute(job: Job, inputs: dict[str, Files]) -> Files:
        if job.spec["identity"][-1] == trial:
            raise ArithmeticError("no such luck")
        return stage.compute(job, inputs)

    def compute_batch(jobs: Sequence[Job], inputs: Sequence[dict[str, Files]]) -> Sequence[Files]:
        if trial in [job.spec["identity"][-1] for job in jobs]:
            raise ArithmeticError("no such luck")
        return stage.compute_batch(jobs, inputs)

    return dataclasses.replace(stage, compute=compute, compute_batch=compute_batch)


def test_what_fails_beside_others_is_tried_alone_and_they_go_on(tmp_path):
    sound, _ = _abreast(tmp_path / "sound")
    found, parties = _abreast(tmp_path / "bad", stage=_bad(EVOLVE, 2))
    assert parties[0] == [0, 1, 2, 3]
    assert sum(party == [2] for party in parties) == 2  # attempts that were its own
    assert all(len(party) == 1 or 2 not in party for party in parties[1:])
    assert any(len(party) > 1 for party in parties[1:])  # those who were innocent go side by side again
    ((label, why),) = found["evolve"].failed.items()
    assert label == "dry_land/1m/trial-2" and "2 attempts" in why and "no such luck" in why
    del sound["evolve"].done[label]
    assert digests(found) == digests(sound)


def test_what_hangs_beside_others_is_found_alone(tmp_path, monkeypatch):
    store = Store.open(tmp_path / "store", create=True)
    ((label, why),) = _evolve(tiny(*ABREAST), store, monkeypatch, "trial-2").items()
    assert label == "dry_land/1m/trial-2" and "did not end within" in why
