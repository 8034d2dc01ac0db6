"""A driver that counts what passes through it, for `python -m benchmarks.cluster_trial`.

    python -m benchmarks.counted_driver COUNTS.json study --preset laptop …       # puddle's own command and options
    python -m benchmarks.counted_driver COUNTS.json sleep HOST:PORT               # items that sleep

Both write JSON. The counts are those of the cluster that the driver calls: its methods are wrapped, and nothing else is
changed.
"""

from __future__ import annotations

import contextlib
import json
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import psutil
import ray

from pipeline.cluster import Cluster, Done, Handle, Ticket, on_ray, ray_cluster
from pipeline.commands import app
from pipeline.config.loading import load, preset_path
from pipeline.config.settings import Settings
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.tracking.mirror import Tracker
from pipeline.tracking.run import CurvePoints
from pipeline.workflow.driver import drive
from pipeline.workflow.identity import InputName, TrialId
from pipeline.workflow.progress import progress
from pipeline.workflow.stage import (
    Chain,
    Files,
    Input,
    Inputs,
    Item,
    Job,
    Results,
    Stage,
    Summary,
    TrialSummary,
    Upstream,
)

N_SLEEPING_TRIALS = 520
"""Chains of items that sleep: as many as the preset desk has trials. A chain has one item in Ray's hands at a time."""
_N_PER_CASE, _SECONDS_PER_CASE = 2000, 30.0  # number of items of a measurement, unless they take this long [s]
_POPULATION_BYTES = 10_000  # the next item's input; the rest is its history
_GENERATIONS = 25  # of a segment, and points of its curve
_LARGE = 100 * 1024  # Ray puts a larger argument into the object store by itself [bytes]


@dataclass
class StageCounts:
    """What passed through the driver in one stage."""

    begun: float  # when the first item was submitted
    ended: float = 0.0  # when the last outcome arrived
    cpu_begun: float = 0.0  # processor time of this process then [s]
    cpu_ended: float = 0.0
    idle: float = 0.0  # time that the driver waited for an outcome [s]
    n_items: int = 0
    n_calls: int = 0  # a batch of items is one call
    worker_seconds: float = 0.0  # sum of the times of calls on their workers
    sent: int = 0  # contents of inputs that went with the calls [bytes]
    returned: int = 0  # contents of results [bytes]


@dataclass
class Counts:
    """What passed through the driver."""

    n_puts: int = 0  # values that the driver put into the object store
    put_bytes: int = 0  # their contents
    n_large_arguments: int = 0  # inputs sent with a call that Ray put into the object store by itself
    stages: dict[str, StageCounts] = field(default_factory=dict)


def n_bytes_in(value: object) -> int:
    """Return the length of all bytes within nested mappings and sequences."""
    if isinstance(value, bytes):
        return len(value)
    if isinstance(value, Mapping):
        return sum(n_bytes_in(inner) for inner in value.values())
    if isinstance(value, list | tuple):
        return sum(n_bytes_in(inner) for inner in value)
    return 0


@contextlib.contextmanager
def counting() -> Iterator[Counts]:
    """Count what passes through this process's Ray clusters while the block runs."""
    counts, ray_class = Counts(), on_ray._Ray
    share, submit, next_done, wait = ray_class.share, ray_class.submit, ray_class.next_done, ray.wait
    waited = 0.0  # since the last outcome [s]

    def counted_share(cluster: Any, value: Any) -> Handle:
        counts.n_puts += 1
        counts.put_bytes += n_bytes_in(value)
        return share(cluster, value)

    def counted_submit(cluster: Any, function: Callable[..., Any], *args: Any, name: str, **options: Any) -> Ticket:
        stage = name.partition(" ")[0]
        if stage not in counts.stages:
            counts.stages[stage] = StageCounts(time.perf_counter(), cpu_begun=time.process_time())
        sizes = [n_bytes_in(argument) for argument in args]
        counts.stages[stage].sent += sum(sizes)
        counts.n_large_arguments += sum(size > _LARGE for size in sizes)
        return submit(cluster, function, *args, name=name, **options)

    def counted_wait(*args: Any, **options: Any) -> Any:
        nonlocal waited
        begun = time.perf_counter() - time.thread_time()
        try:
            return wait(*args, **options)
        finally:
            waited += time.perf_counter() - time.thread_time() - begun

    def counted_next_done(cluster: Any, timeout: float | None = None) -> Any:
        nonlocal waited
        if (found := next_done(cluster, timeout)) is None:
            return None
        ticket, outcome = found
        of_stage = counts.stages[ticket.name.partition(" ")[0]]
        of_stage.idle, waited = of_stage.idle + waited, 0.0
        of_stage.ended, of_stage.cpu_ended = time.perf_counter(), time.process_time()
        if isinstance(outcome, Done):
            results, seconds = outcome.result
            of_stage.n_calls += 1
            of_stage.n_items += len(results)
            of_stage.worker_seconds += seconds
            of_stage.returned += n_bytes_in(results)
        return found

    wrapped = {"share": counted_share, "submit": counted_submit, "next_done": counted_next_done}
    try:
        for name, method in wrapped.items():
            setattr(ray_class, name, method)
        ray.wait = counted_wait
        yield counts
    finally:
        ray_class.share, ray_class.submit, ray_class.next_done, ray.wait = share, submit, next_done, wait


@dataclass(frozen=True)
class Case:
    """A measurement of items that sleep."""

    seconds: float  # that an item sleeps
    n_bytes: int  # that it returns
    n_cores: int | None = None  # that the driver believes in, if not the cluster's


