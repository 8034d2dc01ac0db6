"""The dispatcher: one stage's missing pieces, spread over the cluster, each result committed as it comes.

Only this process writes to the store; workers give bytes back. A piece that fails twice is set aside and named, and the
rest of the study goes on without it.
"""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable, Mapping, Sequence

from pipeline.cluster import Cluster, Handle, Outcome, TaskFailed, Ticket
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.store.encoding import Json
from pipeline.store.store import Store
from pipeline.workflow.graph import Walk, go_on, is_batched, next_item
from pipeline.workflow.progress import Bar
from pipeline.workflow.stage import Files, Input, Item, Job, Stage, Upstream

N_ATTEMPTS = 2
"""Times that a piece is tried by itself before it is set aside."""

QUEUED_PER_CORE = 2
"""Parties handed to the cluster at a time, so that no core waits for this process."""

PATIENCE = 20.0
"""Times the slowest piece of its stage, by weighted units, that a piece may take before it is taken to hang. Generous:
machines differ, weights are estimates, and to stop a piece that works costs more than to wait for one that does not."""

LEAST_PATIENCE_SECONDS = 600.0
"""What any piece may take, whatever others took."""

BLIND_PATIENCE = 60.0
"""Seconds a weighted unit that a piece may take while none of its stage is known to have ended. Generous: the longest
piece of all, a training of the paper's network on one core, takes seconds a unit and days in all; this is a month."""

LEAST_BLIND_PATIENCE_SECONDS = 86_400.0
"""What any such piece may take: some units are whole analyses."""

SECONDS_BETWEEN_LOOKS = 5.0
"""How often this process looks for pieces that hang, and at how many cores there are."""

LOOKS_WITHOUT_CORES = 3
"""In a row, after which this process says that the cluster has none."""


def run_stage(
    settings: Settings,
    stage: Stage,
    walks: Sequence[Walk],
    upstream: Upstream,
    *,
    store: Store,
    cluster: Cluster,
    bar: Bar,
    say: Callable[[str], None],
) -> None:
    """Do what is missing of one stage, and move its walks along.

    Args:
        settings: the study's.
        stage: what to do.
        walks: its chains, as :func:`follow` found them.
        upstream: results of the stages before it.
        store: where results are kept.
        cluster: what computes them.
        bar: the stage's progress; it advances by weighted units.
        say: shows a line to the user.
    """
    _Dispatcher(settings, stage, upstream, store, cluster, bar, say).run(walks)


