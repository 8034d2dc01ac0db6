"""A study on Ray's test cluster, and what limits its driver: `python -m benchmarks.cluster_trial [study] [driver]`.

Writes docs/results/cluster-trial.json, which docs/cluster.md shows. The nodes of Ray's test cluster are processes of
this machine, so no network is measured: their traffic goes over the loopback.

study: the preset laptop at two depths on four nodes of two workers, and on this machine alone with as many workers as
it has cores. driver: items that sleep, on eight nodes of eight workers. Together they take a quarter of an hour on two
cores, which must be free, and 16 GB of memory.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
from ray.cluster_utils import Cluster as RayTestCluster

from benchmarks.published import RESULTS
from pipeline.cluster.process import PINNED_THREADS
from pipeline.store.provenance import environment as provenance
from pipeline.store.store import Store

TRIAL_FILE = RESULTS / "cluster-trial.json"
STUDY = ("--preset", "laptop", "--set", "grid.depths=[2,9]", "--set", "name=trial")
QUICK = ("--set", "evolution.n_generations=2", "--set", "transfer.n_generations=2", "--set", "training.n_iterations=10")
"""A study that compiles the kernels of the other one before it is timed."""
N_NODES, WORKERS_PER_NODE = 4, 2
N_SLEEPING_NODES, SLEEPERS_PER_NODE = 8, 8
_OBJECT_STORE_BYTES = 2**28  # of a node
_SECONDS_BETWEEN_SAMPLES = 0.5
_SECONDS_IDLE = 20.0
_MOST_SECONDS = 1500  # of one driver

_ENVIRONMENT = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")} | PINNED_THREADS


@dataclass
class Usage:
    """What processes below this one used while a block ran."""

    seconds: float = 0.0
    loopback_bytes: int = 0
    cpu_seconds: dict[str, float] = field(default_factory=dict)  # by part: driver, workers, ray


@contextlib.contextmanager
def used() -> Iterator[Usage]:
    """Sample the processor time of this process's descendants while the block runs."""
    usage, over = Usage(), threading.Event()
    begun, bytes_before = time.perf_counter(), _loopback_bytes()
    before = dict(_processor_times())
    latest = dict(before)

    def sample() -> None:
        while not over.wait(_SECONDS_BETWEEN_SAMPLES):
            latest.update(_processor_times())

    sampler = threading.Thread(target=sample, daemon=True)
    sampler.start()
    try:
        yield usage
    finally:
        over.set()
        sampler.join()
        latest.update(_processor_times())
        usage.seconds = time.perf_counter() - begun
        usage.loopback_bytes = _loopback_bytes() - bytes_before
        for process, (part, seconds) in latest.items():
            of_before = before.get(process, ("", 0.0))[1]
            usage.cpu_seconds[part] = usage.cpu_seconds.get(part, 0.0) + seconds - of_before


def _processor_times() -> Iterator[tuple[tuple[int, float], tuple[str, float]]]:
    """Yield the processor time of each descendant [s] and its part, by process number and time of its start."""
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if words := process.cmdline():  # not a process that has just ended
                times = process.cpu_times()
                yield (process.pid, process.create_time()), (_part(words), times.user + times.system)


def _part(words: Sequence[str]) -> str:
    line = " ".join(words)
    if "benchmarks.counted_driver" in line:
        return "driver"
    return "workers" if line.startswith("ray::") or "default_worker.py" in line else "ray"


def _loopback_bytes() -> int:
    return int(psutil.net_io_counters(pernic=True)["lo"].bytes_recv)


@contextlib.contextmanager
def nodes_of_ray(n_nodes: int, workers_per_node: int) -> Iterator[str]:
    """Start a head without workers, and nodes; yield the address.

    Args:
        n_nodes: number of nodes beside the head.
        workers_per_node: workers of each.
    """
    common = {"object_store_memory": _OBJECT_STORE_BYTES, "include_dashboard": False}
    cluster = RayTestCluster(initialize_head=True, head_node_args={"num_cpus": 0, **common})
    try:
        for _ in range(n_nodes):
            cluster.add_node(num_cpus=workers_per_node, **common)
        yield cluster.address
    finally:
        cluster.shutdown()


