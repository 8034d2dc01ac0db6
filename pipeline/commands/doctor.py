"""Doctor: what a machine lacks for a long study, found in seconds and not after hours."""

from __future__ import annotations

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
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.cluster import TaskFailed, ray_cluster, session
from pipeline.cluster.process import free_memory
from pipeline.commands.sizes import bytes_left_of_study
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.stages import STAGES
from pipeline.store import disk
from pipeline.store.store import Store
from pipeline.workflow.graph import survey
from pipeline.workflow.stage import Results

CONSTRAINTS = Path(__file__).resolve().parents[2] / "constraints.txt"
"""The versions that were tried together: in the checkout."""

BYTES_PER_WORKER = 450e6
"""Memory of a worker: 300 MB of its own once torch and the engine are loaded (measured), and room to work."""
BYTES_OF_DRIVER = 1e9
"""Of the driver, and of Ray's own processes."""
SPARE_BYTES = 1e9
"""That should be free on the store's disk besides: MLflow's database, reports, other people."""
OPEN_FILES = 4096
"""That Ray wants to be able to open with dozens of workers."""
RAY_SECONDS = 60.0
"""How long its first worker may take to answer."""


@dataclass(frozen=True)
class Finding:
    """One line of the examination."""

    verdict: Literal["ok", "warn", "fail"]
    what: str
    found: str
    advice: str = ""


def examine(settings: Settings, store: Path, *, n_workers: int | None) -> Iterator[Finding]:
    """Examine this machine, the quick first; every finding is given as it is made.

    Args:
        settings: of the study that it is to run.
        store: where results would be kept; it need not be there.
        n_workers: cores to use; all by default, 0 for none but this process.
    """
    n_cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    n_workers = n_cores if n_workers is None else n_workers
    yield _python()
    yield _versions()
    yield _processor(n_cores, n_workers)
    yield _memory(n_workers)
    yield from _store(store.expanduser().resolve(), settings)
    yield _temporary()
    yield _shared_memory()
    yield _open_files()
    yield _loopback()
    yield _kernel(settings)
    if n_workers:
        yield _ray()


def _python() -> Finding:
    version = platform.python_version()
    if not (3, 11) <= sys.version_info[:2] < (3, 14):
        return Finding("fail", "python", f"{version}, expected 3.11 to 3.13", "Make the environment anew: make setup.")
    return Finding("ok", "python", version)


def _versions() -> Finding:
    """Compare what is installed with what was tried together."""
    if not CONSTRAINTS.is_file():
        return Finding("warn", "versions", f"{CONSTRAINTS} is not there to compare with", "Run it from a checkout.")
    wanted = dict(re.findall(r"^([\w.-]+)==([\w.+!-]+)", CONSTRAINTS.read_text(), flags=re.M))
    needed = {
        re.split(r"[\s<>=!;\[]", line)[0].lower()
        for line in importlib.metadata.requires("puddle") or ()
        if "extra ==" not in line
    }
    missing, other = [], []
    for name, version in wanted.items():
        try:
            found = importlib.metadata.version(name).partition("+")[0]
        except importlib.metadata.PackageNotFoundError:
            missing += [name] if name.lower() in needed else []
        else:
            other += [f"{name} {found} (tried: {version})"] if found != version.partition("+")[0] else []
    if missing:
        return Finding("fail", "versions", f"{', '.join(missing)} are not installed", "make setup installs them.")
    if other:
        return Finding(
            "warn",
            "versions",
            ", ".join(other[:5]) + (f" and {len(other) - 5} more" if len(other) > 5 else ""),
            "Other versions may give other bits, and were not tried. make clean setup brings those that were.",
        )
    return Finding("ok", "versions", f"{len(wanted)} packages as in {CONSTRAINTS.name}")


