"""Checks of a machine before a long study: they find in seconds what would stop the study after hours."""

import contextlib
import importlib.metadata
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np
import psutil

from pipeline.cluster import TaskFailed, ray_cluster
from pipeline.cluster.process import number_of_cores
from pipeline.commands.time_model import forecast_stages
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.store import Store

_CONSTRAINTS = Path(str(files("pipeline") / "constraints.txt"))  # package versions that were tested together

_BYTES_PER_WORKER = 450e6
"""Memory of a worker: 300 MB with torch and the engine loaded (measured), and space to work in."""
_BYTES_OF_DRIVER = 1e9  # memory of the driver and of Ray's own processes
_SPARE_BYTES = 1e9  # disk space beside the results: MLflow's database, reports, other users
_RAY_SECONDS = 60.0  # time that Ray's first worker may take to answer

Verdict = Literal["ok", "warn", "fail"]
_Found = tuple[Verdict, str, str]  # what was found, and advice where it is not ok


@dataclass(frozen=True)
class Check:
    """The result of one check."""

    verdict: Verdict
    what: str
    found: str
    advice: str = ""


def examine(settings: Settings, store: Path, *, n_workers: int | None) -> Iterator[Check]:
    """Check this machine, and yield each result as soon as it is known; quick checks come first.

    Args:
        settings: the study that the machine is to run.
        store: the folder for results; it need not exist.
        n_workers: cores to use; None for all, 0 for this process alone.
    """
    n_workers = number_of_cores() if n_workers is None else n_workers
    checks: Mapping[str, Callable[[], _Found]] = {
        "versions": _versions,
        "processor": partial(_processor, n_workers),
        "memory": partial(_memory, n_workers),
        "disk": partial(_disk, settings, store),
        "engine": partial(_engine, settings),
        **({"ray": _ray} if n_workers else {}),
    }
    for what, check in checks.items():
        try:
            verdict, found, advice = check()
        except (PuddleError, OSError) as error:
            verdict, found, advice = "fail", f"{error}", ""
        yield Check(verdict, what, found, advice)


def _versions() -> _Found:
    wanted = dict(re.findall(r"^([\w.-]+)==([\w.!-]+)", _CONSTRAINTS.read_text(), flags=re.M))
    other = []
    for name, version in wanted.items():
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):  # of an extra
            found = importlib.metadata.version(name).partition("+")[0]
            other += [f"{name} {found} (tested: {version})"] if found != version else []
    if other:
        named = ", ".join(other[:5]) + (f" and {len(other) - 5} more" if len(other) > 5 else "")
        advice = "Untested versions may change results in their last bits. make clean setup installs the tested ones."
        return "warn", named, advice
    return "ok", f"{len(wanted)} packages as in {_CONSTRAINTS.name}", ""


def _processor(n_workers: int) -> _Found:
    from llvmlite.binding import get_host_cpu_features  # installed with numba

    from tasks.simulation.simd.lanes import widest

    features, n_cores = get_host_cpu_features(), number_of_cores()
    found = f"{n_cores} cores, {widest()} SIMD lanes; load {os.getloadavg()[0]:.1f}"
    if n_workers > n_cores:
        return "warn", found, f"{n_workers} workers share {n_cores} cores: use --workers {n_cores}."
    if not (features.get("avx2") and features.get("fma")):
        advice = "Without AVX2 and FMA the last bits may differ from those of other machines: use one kind for a study."
        return "warn", found, advice
    return "ok", found, ""


def _memory(n_workers: int) -> _Found:
    free, needed = psutil.virtual_memory().available, _BYTES_OF_DRIVER + n_workers * _BYTES_PER_WORKER
    found = f"{free / 1e9:.1f} GB free, {needed / 1e9:.1f} GB needed by {n_workers} workers and the driver"
    if free >= needed:
        return "ok", found, ""
    fitting = max(0, int((free - _BYTES_OF_DRIVER) / _BYTES_PER_WORKER))
    return "fail", found, f"Free some memory, or use fewer workers: --workers {fitting}."


def _disk(settings: Settings, store: Path) -> _Found:
    """Compare the space that is free with what the rest of the study needs."""
    root = disk.resolved(store)
    with disk.explained("looking for the store's disk", root, advice="ask again"):
        folder = next(path for path in (root, *root.parents) if path.exists())
    opened = Store.open(folder, create=False) if (folder / "store.json").exists() else None
    left = sum(stage.n_bytes for stage in forecast_stages(settings, opened))
    needed, free = _SPARE_BYTES + left if left else 0.0, shutil.disk_usage(folder).free
    needs = f"at most {needed / 1e9:.1f} GB needed for the rest of study {settings.name}"
    found = f"{free / 1e9:.1f} GB free at {folder}, {needs if left else f'study {settings.name} is done'}"
    if not os.access(folder, os.W_OK):
        return "fail", f"no permission to write to {folder}", "Put the store elsewhere: --store."
    if free < needed:
        return "fail", found, "Free some space (`puddle gc`), or put the store elsewhere: --store."
    return "ok", found, ""


def _engine(settings: Settings) -> _Found:
    """Simulate a robot, which compiles kernels that are not cached."""
    from tasks.design import random_designs
    from tasks.simulation import simulate
    from tasks.world import DryLand

    start, design = time.perf_counter(), random_designs(1, np.random.default_rng(0))
    engine, physics = settings.work.engine, settings.physics
    try:
        moved = simulate(design, DryLand(depth=1.0), n_settle=0, n_measure=10, engine=engine, physics=physics)
    except Exception as error:  # a study would fail in the same way
        return "fail", f"{type(error).__name__}: {error}", "make clean setup; then please report it."
    if not np.isfinite(moved.displacement).all():
        return "fail", "the displacement of a robot on dry land is not finite", "Please report it."
    return "ok", f"the first rollout took {time.perf_counter() - start:.1f} s", ""


def _ray() -> _Found:
    start = time.perf_counter()
    with ray_cluster(n_workers=1) as cluster:
        cluster.submit(os.getpid)
        done = cluster.next_done(timeout=_RAY_SECONDS)
    if done is None or isinstance(done[1], TaskFailed):
        found = f"no answer from a worker after {_RAY_SECONDS:.0f} s" if done is None else f"{done[1]}"
        return "fail", found, "Other programs may keep this machine busy; --workers 0 runs without Ray."
    return "ok", f"a cluster with one worker started in {time.perf_counter() - start:.1f} s", ""
