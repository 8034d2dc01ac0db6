"""Checks of a machine before a long study: they find in seconds what would stop the study after hours."""

import importlib.metadata
import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np
import psutil
from packaging.requirements import Requirement

from pipeline.cluster import Cluster, TaskFailed, ray_cluster, session
from pipeline.cluster.on_ray import OBJECT_STORE_BYTES
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


@dataclass(frozen=True)
class Check:
    """The result of one check."""

    verdict: Literal["ok", "warn", "fail"]
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
    yield _versions()
    yield _processor(n_workers)
    yield _memory(n_workers, psutil.virtual_memory().available)
    yield from examine_store(store, settings)
    yield _engine(settings)
    if n_workers:
        yield _temporary()
        yield _ray()


def _versions() -> Check:
    wanted = dict(re.findall(r"^([\w.-]+)==([\w.+!-]+)", _CONSTRAINTS.read_text(), flags=re.M))
    required = [Requirement(line) for line in importlib.metadata.requires("puddle") or ()]
    needed = {one.name.lower() for one in required if one.marker is None or one.marker.evaluate({"extra": ""})}
    missing, other = [], []
    for name, version in wanted.items():
        try:
            found = importlib.metadata.version(name).partition("+")[0]
        except importlib.metadata.PackageNotFoundError:
            missing += [name] if name.lower() in needed else []
        else:
            other += [f"{name} {found} (tested: {version})"] if found != version.partition("+")[0] else []
    if missing:
        return Check("fail", "versions", f"{', '.join(missing)} are not installed", "make setup installs them.")
    if other:
        named = ", ".join(other[:5]) + (f" and {len(other) - 5} more" if len(other) > 5 else "")
        advice = "Untested versions may change results in their last bits. make clean setup installs the tested ones."
        return Check("warn", "versions", named, advice)
    return Check("ok", "versions", f"{len(wanted)} packages as in {_CONSTRAINTS.name}")


def _processor(n_workers: int) -> Check:
    from llvmlite.binding import get_host_cpu_features  # installed with numba

    from tasks.simulation.simd.lanes import widest

    features, n_cores = get_host_cpu_features(), number_of_cores()
    found = f"{n_cores} cores, {widest()} SIMD lanes; load {os.getloadavg()[0]:.1f}"
    if n_workers > n_cores:
        return Check("warn", "processor", found, f"{n_workers} workers share {n_cores} cores: use --workers {n_cores}.")
    if not (features.get("avx2") and features.get("fma")):
        advice = "Without AVX2 and FMA the last bits may differ from those of other machines: use one kind for a study."
        return Check("warn", "processor", found, advice)
    return Check("ok", "processor", found)


def _memory(n_workers: int, free: float) -> Check:
    needed = _BYTES_OF_DRIVER + n_workers * _BYTES_PER_WORKER
    found = f"{free / 1e9:.1f} GB free, {needed / 1e9:.1f} GB needed by {n_workers} workers and the driver"
    if free < needed:
        fitting = max(0, int((free - _BYTES_OF_DRIVER) / _BYTES_PER_WORKER))
        return Check("fail", "memory", found, f"Free some memory, or use fewer workers: --workers {fitting}.")
    return Check("ok", "memory", found)


def _free_bytes(folder: Path) -> float:
    return float(shutil.disk_usage(folder).free)


def examine_store(
    root: Path, settings: Settings, *, free_bytes: Callable[[Path], float] = _free_bytes
) -> Iterator[Check]:
    """Check the store's disk: space for the rest of the study, and every operation of a commit.

    Args:
        root: folder of the store, which need not exist.
        settings: the study.
        free_bytes: returns the space that is free for an existing folder.

    Returns:
        Checks, the quick ones first.
    """
    try:
        root = disk.resolved(root)
        with disk.explained("looking for the store's disk", root, advice="ask again"):
            existing = next(path for path in (root, *root.parents) if path.exists())
            free = free_bytes(existing)
            store = Store.open(root, create=False) if (root / "store.json").exists() else None
        left = sum(stage.n_bytes for stage in forecast_stages(settings, store))
        driven = {name: store.driver_of(name) for name in store.studies()} if store else {}
        drivers = [f"study {name} is driven by {who}" for name, who in driven.items() if who]
    except PuddleError as error:
        yield Check("fail", "store", f"{error}")
        return
    needed = _SPARE_BYTES + left if left else 0.0
    needs = f"at most {needed / 1e9:.1f} GB needed for the rest of study {settings.name}"
    found = f"{free / 1e9:.1f} GB free at {existing}, {needs if left else f'study {settings.name} is done'}"
    if free < needed:
        yield Check("fail", "disk", found, "Free some space (`puddle gc`), or put the store elsewhere: --store.")
    else:
        yield Check("ok", "disk", found)
    try:
        seconds = _try_commit(existing)
    except (OSError, PuddleError) as error:
        advice = "The store needs a disk with working file locks, and permission to write: --store."
        yield Check("fail", "store", f"{existing}: a file can't be committed there: {error}", advice)
        return
    what = "there is no store yet" if store is None else ""
    found = "; ".join(filter(None, [f"{root}: a commit takes {1e3 * seconds:.0f} ms", what, *drivers]))
    yield Check("warn" if drivers else "ok", "store", found)