def _processor(n_cores: int, n_workers: int) -> Finding:
    from tasks.simulation.simd.lanes import widest

    load = os.getloadavg()[0]
    found = f"{n_cores} cores, {widest()} robots abreast; load {load:.1f}"
    if n_workers > n_cores:
        return Finding("warn", "processor", found, f"{n_workers} workers on {n_cores} cores wait for one another.")
    if load > 0.5 * n_cores:
        return Finding("warn", "processor", found, "Something else is busy here: studies will take longer.")
    return Finding("ok", "processor", found)


def _memory(n_workers: int) -> Finding:
    free = float(free_memory())
    needed = BYTES_OF_DRIVER + n_workers * BYTES_PER_WORKER
    found = f"{free / 1e9:.1f} GB free, {needed / 1e9:.1f} GB needed by {n_workers} workers and the driver"
    if free < needed:
        fitting = max(0, int((free - BYTES_OF_DRIVER) / BYTES_PER_WORKER))
        return Finding("fail", "memory", found, f"Close something, or use fewer workers: --workers {fitting}.")
    return Finding("ok", "memory", found)


def _store(root: Path, settings: Settings) -> Iterator[Finding]:
    """Look at the store's disk: room for what is left of the study, and all that a commit does to it."""
    try:
        with disk.explained("looking for the store's disk", root, advice="ask again"):
            existing = next(path for path in (root, *root.parents) if path.exists())
            free = float(shutil.disk_usage(existing).free)
            is_there = (root / "store.json").exists()
        kept, drivers = _kept(root, settings) if is_there else ({}, [])
    except PuddleError as error:
        yield Finding("fail", "store", f"{error}")
        return
    needed = SPARE_BYTES + bytes_left_of_study(settings, kept)
    what = f"what is left of study {settings.name}"
    found = f"{free / 1e9:.1f} GB free at {existing}, about {needed / 1e9:.1f} GB needed for {what}"
    if free < needed:
        yield Finding("fail", "disk", found, "Free some (`puddle gc`), or keep the store elsewhere: --store.")
    else:
        yield Finding("ok", "disk", found)
    try:
        seconds = _try_commit(existing)
    except (OSError, PuddleError) as error:
        yield Finding(
            "fail",
            "store",
            f"{existing}: a file can't be kept there for good: {error}",
            "It needs a local disk, or a network's whose locks work, and permission to write: --store.",
        )
        return
    found = f"{root}: a file is safe in {1e3 * seconds:.0f} ms"
    if not is_there:
        yield Finding("ok", "store", f"{found}; there is no store yet")
    else:
        yield Finding("warn" if drivers else "ok", "store", "; ".join([found, *drivers]))


def _kept(root: Path, settings: Settings) -> tuple[dict[str, Results], list[str]]:
    """Find what a store holds of the study, and who drives studies in it. What is damaged counts as missing.

    Raises:
        PuddleError: it can't be read; or `puddle gc` is at work.
    """
    store = Store.open(root, create=False)
    with store.lock_to_read():
        drivers = [f"study {name} is driven by {who}" for name in store.studies() if (who := store.driver_of(name))]
        return survey(settings, STAGES, store, say=lambda line: None), drivers


def _try_commit(folder: Path) -> float:
    """Do what a commit does, in a folder that is removed again; return the seconds that it took."""
    with tempfile.TemporaryDirectory(prefix=".puddle-doctor-", dir=folder) as trial:
        start = time.perf_counter()
        with disk.locked(Path(trial) / "lock"):
            if disk.try_lock(Path(trial) / "lock") is not None:
                raise OSError("its locks do not lock")
            start += 0.5  # the patience of try_lock
            disk.place(Path(trial) / "file", b"x" * 100_000)
        return time.perf_counter() - start


def _temporary() -> Finding:
    """Look at where Ray keeps its sockets."""
    free = shutil.disk_usage(session.SESSIONS_FOLDER).free
    found = f"{free / 1e9:.1f} GB free in {session.SESSIONS_FOLDER}"
    if free < 1e9:
        return Finding("fail", "temporary files", found, "Ray needs a gigabyte there. Free some.")
    if not os.access(session.SESSIONS_FOLDER, os.W_OK):
        return Finding("fail", "temporary files", f"{session.SESSIONS_FOLDER} can't be written to", "Allow it; Ray needs it.")
    if dead := list(session.abandoned_sessions()):
        return Finding("ok", "temporary files", f"{found}; {len(dead)} folders of dead drivers, which go by themselves")
    return Finding("ok", "temporary files", found)