class _Dispatcher:
    """Keeps a cluster busy with a stage's chains, heaviest remaining chain first.

    What is submitted is a party: the pieces of several chains that are quickest side by side, or of one.
    """

    def __init__(
        self,
        settings: Settings,
        stage: Stage,
        upstream: Upstream,
        store: Store,
        cluster: Cluster,
        bar: Bar,
        say: Callable[[str], None],
    ) -> None:
        self._settings, self._stage, self._upstream = settings, stage, upstream
        self._store, self._cluster, self._bar, self._say = store, cluster, bar, say
        self._shared: dict[tuple[str, tuple[str, ...]], Handle] = {}
        self._running: dict[Ticket, list[tuple[Walk, Item]]] = {}
        self._since: dict[Ticket, float] = {}
        """When a party was first seen at work; what waits for a core, behind others' work too, does not hang."""
        self._slowest = 0.0
        """Seconds a weighted unit, of the pieces that ended, now or before; one beside others took what all took."""
        self._looks_without_cores = 0

    def run(self, walks: Sequence[Walk]) -> None:
        self._slowest = max((walk.slowest for walk in walks), default=0.0)
        ready: list[tuple[float, int]] = []

        def make_ready(number: int) -> None:
            if walks[number].open:
                heapq.heappush(ready, (-walks[number].left.cost, number))

        def finish(ticket: Ticket, outcome: Outcome) -> None:
            for walk in self._finish(ticket, outcome):
                make_ready(numbers[id(walk)])

        numbers = {id(walk): number for number, walk in enumerate(walks)}
        for number in range(len(walks)):
            make_ready(number)
        next_look = -float("inf")
        while ready or self._running:
            if time.monotonic() >= next_look:
                n_cores = self._cluster.n_cores  # machines come and go
                self._mind_cores(n_cores)
                for ticket, failed in self._hanging():
                    self._cluster.cancel(ticket)
                    finish(ticket, failed)
                next_look = time.monotonic() + SECONDS_BETWEEN_LOOKS
            queue = max(1, round(QUEUED_PER_CORE * n_cores))
            while ready and len(self._running) < queue:
                # The queue must not run low for company's sake: a core without work is worse than empty lanes.
                n_to_spare = len(ready) + len(self._running) - queue if self._stage.compute_batch else 0
                self._submit([walks[number] for number in _take_party(ready, walks, n_to_spare)])
            finished = self._cluster.next_done(timeout=SECONDS_BETWEEN_LOOKS)
            if finished is not None:
                finish(*finished)

    def _mind_cores(self, n_cores: float) -> None:
        """Say it, once, where the cluster has had no cores for a while: Ray would wait for ever without a word."""
        self._looks_without_cores = 0 if n_cores else self._looks_without_cores + 1
        if self._looks_without_cores == LOOKS_WITHOUT_CORES:
            self._say(
                f"{self._stage.name} waits: expected a cluster with at least one core, came one with none (`ray "
                f"status` lists its nodes; those started with --num-cpus=0 have none). It goes on when a node with "
                f"cores joins."
            )

    def _submit(self, walks: Sequence[Walk]) -> None:
        items = [next_item(self._stage, self._settings, walk, self._upstream) for walk in walks]
        contents = [self._contents(source) for item in items for source in item.inputs.values()]
        item = items[0]
        n_gpus = float(item.execution.get("n_gpus", 0))
        if n_gpus and not self._cluster.n_gpus:  # Ray would wait for one for ever
            raise PuddleError(
                f"{item.stage} of {item.label} is to run on a GPU, and there is none here. Expected one that torch or "
                f"Ray finds; give --address of a cluster that has one, or choose cores (--set training.device=cpu: "
                f"other low bits, so other networks)."
            )
        ticket = self._cluster.submit(
            compute_items,
            self._stage.compute,
            self._stage.compute_batch,
            [item.job for item in items],
            [tuple(item.inputs) for item in items],
            *contents,
            n_cores=0.0 if is_batched(item) else 1.0,
            n_gpus=n_gpus,
            name=f"{item.stage} {' and '.join(item.label for item in items)}",
        )
        self._running[ticket] = list(zip(walks, items, strict=True))

    def _contents(self, source: Input) -> Handle | Files:
        """Read an input; what other stages made is used many times and so is shared once."""
        manifest = source.manifest
        if manifest.stage == self._stage.name:
            return {name: self._store.read(manifest, name) for name in source.files}
        slot = (manifest.key, source.files)
        if slot not in self._shared:
            self._shared[slot] = self._cluster.share({name: self._store.read(manifest, name) for name in source.files})
        return self._shared[slot]

    def _hanging(self) -> list[tuple[Ticket, TaskFailed]]:
        """Find parties that take beyond all measure."""
        now, started = time.monotonic(), self._cluster.started()
        hanging = []
        for ticket, party in self._running.items():
            if ticket in started:
                self._since.setdefault(ticket, now)
            patience, why = self._patience(max(walk.next_work for walk, _ in party))
            if now - self._since.get(ticket, now) > patience:
                reason = f"it did not end within {patience:.0f} s{why}, and was stopped"
                hanging.append((ticket, TaskFailed(ticket.name, reason, "", False)))
        return hanging

    def _patience(self, work: float) -> tuple[float, str]:
        """Say how long so many weighted units may take [s], and why."""
        if not self._slowest:
            why = ", the longest that a piece may take while none of its stage has ended"
            return max(LEAST_BLIND_PATIENCE_SECONDS, BLIND_PATIENCE * work), why
        seconds = self._slowest * work
        why = f", where the slowest piece of its stage took {seconds:.0f} s for as much work"
        return max(LEAST_PATIENCE_SECONDS, PATIENCE * seconds), why

    def _finish(self, ticket: Ticket, outcome: Outcome) -> list[Walk]:
        party = self._running.pop(ticket)
        self._since.pop(ticket, None)
        if isinstance(outcome, TaskFailed):
            for walk, item in party:
                self._fail(walk, item, outcome, in_company=len(party) > 1)
        else:
            results, seconds = outcome.result
            for (walk, item), files in zip(party, results, strict=True):
                self._slowest = max(self._slowest, seconds / walk.next_work)
                self._keep(walk, item, files, seconds / len(party))
        return [walk for walk, _ in party]

    def _fail(self, walk: Walk, item: Item, failed: TaskFailed, *, in_company: bool) -> None:
        walk.alone = True
        if in_company:  # by whose fault is not known, so nothing is counted
            return
        walk.n_failed += 1
        if walk.n_failed >= N_ATTEMPTS:
            walk.failed = f"set aside after {N_ATTEMPTS} attempts at {item.label}: {failed.reason}"
            self._say(f"{self._stage.name}: {walk.chain.label} is {walk.failed}")

    def _keep(self, walk: Walk, item: Item, files: Files, seconds: float) -> None:
        record: Mapping[str, Json] = {"label": item.label, "seconds": seconds, "execution": item.execution}
        manifest = self._store.commit(item.stage, item.key, item.identity, files, record=record)
        left = walk.left
        walk.manifests.append(manifest)
        walk.n_failed, walk.alone = 0, False
        # Where a piece in the middle was damaged, those after it stand: they depend on its content.
        go_on(self._stage, self._settings, walk, self._store, self._upstream, self._say)
        self._bar.advance(left - walk.left)


def _take_party(ready: list[tuple[float, int]], walks: Sequence[Walk], most_others: int) -> list[int]:
    """Take the heaviest chain off the heap, and others whose next pieces are best computed beside its next piece.

    Args:
        ready: a heap of (- work left, number of the walk).
        walks: all of them.
        most_others: how many may be taken beside the heaviest.
    """
    _, number = heapq.heappop(ready)
    first = walks[number]
    most_others = min(first.chain.batch_size - 1, most_others)
    if most_others < 1:
        return [number]
    others = sorted(entry for entry in ready if first.goes_with(walks[entry[1]]))[:most_others]
    ready[:] = [entry for entry in ready if entry not in others]
    heapq.heapify(ready)
    return [number, *(other for _, other in others)]


def compute_items(
    compute: Callable[[Job, Mapping[str, Files]], Files],
    compute_batch: Callable[[Sequence[Job], Sequence[Mapping[str, Files]]], Sequence[Files]] | None,
    jobs: Sequence[Job],
    names: Sequence[tuple[str, ...]],
    *contents: Files,
) -> tuple[Sequence[Files], float]:
    """Compute pieces on a worker, side by side if they are several, and time them.

    Args:
        compute: computes one.
        compute_batch: computes several, which a stage without it never has.
        jobs: what they are.
        names: of the inputs of each.
        contents: of the inputs, of one piece after another.
    """
    start = time.perf_counter()
    left = iter(contents)
    inputs = [dict(zip(of, itertools.islice(left, len(of)), strict=True)) for of in names]
    if len(jobs) == 1 or compute_batch is None:
        return [compute(jobs[0], inputs[0])], time.perf_counter() - start
    return compute_batch(jobs, inputs), time.perf_counter() - start
