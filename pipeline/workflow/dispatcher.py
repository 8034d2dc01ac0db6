"""The dispatcher: spreads a stage's missing items over the cluster and commits each result.

Only this process writes to the store; workers return bytes. An item that fails twice is recorded as failed, and the
rest of the study goes on without it.
"""

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pydantic_core import to_jsonable_python

from pipeline.cluster import Cluster, Outcome, TaskFailed, Ticket
from pipeline.errors import PuddleError
from pipeline.store.encoding import Json
from pipeline.workflow.code_digest import recorded_code
from pipeline.workflow.graph import ChainProgress, StageRun
from pipeline.workflow.identity import InputName
from pipeline.workflow.stage import Failure, Files, Input, Inputs, Item, OutsideFile

_N_ATTEMPTS = 2  # attempts at an item by itself before it counts as failed
_QUEUED_PER_CORE = 2  # batches submitted to the cluster per core, so that no core waits for this process
_SECONDS_BETWEEN_CHECKS = 5.0  # how often this process looks for the number of cores


_Batch = list[tuple[ChainProgress, Item[Any]]]  # next items of one or several chains, computed in one call


class Dispatcher:
    """Keeps a cluster busy with a stage's chains, heaviest remaining chain first."""

    def __init__(self, run: StageRun, cluster: Cluster, advance: Callable[[float], object]) -> None:
        """Prepare to compute a stage; ``advance`` counts the cost of work that has just been committed."""
        self._run, self._stage = run, run.stage
        self._cluster, self._advance = cluster, advance
        self._shared: dict[tuple[str, tuple[str, ...]], Any] = {}
        self._running: dict[Ticket, _Batch] = {}
        self._code = recorded_code(run.stage)  # before any worker loads it: files may be edited while it runs

    def run(self, chains: Sequence[ChainProgress]) -> None:
        """Compute what is missing of the stage's chains; raise PuddleError if that needs a GPU and there is none."""
        ready = [progress for progress in chains if progress.open]
        try:
            while ready or self._running:
                queue = max(1, round(_QUEUED_PER_CORE * self._cluster.n_cores))  # machines join and leave
                ready.sort(key=lambda progress: -progress.left)
                while ready and len(self._running) < queue:
                    # Batches must not drain the queue: a core without work is worse than empty lanes.
                    n_to_spare = len(ready) + len(self._running) - queue if self._stage.compute_batch else 0
                    self._submit(_take_batch(ready, n_to_spare))
                if (finished := self._cluster.next_done(timeout=_SECONDS_BETWEEN_CHECKS)) is not None:
                    ready += [progress for progress in self._finish(*finished) if progress.open]
        except BaseException:
            self._cluster.cancel_all()
            raise

    def _submit(self, chains: Sequence[ChainProgress]) -> None:
        items = [self._run.next_item(progress) for progress in chains]
        contents: list[Any] = []
        for item in items:
            contents += [self._contents(source) for source in item.inputs.values()]
        item = items[0]
        if item.execution.n_gpus and not self._cluster.n_gpus:  # Ray would wait for one forever
            raise PuddleError(
                f"{item.stage} of {item.label} is to run on a GPU, and there is none here. Expected one that torch or "
                f"Ray finds; give --address of a cluster that has one, or choose cores (--set training.device=cpu: "
                f"the last bits differ, so the networks differ too)."
            )
        ticket = self._cluster.submit(
            _compute_items,
            self._stage.compute,
            self._stage.compute_batch,
            items,
            [tuple(item.inputs) for item in items],
            *contents,
            n_cores=0.0 if item.execution.designs_per_batch is not None else 1.0,  # a split item only waits
            n_gpus=float(item.execution.n_gpus),
            name=f"{item.stage} {' and '.join(item.label for item in items)}",
        )
        self._running[ticket] = list(zip(chains, items, strict=True))

    def _contents(self, source: Input | OutsideFile) -> Any:
        """Read an input. Other stages' results are used many times, so they are shared once."""
        if isinstance(source, OutsideFile) or source.manifest.stage == self._stage.name:
            return source.read(self._run.store)
        slot = (source.manifest.key, source.files)
        if slot not in self._shared:
            self._shared[slot] = self._cluster.share(source.read(self._run.store))
        return self._shared[slot]

    def _finish(self, ticket: Ticket, outcome: Outcome) -> list[ChainProgress]:
        batch = self._running.pop(ticket)
        if isinstance(outcome, TaskFailed):
            for progress, item in batch:
                self._fail(progress, item, outcome, batched=len(batch) > 1)
        else:
            results, seconds = outcome.result
            for (progress, item), files in zip(batch, results, strict=True):
                self._commit(progress, item, files, seconds / len(batch))
        return [progress for progress, _ in batch]

    def _fail(self, progress: ChainProgress, item: Item[Any], failure: TaskFailed, *, batched: bool) -> None:
        progress.alone = True
        if batched:  # which item is at fault is unknown, so none is blamed
            return
        progress.n_failures += 1
        if progress.n_failures >= _N_ATTEMPTS:
            progress.failed = Failure(f"failed after {_N_ATTEMPTS} attempts at {item.label}: {failure.reason}")
            self._run.say(f"{self._stage.name}: {progress.chain.label} {progress.failed}")

    def _commit(self, progress: ChainProgress, item: Item[Any], files: Files, seconds: float) -> None:
        record: Mapping[str, Json] = {
            "label": item.label,
            "seconds": seconds,
            "execution": to_jsonable_python(item.execution),
            "code": self._code,
        }
        manifest = self._run.store.commit(item.stage, item.identity, files, record=record)
        left = progress.left
        progress.manifests.append(manifest)
        progress.n_failures, progress.alone = 0, False
        # Where an item in the middle was damaged, the items after it stand: they depend on its content.
        self._run.advance(progress)
        self._advance(left - progress.left)


def _take_batch(ready: list[ChainProgress], most_others: int) -> list[ChainProgress]:
    """Take the first chain off a list, and others that batch with it: up to ``most_others``, where they take cores."""
    first = ready.pop(0)
    n_others = first.chain.batch_size - 1
    if not first.chain.one_gpu:
        n_others = max(0, min(n_others, most_others))
    others = [progress for progress in ready if first.batches_with(progress)][:n_others]
    for progress in others:
        ready.remove(progress)
    return [first, *others]


def _compute_items(
    compute: Callable[[Item[Any], Inputs], Files],
    compute_batch: Callable[[Sequence[Item[Any]], Sequence[Inputs]], Sequence[Files]] | None,
    items: Sequence[Item[Any]],
    names: Sequence[tuple[InputName, ...]],
    *contents: Files,
) -> tuple[Sequence[Files], float]:
    """Compute items on a worker, several as one batch; return each item's files, and the seconds that all took.

    ``names`` are those of each item's inputs, ``contents`` those of all inputs in the same order.
    """
    start = time.perf_counter()
    left = iter(contents)
    inputs = [dict(zip(item_names, itertools.islice(left, len(item_names)), strict=True)) for item_names in names]
    if len(items) == 1 or compute_batch is None:
        return [compute(items[0], inputs[0])], time.perf_counter() - start
    return compute_batch(items, inputs), time.perf_counter() - start