def _shared_memory() -> Finding:
    place = Path("/dev/shm")
    if not place.is_dir():
        return Finding("ok", "shared memory", "not of this system's kind")
    free = shutil.disk_usage(place).free
    found = f"{free / 1e9:.1f} GB free in {place}"
    if free < session.OBJECT_STORE_BYTES:
        return Finding("warn", "shared memory", found, "Ray will use /tmp instead, slowly. In Docker: --shm-size=1g.")
    return Finding("ok", "shared memory", found)


def _open_files() -> Finding:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < OPEN_FILES:
        return Finding("warn", "open files", f"at most {hard:,}", f"With many workers Ray wants {OPEN_FILES:,}.")
    return Finding("ok", "open files", f"{soft:,}{'' if soft == hard else ', and more on demand'}")


def _loopback() -> Finding:
    """Let this machine talk to itself, as Ray's processes do."""
    try:
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
            listener.listen()
            with socket.create_connection(listener.getsockname(), timeout=2.0):
                pass
    except OSError as error:
        return Finding("fail", "loopback", f"127.0.0.1 does not answer: {error}", "Ray can't start. Use --workers 0.")
    names = [name for name in ("RAY_ADDRESS", "MLFLOW_TRACKING_URI") if os.environ.get(name)]
    if names:
        elsewhere = ", ".join(f"{name}={os.environ[name]}" for name in names)
        return Finding("warn", "ports", f"{elsewhere} is set", "A study goes there, and not to this machine.")
    with socket.socket() as probe, contextlib.suppress(OSError):
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(("127.0.0.1", 5000))
        return Finding("ok", "ports", "the loopback answers; 5000 is free for `puddle ui`")
    return Finding("warn", "ports", "the loopback answers; 5000 is taken", "Give `puddle ui` another: --port.")


def _kernel(settings: Settings) -> Finding:
    """Evolve two robots for a generation: compiles what is not compiled yet."""
    from tasks.evolution import EMPTY_POPULATION, Afpo, ask, evaluate, tell
    from tasks.simulation import simulate
    from tasks.world import DryLand

    start, rng, afpo = time.perf_counter(), np.random.default_rng(0), Afpo(population_size=2)
    try:
        children = ask(EMPTY_POPULATION, rng, afpo)
        rollouts = simulate(
            children.designs,
            DryLand(depth=1.0),
            n_settle=0,
            n_measure=10,
            engine=settings.work.engine,
            physics=settings.physics,
        )
        tell(EMPTY_POPULATION, children, evaluate(rollouts, disagreement_penalty=0.0).fitness, rng, afpo)
    except Exception as error:  # whatever it is, a study would meet it too
        return Finding("fail", "engine", f"{type(error).__name__}: {error}", "make clean setup; then please report it.")
    seconds = time.perf_counter() - start
    if not np.isfinite(rollouts.displacement).all():
        return Finding("fail", "engine", "a robot on dry land came to a displacement that is no number", "Report it.")
    return Finding("ok", "engine", f"the first generation after {seconds:.1f} s")


def _ray() -> Finding:
    start = time.perf_counter()
    try:
        with ray_cluster("local", n_workers=1) as cluster:
            cluster.submit(os.getpid)
            done = cluster.next_done(timeout=RAY_SECONDS)
            seconds = time.perf_counter() - start
    except PuddleError as error:
        return Finding("fail", "ray", f"{error}")
    if done is None or isinstance(done[1], TaskFailed):
        found = f"no answer from a worker after {RAY_SECONDS:.0f} s" if done is None else f"{done[1]}"
        return Finding("fail", "ray", found, "Other work may keep this machine busy; `--workers 0` does without Ray.")
    return Finding("ok", "ray", f"a cluster of one worker after {seconds:.1f} s")
