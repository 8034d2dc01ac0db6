"""A cluster of Ray workers: this machine's cores, or an existing cluster.

Only this module and inference.py import Ray, and late: it takes a third of a second that ``--help`` should not pay.

Ray's wire format is pickle: whoever can submit to a cluster can run code on it. A local cluster therefore listens on
the loopback and is protected by a token that only this user can read; an existing one keeps its owner's rules.
"""

import contextlib
import functools
import itertools
import logging
import math
import os
import secrets
import shutil
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from pipeline.cluster.interface import Cluster, Done, Outcome, TaskFailed, Ticket, failure
from pipeline.cluster.process import PINNED_THREADS, end_at_once, ended_by_signals, number_of_cores, signals_unwind
from pipeline.errors import PuddleError
from pipeline.extensions import VARIABLE as EXTENSIONS

OBJECT_STORE_BYTES = 512 * 2**20  # shared memory of a local cluster; ensembles and results take megabytes

_N_INFRASTRUCTURE_RETRIES = 1  # retries of a task after its worker, node or memory failed, not after its own exception
_START_SECONDS = 120.0  # time to start Ray or to join a cluster [s]; ten are usual, and Ray itself tries for minutes
_SHUTDOWN_SECONDS = 10.0  # time for Ray to end by itself [s]; a server that is gone lets it wait for ever
_LAST_WORDS_SECONDS = 3.0  # time for its processes to end after that [s]
_CHECK_INTERVAL = 1.0  # time between two checks of Ray's servers [s]
_SERVERS = ("gcs_server", "raylet")  # ray's names for the processes without which it is dead
_SESSIONS_FOLDER = "/tmp"  # short, because the path of a Unix socket has at most 107 bytes; TMPDIR may be longer
_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = [str(_ROOT / name) for name in ("tasks", "pipeline")]  # sent to workers, which need not have them on disk

_ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_IGNORE_UNHANDLED_ERRORS": "1",  # a cancelled call's error is never collected
    "RAY_task_oom_retries": str(_N_INFRASTRUCTURE_RETRIES),  # unlimited by default
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",  # under `uv run`, Ray would build the environment anew for each worker
}
LOCAL_ENVIRONMENT = _ENVIRONMENT | {
    "RAY_AUTH_MODE": "token",
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # as there, Ray then listens on the loopback alone
    # Ray makes its first driver wait for the workers that it starts in advance: for ever, if one is killed meanwhile.
    "RAY_enable_worker_prestart": "0",
    "RAY_prestart_worker_first_driver": "0",
}
"""Ray reads these once, on import: a process has one kind of cluster."""

_RAY_DIED = (
    "Ray on this machine died: one of its servers is gone (killed, or out of memory).\n"
    "Committed results are safe: run the same command again to resume. Fewer `--workers` need less memory."
)
_UNREACHABLE = (
    "the Ray cluster at {address} does not answer: its head, this machine's node or the network is down.\n"
    "Committed results are safe: run the same command again once it answers (`ray status`)."
)


@contextlib.contextmanager
def ray_cluster(address: str | None = None, n_workers: int | None = None) -> Iterator[Cluster]:
    """Join an existing Ray cluster, or start a local one for as long as the context lasts.

    Args:
        address: ``host:port`` of an existing cluster that this machine is a node of, or ``auto``; None for a local
            cluster. RAY_ADDRESS counts for ``auto`` alone: another tool may have set it.
        n_workers: number of cores for a local cluster; by default those that this process may use.
    """
    if n_workers is not None and n_workers < 1:
        raise PuddleError(f"workers: expected at least 1, got {n_workers}")
    where = _local(n_workers or number_of_cores()) if address is None else _existing(address)
    with signals_unwind() as catch_signals, where as cluster:
        catch_signals()  # ray.init installs its own handler, which prints a native stack
        yield cluster