def _try_commit(folder: Path) -> float:
    """Do what a commit does, in a temporary folder; return the time that it took [s]."""
    with tempfile.TemporaryDirectory(prefix=".puddle-doctor-", dir=folder) as trial:
        with disk.locked(Path(trial) / "lock"):
            if disk.try_lock(Path(trial) / "lock") is not None:
                raise OSError("file locks do not work")
            start = time.perf_counter()
            disk.place(Path(trial) / "file", b"x" * 100_000)
        return time.perf_counter() - start


def _engine(settings: Settings) -> Check:
    """Evolve two robots for one generation, which compiles kernels that are not cached."""
    from tasks.evolution import EMPTY_POPULATION, Afpo, ask, evaluate, tell
    from tasks.simulation import simulate
    from tasks.world import DryLand

    start, rng, afpo = time.perf_counter(), np.random.default_rng(0), Afpo(population_size=2)
    try:
        children = ask(EMPTY_POPULATION, rng, afpo)
        engine, physics = settings.work.engine, settings.physics
        rollouts = simulate(
            children.designs, DryLand(depth=1.0), n_settle=0, n_measure=10, engine=engine, physics=physics
        )
        tell(EMPTY_POPULATION, children, evaluate(rollouts, disagreement_penalty=0.0).fitness, rng, afpo)
    except Exception as error:  # a study would fail in the same way
        return Check("fail", "engine", f"{type(error).__name__}: {error}", "make clean setup; then please report it.")
    seconds = time.perf_counter() - start
    if not np.isfinite(rollouts.displacement).all():
        return Check("fail", "engine", "the displacement of a robot on dry land is not finite", "Please report it.")
    return Check("ok", "engine", f"the first generation took {seconds:.1f} s")


def _temporary() -> Check:
    """Check where Ray keeps files, and objects in memory."""
    folder, memory = session.SESSIONS_FOLDER, Path("/dev/shm")
    free, in_memory = _free_bytes(folder), _free_bytes(memory) if memory.is_dir() else np.inf
    found = f"{free / 1e9:.1f} GB free in {folder}, {in_memory / 1e9:.1f} GB in {memory}"
    if free < 1e9 or not os.access(folder, os.W_OK):
        return Check("fail", "temporary files", found, f"Ray needs to write 1 GB to {folder}.")
    if in_memory < OBJECT_STORE_BYTES:
        advice = f"Ray will use {folder}, which is slower. In Docker: --shm-size=1g."
        return Check("warn", "temporary files", found, advice)
    return Check("ok", "temporary files", found)


def _ray(on_ray: Callable[..., AbstractContextManager[Cluster]] = ray_cluster) -> Check:
    start = time.perf_counter()
    try:
        with on_ray(n_workers=1) as cluster:
            cluster.submit(os.getpid)
            done = cluster.next_done(timeout=_RAY_SECONDS)
            seconds = time.perf_counter() - start
    except PuddleError as error:
        return Check("fail", "ray", f"{error}")
    if done is None or isinstance(done[1], TaskFailed):
        found = f"no answer from a worker after {_RAY_SECONDS:.0f} s" if done is None else f"{done[1]}"
        return Check("fail", "ray", found, "Other programs may keep this machine busy; --workers 0 runs without Ray.")
    return Check("ok", "ray", f"a cluster with one worker started in {seconds:.1f} s")
