"""Checks of a machine before a long study: they find in seconds what would stop the study after hours."""

import contextlib
import importlib.metadata
import os
import platform
import re
import resource
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np
from packaging.requirements import Requirement

from pipeline.cluster import Cluster, TaskFailed, ray_cluster, session
from pipeline.cluster.on_ray import OBJECT_STORE_BYTES
from pipeline.cluster.process import free_memory, number_of_cores
from pipeline.commands.time_model import forecast_stages
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.store import disk
from pipeline.store.store import Store

_CONSTRAINTS = Path(str(files("pipeline") / "constraints.txt"))  # package versions that were tested together

_BYTES_PER_WORKER = 450e6
"""Memory of a worker: 300 MB with torch and the engine loaded (measured), and space to work in."""
_BYTES_OF_DRIVER = 1e9  # memory of the driver and of Ray's own processes
_ADDRESS_SPACE = 16 * 2**30  # least limit of a process's address space [bytes]; with 4e9, films can't be made
_SPARE_BYTES = 1e9  # disk space beside the results: MLflow's database, reports, other users
_OPEN_FILES = 4096  # file descriptors that Ray needs with dozens of workers
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
    n_cores = number_of_cores()
    n_workers = n_cores if n_workers is None else n_workers
    yield _python()
    yield _versions()
    yield _processor(n_cores, n_workers)
    yield _memory(n_workers, free_memory())
    yield from examine_store(store, settings)
    yield _temporary()
    yield _shared_memory()
    yield _open_files()
    yield _loopback()
    yield _kernels()
    yield _engine(settings)
    if n_workers:
        yield _ray()


def _python() -> Check:
    version = platform.python_version()
    if not (3, 11) <= sys.version_info[:2] < (3, 14):
        return Check("fail", "python", f"{version}, expected 3.11 to 3.13", "Recreate the environment: make setup.")
    return Check("ok", "python", version)


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


def _processor(n_cores: int, n_workers: int) -> Check:
    from llvmlite.binding import get_host_cpu_features  # installed with numba

    from tasks.simulation.simd.lanes import widest

    features = get_host_cpu_features()
    load = os.getloadavg()[0]
    found = f"{n_cores} cores, {widest()} SIMD lanes; load {load:.1f}"
    if n_workers > n_cores:
        return Check("warn", "processor", found, f"{n_workers} workers share {n_cores} cores: use --workers {n_cores}.")
    if load > 0.5 * n_cores:
        return Check("warn", "processor", found, "Other programs keep this machine busy: a study will take longer.")
    if not (features.get("avx2") and features.get("fma")):
        advice = "Without AVX2 and FMA the last bits may differ from those of other machines: use one kind for a study."
        return Check("warn", "processor", found, advice)
    return Check("ok", "processor", found)


def _memory(n_workers: int, free: float) -> Check:
    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if allowed != resource.RLIM_INFINITY and allowed < _ADDRESS_SPACE:
        found = f"the address space of a process is limited to {allowed / 1e9:.1f} GB"
        advice = f"Libraries take several GB of it: `ulimit -v unlimited`, or at least {_ADDRESS_SPACE / 1024:,.0f}."
        return Check("fail", "memory", found, advice)
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
            store_exists = (root / "store.json").exists()
        store = Store.open(root, create=False) if store_exists else None
        left = sum(stage.n_bytes for stage in forecast_stages(settings, store))
        drivers = _drivers(store) if store else []
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
    found = f"{root}: a commit takes {1e3 * seconds:.0f} ms"
    if not store_exists:
        yield Check("ok", "store", f"{found}; there is no store yet")
    else:
        yield Check("warn" if drivers else "ok", "store", "; ".join([found, *drivers]))


def _drivers(store: Store) -> list[str]:
    return [f"study {name} is driven by {who}" for name in store.studies() if (who := store.driver_of(name))]


def _try_commit(folder: Path) -> float:
    """Do what a commit does, in a temporary folder; return the time that it took [s]."""
    with tempfile.TemporaryDirectory(prefix=".puddle-doctor-", dir=folder) as trial:
        start = time.perf_counter()
        with disk.locked(Path(trial) / "lock"):
            if disk.try_lock(Path(trial) / "lock") is not None:
                raise OSError("file locks do not work")
            start += 0.5  # try_lock waits this long
            disk.place(Path(trial) / "file", b"x" * 100_000)
        return time.perf_counter() - start


def _temporary() -> Check:
    free = shutil.disk_usage(session.SESSIONS_FOLDER).free
    found = f"{free / 1e9:.1f} GB free in {session.SESSIONS_FOLDER}"
    if free < 1e9:
        return Check("fail", "temporary files", found, "Ray needs 1 GB there. Free some space.")
    if not os.access(session.SESSIONS_FOLDER, os.W_OK):
        return Check("fail", "temporary files", f"Ray can't write to {session.SESSIONS_FOLDER}", "Make it writable.")
    if dead := list(session.abandoned_sessions()):
        return Check("ok", "temporary files", f"{found}; {len(dead)} folders of dead drivers, removed automatically")
    return Check("ok", "temporary files", found)


def _shared_memory() -> Check:
    place = Path("/dev/shm")
    if not place.is_dir():
        return Check("ok", "shared memory", "this system has no /dev/shm")
    free = shutil.disk_usage(place).free
    found = f"{free / 1e9:.1f} GB free in {place}"
    if free < OBJECT_STORE_BYTES:
        return Check("warn", "shared memory", found, "Ray will use /tmp, which is slower. In Docker: --shm-size=1g.")
    return Check("ok", "shared memory", found)


def _open_files() -> Check:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < _OPEN_FILES:
        return Check("warn", "open files", f"at most {hard:,}", f"Ray needs {_OPEN_FILES:,} with many workers.")
    return Check("ok", "open files", f"{soft:,}{'' if soft == hard else ', and more on demand'}")


def _loopback() -> Check:
    """Connect to this machine through the loopback interface, as Ray's processes do."""
    try:
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
            listener.listen()
            with socket.create_connection(listener.getsockname(), timeout=2.0):
                pass
    except OSError as error:
        return Check("fail", "loopback", f"127.0.0.1 does not answer: {error}", "Ray can't start: use --workers 0.")
    if where := os.environ.get("MLFLOW_TRACKING_URI"):
        return Check("warn", "ports", f"MLFLOW_TRACKING_URI={where} is set", "Runs will be mirrored there.")
    with socket.socket() as probe, contextlib.suppress(OSError):
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(("127.0.0.1", 5000))
        return Check("ok", "ports", "the loopback answers; 5000 is free for `puddle ui`")
    return Check("warn", "ports", "the loopback answers; 5000 is taken", "Choose another for `puddle ui`: --port.")


def _kernels() -> Check:
    """Check the cache of compiled kernels."""
    from pipeline.kernels import cache_folder, is_sound, kernel_files

    folder = cache_folder()
    n_files = len(kernel_files(folder))
    found = f"{n_files} files in {folder}" if n_files else f"none compiled yet in {folder}"
    if not is_sound(folder):
        advice = "They are compiled again when they are needed. Check the disk if you do not know why."
        return Check("warn", "kernels", f"{found}, damaged", advice)
    if folder.is_relative_to(tempfile.gettempdir()) and "NUMBA_CACHE_DIR" not in os.environ:
        advice = "They do not last: make ~/.cache writable, or set NUMBA_CACHE_DIR to a folder that is."
        return Check("warn", "kernels", found, advice)
    return Check("ok", "kernels", found)


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