OF_25_GENERATIONS, OF_100_GENERATIONS = 200_000, 800_000  # of 64 designs, as in the presets paper and desk [bytes]
SLEEP_CASES = (
    *(Case(seconds, OF_25_GENERATIONS) for seconds in (4.0, 4.0, 2.0, 1.0, 0.5)),
    Case(0.5, OF_25_GENERATIONS, n_cores=1000),
    Case(1.0, OF_100_GENERATIONS),
)
"""The first one starts the workers, and does not count."""


@dataclass(frozen=True)
class Sleep:
    """The specification of an item that sleeps."""

    case: Case
    trial: int
    index: int


def sleeping_stage(case: Case, n_items: int) -> Stage[Sleep, Sleep]:
    """Return a stage of chains like trials, each of some items that sleep and return random bytes."""

    def plan(_settings: Settings) -> Sequence[Chain[Sleep]]:
        units = (float(_GENERATIONS),) * n_items
        trials = (TrialId("sleep", "true_slush", 1.0, trial) for trial in range(N_SLEEPING_TRIALS))
        return [Chain(trial, units, Sleep(case, trial.index, 0)) for trial in trials]

    def item(
        _settings: Settings, chain: Chain[Sleep], index: int, previous: Manifest | None, _upstream: Upstream
    ) -> Item[Sleep]:
        inputs = {InputName("before"): Input(previous, ("population",))} if previous else {}
        spec = Sleep(case, chain.spec.trial, index)
        return Item("sleep", 1, f"{chain.label}#{index}", spec, inputs)

    return Stage(
        name="sleep",
        version=1,
        unit="generations",
        reads=lambda settings: (),
        plan=plan,
        item=item,
        compute=_sleep,
        summarise=lambda settings, results, store: _summary(results),
        curves=lambda store, manifest: _curve(store.read(manifest, "history")),
        summarise_trial=lambda store, chain, manifests: TrialSummary(chain, {"fitness": 1.0}),
    )


def _sleep(job: Job[Sleep], _inputs: Inputs) -> Files:
    time.sleep(job.spec.case.seconds)
    content = random.Random(job.key).randbytes(job.spec.case.n_bytes)
    return {"population": content[:_POPULATION_BYTES], "history": content[_POPULATION_BYTES:]}


def _summary(results: Results) -> Summary:
    return Summary(lines=[f"{sum(results.n_done.values())} items"])


def _curve(history: bytes) -> CurvePoints:
    return CurvePoints(range(_GENERATIONS), {"best": [float(byte) for byte in history[:_GENERATIONS]]})


def measure_sleep(cluster: Cluster, case: Case) -> dict[str, Any]:
    """Drive items that sleep, and return what an item takes the driver."""
    n_workers = int(cluster.n_cores)
    n_items = max(1, round(min(_N_PER_CASE, _SECONDS_PER_CASE * n_workers / case.seconds) / N_SLEEPING_TRIALS))
    stage = sleeping_stage(case, n_items)
    with tempfile.TemporaryDirectory() as folder, _believed_cores(case.n_cores), counting() as counts:
        store = Store.open(Path(folder) / "store", create=True)
        begun, cpu = time.perf_counter(), time.process_time()
        psutil.cpu_percent()
        with progress() as show:
            drive(
                load(Settings, preset_path("smoke")),
                [stage],
                stages=[stage],
                store=store,
                open_cluster=lambda: contextlib.nullcontext(cluster),
                tracker=Tracker(store.root, say=show.say),
                progress=show,
                how_to_run=str,
            )
        busy = psutil.cpu_percent() / 100
        whole, whole_cpu = time.perf_counter() - begun, time.process_time() - cpu
    found = counts.stages["sleep"]
    wall = found.ended - found.begun
    row = {
        "item_seconds": case.seconds,
        "item_bytes": case.n_bytes,
        "believed_cores": case.n_cores or n_workers,
        "n_items": found.n_items,
        "seconds": round(wall, 2),
        "items_per_second": round(found.n_items / wall, 2),
        "occupancy": round(found.worker_seconds / (n_workers * wall), 4),
        "driver_ms": round(1e3 * (wall - found.idle) / found.n_items, 3),
        "driver_cpu_ms": round(1e3 * (found.cpu_ended - found.cpu_begun) / found.n_items, 3),
        "bytes_per_second": round((found.sent + found.returned) / wall),
        "machine_busy": round(busy, 3),
        "with_mirror_seconds": round(whole, 2),
        "with_mirror_cpu_ms": round(1e3 * whole_cpu / found.n_items, 3),
    }
    print(row, flush=True)
    return row


@contextlib.contextmanager
def _believed_cores(n_cores: int | None) -> Iterator[None]:
    """Make the driver believe in a number of cores, to see what as long a queue costs it."""
    real = on_ray._Ray.n_cores
    try:
        if n_cores is not None:
            on_ray._Ray.n_cores = property(lambda cluster: float(n_cores))
        yield
    finally:
        on_ray._Ray.n_cores = real


def main() -> None:
    """Drive a study, or items that sleep, and write the counts."""
    out, what, *arguments = sys.argv[1:]
    if what == "sleep":
        with ray_cluster(arguments[0]) as cluster:
            _, *rows = [measure_sleep(cluster, case) for case in SLEEP_CASES]
        Path(out).write_text(json.dumps(rows))
        return
    with counting() as counts:
        try:
            app.main([what, *arguments])
        finally:
            Path(out).write_text(json.dumps(asdict(counts)))


if __name__ == "__main__":
    main()