class _Ray:
    def __init__(self, is_alive: Callable[[], bool], death_message: str, n_cores: int | None = None) -> None:
        self._is_alive, self._death_message = is_alive, death_message
        self._n_cores = n_cores  # of a local cluster: to ask a server that has just died takes a minute
        self._numbers = itertools.count()
        self._running: dict[Any, Ticket] = {}

    def _check_alive(self) -> None:
        """Raise at once if Ray is dead; Ray itself takes a minute to notice and then ends the process."""
        if not self._is_alive():
            self._running.clear()
            raise PuddleError(self._death_message)

    @property
    def n_cores(self) -> float:
        return self._n_cores or self._resource("CPU")

    @property
    def n_gpus(self) -> float:
        return self._resource("GPU")

    def _resource(self, name: str) -> float:
        import ray

        self._check_alive()
        return float(ray.cluster_resources().get(name, 0.0))

    def share(self, value: Any) -> Any:
        import ray

        return ray.put(value)

    def submit(
        self, function: Callable[..., Any], *args: Any, n_cores: float = 1.0, n_gpus: float = 0.0, name: str = ""
    ) -> Ticket:
        ticket = Ticket(next(self._numbers), name or repr(function))
        reference = _remote_call(n_cores, ticket.name, n_gpus).remote(function, *args)
        self._running[reference] = ticket
        return ticket

    def next_done(self, timeout: float | None = None) -> tuple[Ticket, Outcome] | None:
        import ray

        if not self._running:
            return None
        end = time.monotonic() + (math.inf if timeout is None else timeout)
        ready: list[Any] = []
        while not ready:
            self._check_alive()
            left = end - time.monotonic()
            ready, _ = ray.wait(list(self._running), num_returns=1, timeout=max(0.0, min(left, _CHECK_INTERVAL)))
            if not ready and left <= 0:
                return None
        ticket = self._running.pop(ready[0])
        return ticket, _outcome(ticket.name, ready[0], death_message=self._death_message)

    def cancel_all(self) -> None:
        if self._is_alive():
            _cancel(self._running)
        self._running.clear()


@contextlib.contextmanager
def _local(n_workers: int) -> Iterator[_Ray]:
    """Start Ray on this machine for this user alone, and stop it at the end."""
    import psutil

    # Ray's own folder, /tmp/ray, is open to all users; this one is not.
    with tempfile.TemporaryDirectory(prefix="puddle-", dir=_SESSIONS_FOLDER, ignore_cleanup_errors=True) as folder:
        token = Path(folder, "token")
        token.touch(mode=0o600)
        token.write_text(secrets.token_hex(32))
        os.environ.update(PINNED_THREADS, **LOCAL_ENVIRONMENT, RAY_AUTH_TOKEN_PATH=str(token))
        os.environ.pop("RAY_AUTH_TOKEN", None)
        folders = [path for path in (Path(_SESSIONS_FOLDER), Path("/dev/shm")) if path.is_dir()]
        free = " and ".join(f"{path} ({shutil.disk_usage(path).free / 1e9:.1f} GB)" for path in folders)
        advice = (
            f"It needs free space in {free} and memory for {n_workers} workers "
            f"({psutil.virtual_memory().available / 1e9:.1f} GB). `--workers 0` runs without Ray."
        )
        try:
            with _joined(
                "Ray did not start on this machine",
                advice,
                _ROOT,
                address="local",
                num_cpus=n_workers,
                object_store_memory=OBJECT_STORE_BYTES,
                include_dashboard=False,
                _node_ip_address="127.0.0.1",
                _temp_dir=f"{folder}/ray",
            ):
                yield _Ray(_servers_alive(), _RAY_DIED, n_workers)
        finally:
            del os.environ["RAY_AUTH_TOKEN_PATH"]
            _remove(Path(folder))


def _remove(folder: Path) -> None:
    """Remove a folder of Ray's, which its last processes write into and a worker that still starts makes anew."""
    end = time.monotonic() + _LAST_WORDS_SECONDS
    while (_kill_the_last(folder) or folder.exists()) and time.monotonic() < end:
        shutil.rmtree(folder, ignore_errors=True)
        time.sleep(0.05)


def _kill_the_last(folder: Path) -> bool:
    """Kill Ray's processes of a folder, and return whether there were any.

    Workers outlive a raylet that is killed, and Ray kills one that takes more than a second to end.
    """
    import psutil

    found = [one for one in psutil.process_iter(["cmdline"]) if f"={folder}/" in " ".join(one.info["cmdline"] or ())]
    for one in found:
        with contextlib.suppress(psutil.Error):
            one.kill()
    return bool(found)


def _servers_alive() -> Callable[[], bool]:
    import psutil

    servers = [process for process in psutil.Process().children() if process.name() in _SERVERS]
    return lambda: all(one.is_running() and one.status() != psutil.STATUS_ZOMBIE for one in servers)


@contextlib.contextmanager
def _existing(address: str) -> Iterator[_Ray]:
    """Connect to a running cluster under its own token settings, and send it our packages."""
    advice = (
        "Expected a running cluster with this machine's versions of Python and Ray and, if it requires a token, "
        "RAY_AUTH_MODE=token with RAY_AUTH_TOKEN or RAY_AUTH_TOKEN_PATH. "
        "Check the address (`ray status` on the head), or omit --address to use this machine."
    )
    what = f"cannot use the Ray cluster at {address}"
    os.environ.update(_ENVIRONMENT)
    if address != "auto":
        host, _, port = address.rpartition(":")
        try:
            socket.create_connection((host, int(port)), timeout=15.0).close()
        except (OSError, OverflowError, ValueError) as error:
            raise PuddleError(f"{what}: expected host:port where one answers, or auto ({error})\n{advice}") from error
    extensions = {name: value for name, value in os.environ.items() if name == EXTENSIONS}
    sent = {"env_vars": PINNED_THREADS | extensions, "py_modules": _PACKAGES}
    with _joined(what, advice, Path("/"), address=address, runtime_env=sent):
        yield _Ray(lambda: True, _UNREACHABLE.format(address=address))


