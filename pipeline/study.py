"""A study: the graph of stages under one set of settings, and the middleware that gets it done.

For every stage: find what the store holds, spread the missing pieces over the cluster, commit each result as it comes,
and go on with the chain it belongs to. Only this process writes to the store; workers give bytes back. A piece that
fails twice is set aside and named, and the rest of the study goes on without it.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from pipeline.cluster import Cluster, Handle, Outcome, TaskFailed, Ticket
from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.manifest import Manifest
from pipeline.progress import Bar, Work
from pipeline.settings import Settings
from pipeline.stage import NOT_POSSIBLE, Chain, Files, Input, Item, Job, MissingInputs, Results, Stage, Upstream
from pipeline.store import Store

N_ATTEMPTS = 2
"""Times that a piece is tried before it is set aside."""

QUEUED_PER_CORE = 2
"""Pieces handed to the cluster at a time, so that no core waits for this process."""

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


@dataclass
class Walk:
    """How far a chain has got."""

    chain: Chain
    manifests: list[Manifest] = field(default_factory=list)
    n_failed: int = 0
    """Failures in a row of the piece that is next."""
    set_aside: str | None = None
    """Why the chain can't go on, if it can't."""
    slowest: float = 0.0
    """Seconds a weighted unit, of the pieces that were found kept and tell what one takes now."""

    @property
    def finished(self) -> bool:
        """Whether every piece is done."""
        return len(self.manifests) == self.chain.n_items

    @property
    def open(self) -> bool:
        """Whether there is a piece to do."""
        return not self.finished and self.set_aside is None

    @property
    def next_work(self) -> float:
        """Weighted units of the piece that is next."""
        return self.chain.weight * self.chain.units[len(self.manifests)]

    @property
    def left(self) -> Work:
        """What is still to do."""
        return self._work(self.chain.units[len(self.manifests) :])

    @property
    def done(self) -> Work:
        """What is done."""
        return self._work(self.chain.units[: len(self.manifests)])

    def _work(self, units: Sequence[float]) -> Work:
        return Work(sum(units), self.chain.weight * sum(units))


def _next_item(stage: Stage, settings: Settings, walk: Walk, upstream: Upstream) -> Item:
    previous = walk.manifests[-1] if walk.manifests else None
    return stage.item(settings, walk.chain, len(walk.manifests), previous, upstream)


def follow(
    stage: Stage, settings: Settings, store: Store, upstream: Upstream, *, say: Callable[[str], None]
) -> list[Walk]:
    """Walk every chain of a stage as far as the store holds it.

    A damaged item counts as missing, and ``say`` says so; its successor will take its place.
    """
    walks = []
    for chain in _evenly_weighted(stage.plan(settings)):
        walk = Walk(chain)
        try:
            _go_on(stage, settings, walk, store, upstream, say)
        except MissingInputs as missing:
            walk.set_aside = f"{NOT_POSSIBLE}{missing}"
        walks.append(walk)
    return walks


def _go_on(
    stage: Stage, settings: Settings, walk: Walk, store: Store, upstream: Upstream, say: Callable[[str], None]
) -> None:
    """Walk a chain from where it is as far as the store holds it."""
    while not walk.finished:
        item = _next_item(stage, settings, walk, upstream)
        manifest = _held(store, item, say)
        if manifest is None:
            return
        # Another engine may be a hundred times as fast, and batches share what cores there were: no measure of now.
        if manifest.record.get("how") == item.how and not _is_batched(item):
            walk.slowest = max(walk.slowest, float(manifest.record.get("seconds", 0.0)) / walk.next_work)
        walk.manifests.append(manifest)


def _evenly_weighted(chains: Sequence[Chain]) -> list[Chain]:
    """Scale weights so that they average to one, and weighted units add up to the units that there are."""
    units = [sum(chain.units) for chain in chains]
    weighted = sum(u * chain.weight for u, chain in zip(units, chains, strict=True))
    scale = sum(units) / weighted if weighted > 0 else 1.0
    return [replace(chain, weight=chain.weight * scale) for chain in chains]


def _held(store: Store, item: Item, say: Callable[[str], None]) -> Manifest | None:
    try:
        return store.manifest(item.stage, item.key)
    except DamagedArtifact as damage:
        say(f"{damage}")
        return None


def results_of(stage: Stage, walks: Sequence[Walk]) -> Results:
    """Sum up how far a stage has got."""
    return Results(
        stage=stage.name,
        done={walk.chain.label: tuple(walk.manifests) for walk in walks if walk.finished},
        set_aside={walk.chain.label: walk.set_aside for walk in walks if walk.set_aside is not None},
        unfinished=tuple(walk.chain.label for walk in walks if walk.open),
        n_done={walk.chain.label: len(walk.manifests) for walk in walks},
        seconds=sum(float(m.record.get("seconds", 0.0)) for walk in walks for m in walk.manifests),
    )


def survey(
    settings: Settings, stages: Sequence[Stage], store: Store, *, say: Callable[[str], None]
) -> dict[str, Results]:
    """Find what the store holds of each stage, in order; nothing is computed."""
    upstream: dict[str, Results] = {}
    for stage in stages:
        upstream[stage.name] = results_of(stage, follow(stage, settings, store, upstream, say=say))
    return upstream


def require(
    settings: Settings,
    stage: Stage,
    stages: Sequence[Stage],
    upstream: Upstream,
    *,
    how_to_run: Callable[[str], str],
) -> None:
    """Refuse to start a stage whose inputs are not there, or theirs.

    Where an input's input is missing, the input itself can't be asked for: it counts as not possible, not as missing.

    Args:
        settings: the study's.
        stage: what is to start.
        stages: all of the study, in their order.
        upstream: results of the stages before it.
        how_to_run: gives the command line that runs a stage.

    Raises:
        PuddleError: names the first stage that must come first, what it lacks, and the command that runs it.
    """
    needed = set(stage.reads(settings))
    for earlier in reversed(stages):
        if earlier.name in needed:
            needed.update(earlier.reads(settings))
    for name in (earlier.name for earlier in stages if earlier.name in needed):
        lacking = upstream[name].unfinished
        if lacking:
            raise PuddleError(
                f"{stage.name} needs the results of {name}, and {len(lacking)} of them are missing "
                f"(the first: {lacking[0]}).\n"
                f"Run `{how_to_run(name)}` first, or `{how_to_run('study')}` for everything."
            )


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
    """Keeps a cluster busy with a stage's chains, heaviest remaining chain first."""

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
        self._running: dict[Ticket, tuple[Walk, Item]] = {}
        self._since: dict[Ticket, float] = {}
        """When a piece was first seen at work; what waits for a core, behind others' work too, does not hang."""
        self._slowest = 0.0
        """Seconds a weighted unit, of the pieces that ended, in this process or before."""
        self._looks_without_cores = 0

    def run(self, walks: Sequence[Walk]) -> None:
        self._slowest = max((walk.slowest for walk in walks), default=0.0)
        ready: list[tuple[float, int]] = []

        def make_ready(number: int) -> None:
            if walks[number].open:
                heapq.heappush(ready, (-walks[number].left.cost, number))

        numbers = {id(walk): number for number, walk in enumerate(walks)}
        for number in range(len(walks)):
            make_ready(number)
        next_look = -float("inf")
        while ready or self._running:
            if time.monotonic() >= next_look:
                n_cores = self._cluster.n_cores  # machines come and go
                self._mind_cores(n_cores)
                for ticket, failed in self._hanging():
                    self._cluster.give_up(ticket)
                    make_ready(numbers[id(self._finish(ticket, failed))])
                next_look = time.monotonic() + SECONDS_BETWEEN_LOOKS
            while ready and len(self._running) < max(1, round(QUEUED_PER_CORE * n_cores)):
                self._submit(walks[heapq.heappop(ready)[1]])
            finished = self._cluster.next_done(timeout=SECONDS_BETWEEN_LOOKS)
            if finished is not None:
                make_ready(numbers[id(self._finish(*finished))])

    def _mind_cores(self, n_cores: float) -> None:
        """Say it, once, where the cluster has had no cores for a while: Ray would wait for ever without a word."""
        self._looks_without_cores = 0 if n_cores else self._looks_without_cores + 1
        if self._looks_without_cores == LOOKS_WITHOUT_CORES:
            self._say(
                f"{self._stage.name} waits: expected a cluster with at least one core, came one with none (`ray "
                f"status` lists its nodes; those started with --num-cpus=0 have none). It goes on when a node with "
                f"cores joins."
            )

    def _submit(self, walk: Walk) -> None:
        item = _next_item(self._stage, self._settings, walk, self._upstream)
        contents = [self._contents(source) for source in item.inputs.values()]
        n_gpus = float(item.how.get("n_gpus", 0))
        if n_gpus and not self._cluster.n_gpus:  # Ray would wait for one for ever
            raise PuddleError(
                f"{item.stage} of {item.label} is to run on a GPU, and there is none here. Expected one that torch or "
                f"Ray finds; give --address of a cluster that has one, or choose cores (--set training.device=cpu: "
                f"other low bits, so other networks)."
            )
        ticket = self._cluster.submit(
            compute_item,
            self._stage.compute,
            item.job,
            tuple(item.inputs),
            *contents,
            n_cores=0.0 if _is_batched(item) else 1.0,
            n_gpus=n_gpus,
            name=f"{item.stage} {item.label}",
        )
        self._running[ticket] = (walk, item)

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
        """Find pieces that take beyond all measure."""
        now, begun = time.monotonic(), self._cluster.begun()
        hanging = []
        for ticket, (walk, _) in self._running.items():
            if ticket in begun:
                self._since.setdefault(ticket, now)
            patience, why = self._patience(walk.next_work)
            if now - self._since.get(ticket, now) > patience:
                reason = f"it did not end within {patience:.0f} s{why}, and was stopped"
                hanging.append((ticket, TaskFailed(ticket.name, reason, "", False)))
        return hanging

    def _patience(self, work: float) -> tuple[float, str]:
        """Say how long a piece of so many weighted units may take [s], and why."""
        if not self._slowest:
            why = ", the longest that a piece may take while none of its stage has ended"
            return max(LEAST_BLIND_PATIENCE_SECONDS, BLIND_PATIENCE * work), why
        seconds = self._slowest * work
        why = f", where the slowest piece of its stage took {seconds:.0f} s for as much work"
        return max(LEAST_PATIENCE_SECONDS, PATIENCE * seconds), why

    def _finish(self, ticket: Ticket, outcome: Outcome) -> Walk:
        walk, item = self._running.pop(ticket)
        self._since.pop(ticket, None)
        if isinstance(outcome, TaskFailed):
            walk.n_failed += 1
            if walk.n_failed >= N_ATTEMPTS:
                walk.set_aside = f"set aside after {N_ATTEMPTS} attempts at {item.label}: {outcome.reason}"
                self._say(f"{self._stage.name}: {walk.chain.label} is {walk.set_aside}")
            return walk
        files, seconds = outcome.result
        record = {"label": item.label, "seconds": seconds, "how": item.how}
        manifest = self._store.commit(item.stage, item.key, item.identity, files, record=record)
        self._slowest = max(self._slowest, seconds / walk.next_work)
        left = walk.left
        walk.manifests.append(manifest)
        walk.n_failed = 0
        # Where a piece in the middle was damaged, those after it stand: they depend on its content.
        _go_on(self._stage, self._settings, walk, self._store, self._upstream, self._say)
        self._bar.advance(left - walk.left)
        return walk


def _is_batched(item: Item) -> bool:
    """Tell whether a piece only hands batches to other workers: it needs no core of its own."""
    return item.how.get("designs_per_batch") is not None


def compute_item(
    compute: Callable[[Job, Mapping[str, Files]], Files], job: Job, names: tuple[str, ...], *contents: Files
) -> tuple[Files, float]:
    """Compute a piece on a worker, and time it."""
    start = time.perf_counter()
    files = compute(job, dict(zip(names, contents, strict=True)))
    return files, time.perf_counter() - start