def drive(*arguments: str) -> Any:
    """Run a counted driver to its end and return its counts."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "counts.json"
        command = [sys.executable, "-m", "benchmarks.counted_driver", str(out), *arguments]
        subprocess.run(command, check=True, env=_ENVIRONMENT, timeout=_MOST_SECONDS)
        return json.loads(out.read_text())


def measured_study(where: str, store: Path, n_workers: int, *options: str) -> dict[str, Any]:
    """Run the study in a new store; return what it took, with the digests of its items.

    Args:
        where: what it runs on, in words.
        store: the store.
        n_workers: number of workers.
        options: where `puddle study` runs it.
    """
    with used() as usage:
        counts = drive("study", *STUDY, "--store", str(store), *options)
    stages = counts.pop("stages")
    computing = sum(stage["ended"] - stage["begun"] for stage in stages.values())
    worked, sent, returned, n_items = (
        sum(stage[name] for stage in stages.values()) for name in ("worker_seconds", "sent", "returned", "n_items")
    )
    n_cores = os.cpu_count() or 1
    return {
        "where": where,
        "n_workers": n_workers,
        "seconds": round(usage.seconds, 1),
        "computing_seconds": round(computing, 1),  # without starts, summaries and MLflow's end
        "n_items": n_items,
        "items_per_second": round(n_items / computing, 2),
        "worker_seconds": round(worked, 1),
        "occupancy": round(worked / (n_workers * computing), 4),
        "cpu_seconds": {part: round(seconds, 1) for part, seconds in sorted(usage.cpu_seconds.items())},
        "core_share": {
            part: round(seconds / (n_cores * usage.seconds), 4) for part, seconds in sorted(usage.cpu_seconds.items())
        },
        "driver_cpu_ms": round(1e3 * sum(s["cpu_ended"] - s["cpu_begun"] for s in stages.values()) / n_items, 2),
        **counts,
        "sent_bytes": sent,
        "returned_bytes": returned,
        "bytes_per_second": round((counts["put_bytes"] + sent + returned) / computing),
        "loopback_bytes": usage.loopback_bytes,
        "stages": {
            name: {
                "n_items": stage["n_items"],
                "seconds": round(stage["ended"] - stage["begun"], 2),
                "occupancy": round(stage["worker_seconds"] / (n_workers * (stage["ended"] - stage["begun"])), 4),
            }
            for name, stage in stages.items()
        },
        "digests": digests(store),
    }


def digests(root: Path) -> dict[str, str]:
    """Return the digest of every item of a store, by stage and key."""
    store = Store.open(root, create=False)
    found = {}
    for stage in store.stages():
        for key in store.keys(stage):
            manifest = store.manifest(stage, key)
            assert manifest is not None
            found[f"{stage}/{key}"] = manifest.digest
    return found


def study() -> dict[str, Any]:
    """Run the study on both, and compare the results."""
    alone = ("--workers", str(os.cpu_count() or 1))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        drive("study", *STUDY, *QUICK, "--store", str(root / "quick"), *alone)
        rows.append(measured_study("this machine", root / "alone", int(alone[1]), *alone))
        with nodes_of_ray(N_NODES, WORKERS_PER_NODE) as address:
            before = _loopback_bytes()
            time.sleep(_SECONDS_IDLE)
            idle = (_loopback_bytes() - before) / _SECONDS_IDLE
            where = f"{N_NODES} nodes of {WORKERS_PER_NODE} workers"
            n_workers = N_NODES * WORKERS_PER_NODE
            rows.append(measured_study(where, root / "cluster", n_workers, "--address", address))
            rows[-1]["idle_bytes_per_second"] = round(idle)
    ours, theirs = (row.pop("digests") for row in rows)
    n_equal = sum(ours[item] == theirs.get(item) for item in ours)
    return {
        "made_with": dict(provenance()),
        "n_cores": os.cpu_count(),
        "options": " ".join(STUDY),
        "n_digests": len({*ours, *theirs}),
        "n_equal": n_equal,
        "rows": rows,
    }


def driver() -> dict[str, Any]:
    """Measure how many items a second the driver can handle."""
    with nodes_of_ray(N_SLEEPING_NODES, SLEEPERS_PER_NODE) as address:
        rows = drive("sleep", address)
    return {"made_with": dict(provenance()), "n_workers": N_SLEEPING_NODES * SLEEPERS_PER_NODE, "rows": rows}


MEASUREMENTS = {"study": study, "driver": driver}


def main() -> None:
    """Measure what the command line names, or everything, and write the results."""
    parts: dict[str, Any] = json.loads(TRIAL_FILE.read_text(encoding="utf-8"))["parts"] if TRIAL_FILE.exists() else {}
    for name in sys.argv[1:] or MEASUREMENTS:
        parts[name] = MEASUREMENTS[name]()
        document = {"schema": "puddle.cluster_trial", "version": 1, "parts": parts}
        TRIAL_FILE.write_text(f"{json.dumps(document, indent=1, ensure_ascii=False)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