@contextlib.contextmanager
def _joined(what: str, advice: str, folder: Path, **options: Any) -> Iterator[None]:
    """Connect to Ray within two minutes, and disconnect at the end; messages say what failed and give advice."""
    late = functools.partial(end_at_once, f"puddle: {what}: no answer for {_START_SECONDS:.0f} s\n{advice}", 2)
    stopped = "Stopped while Ray was starting. Committed results are safe: the same command resumes."
    # Ray lets workers import first from the folder that it is started in, and a user's may hold a tasks.py.
    with contextlib.chdir(folder), _deadline(_START_SECONDS, late), ended_by_signals(stopped):  # no exceptions in Ray
        import ray

        try:
            ray.init(log_to_driver=False, logging_level=logging.CRITICAL, **options)
        except Exception as error:
            raise PuddleError(f"{what}: {error}\n{advice}") from error
    with contextlib.redirect_stdout(sys.stderr):  # ray prints pages when one of its processes dies
        try:
            yield
        finally:
            with _deadline(_SHUTDOWN_SECONDS, functools.partial(end_at_once, f"puddle: {_RAY_DIED}", 2)):
                ray.shutdown()


@contextlib.contextmanager
def _deadline(seconds: float, late: Callable[[], object]) -> Iterator[None]:
    timer = threading.Timer(seconds, late)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


class Spread:
    """A pure function of an item and of values that all items share, for calls with many items, time and again.

    Where a generation of evolution costs core-seconds, or cores outnumber trials, a segment is a task without a core of
    its own that spreads each generation's designs over the cluster. What they share, such as an ensemble, is stored on
    the cluster by the first call, once for all generations. Outside a Ray worker a call is a plain loop.
    """

    def __init__(self, function: Callable[..., Any], *shared: Any) -> None:
        """Set the function, whose first argument is an item, and its further arguments."""
        self._function, self._shared = function, shared

    @functools.cached_property
    def _stored(self) -> list[Any]:
        import ray

        return [ray.put(value) for value in self._shared]

    def __call__(self, items: Sequence[Any]) -> list[Any]:
        """Return ``function(item, *shared)`` of every item, in order, computed on other workers if this is one.

        Raises:
            TaskFailed: on Ray, the first failure among the items; the rest are cancelled.
        """
        if not in_ray_worker():
            return [self._function(item, *self._shared) for item in items]
        remote = _remote_call(1.0, repr(self._function))
        references = [remote.remote(self._function, item, *self._stored) for item in items]
        results: list[Any] = []
        try:
            for index, reference in enumerate(references):
                outcome = _outcome(f"item {index}", reference)
                if isinstance(outcome, TaskFailed):
                    raise outcome
                results.append(outcome.result)
        finally:
            _cancel(references[len(results) :])
        return results


def _call(function: Callable[..., Any], *args: Any) -> Any:
    return function(*args)


@functools.cache
def _remote_function() -> Any:
    import ray

    return ray.remote(_call)  # once: Ray sends each remote function to every worker that runs it


def _remote_call(n_cores: float, name: str, n_gpus: float = 0.0) -> Any:
    return _remote_function().options(
        num_cpus=n_cores,
        num_gpus=n_gpus,
        name=name,
        max_retries=_N_INFRASTRUCTURE_RETRIES,
        retry_exceptions=False,
        # To Ray a task without a core weighs nothing, so it would place all of them on the driver's machine.
        scheduling_strategy="DEFAULT" if n_cores else "SPREAD",
    )


def _outcome(name: str, reference: Any, *, death_message: str | None = None) -> Outcome:
    """Collect a call's outcome; raise with ``death_message`` if the driver's own node died."""
    import ray
    from ray.exceptions import LocalRayletDiedError, RayError, RayTaskError

    try:
        return Done(ray.get(reference))
    except RayTaskError as error:
        return failure(name, error.cause)
    except RayError as error:
        if death_message is not None and isinstance(error, LocalRayletDiedError):  # every later call would fail too
            raise PuddleError(death_message) from error
        message = str(error) or type(error).__name__
        return TaskFailed(name, f"{type(error).__name__}: {message.strip().splitlines()[0]}")


def _cancel(references: Any) -> None:
    import ray

    for reference in references:
        with contextlib.suppress(Exception):  # the call may have ended, or the cluster may be gone
            ray.cancel(reference, force=True, recursive=True)


def in_ray_worker() -> bool:
    """Return whether this process runs items for a driver elsewhere."""
    ray = sys.modules.get("ray")
    return bool(ray and ray.is_initialized() and ray.get_runtime_context().worker.mode == ray.WORKER_MODE)
