"""A cluster of Ray workers: this machine's cores, or an existing cluster.

Only this package imports Ray: this module, the supervisor that starts Ray, and the probe of the preflight check. It is
imported late, because it takes a third of a second that ``--help`` should not pay.

Ray's wire format is pickle: whoever can submit to a cluster can run code on it. A local cluster is therefore protected
by a token that only this user can read; an existing one keeps its owner's rules.
"""

import contextlib
import functools
import importlib.util
import itertools
import logging
import math
import os
import re
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.cluster.interface import Cluster, Done, Handle, Outcome, TaskFailed, Ticket, failure, name_of, references
from pipeline.cluster.preflight import check_reachable, server_of, unusable
from pipeline.cluster.process import PINNED_THREADS, memory_bounded, signals_deferred, signals_unwind
from pipeline.cluster.session import SESSIONS_FOLDER, Session, session
from pipeline.cluster.watchdog import CHECK_INTERVAL, NODE_DIED, RAY_DIED, Calls, end_if_silent, end_if_unreachable
from pipeline.errors import PuddleError

_N_INFRASTRUCTURE_RETRIES = 1  # retries of a task after its worker, node or memory failed, not after its own exception
_SHUTDOWN_SECONDS = 5.0  # time for Ray to end by itself [s]
_PACKAGES = ("tasks", "pipeline")  # sent to the workers of an existing cluster, which need not have them on disk


@dataclass(frozen=True)
class _Connection:
    """A connection to a running Ray."""

    is_alive: Callable[[], bool]
    calling: Calls  # held during every call into Ray, so that the watchdog sees it hang
    death_message: str
    has_cores: bool = False  # as long as it is sound


@contextlib.contextmanager
def ray_cluster(address: str | None = None, n_workers: int | None = None) -> Iterator[Cluster]:
    """Join an existing Ray cluster, or start a local one for as long as the context lasts.

    Args:
        address: ``host:port`` of an existing cluster that this machine is a node of, or ``auto``. Defaults to
            RAY_ADDRESS; without either, a local cluster starts.
        n_workers: number of cores for a local cluster; all by default. Ignored by an existing cluster.
    """
    if n_workers is not None and n_workers < 1:
        raise PuddleError(f"workers: expected at least 1, got {n_workers}")
    address = address or os.environ.get("RAY_ADDRESS") or "local"
    with (
        signals_unwind() as catch_signals,
        _local(n_workers) if address == "local" else _existing(address) as connection,
    ):
        catch_signals()  # ray.init installs its own handler, which prints a native stack
        cluster = _Ray(connection)
        try:
            yield cluster
        except BaseException:
            cluster.cancel_all()
            raise


class _Ray:
    def __init__(self, connection: _Connection) -> None:
        self._connection, self._calling = connection, connection.calling
        self._numbers = itertools.count()
        self._running: dict[Any, Ticket] = {}
        self._key_prefix = f"puddle/{uuid.uuid4().hex}/".encode()

    def _check_alive(self) -> None:
        """Raise at once if Ray is dead; Ray itself takes a minute to notice and fails every call meanwhile."""
        if not self._connection.is_alive():
            self._running.clear()
            raise PuddleError(self._connection.death_message)

    @property
    def n_cores(self) -> float:
        n_cores = self._resource("CPU")
        if self._connection.has_cores and not n_cores:  # its raylet is stopped, so Ray counts the node as dead
            self._running.clear()
            raise PuddleError(self._connection.death_message)
        return n_cores

    @property
    def n_gpus(self) -> float:
        return self._resource("GPU")

    def _resource(self, name: str) -> float:
        import ray

        self._check_alive()
        with self._calling:
            return float(ray.cluster_resources().get(name, 0.0))

    @property
    def n_running(self) -> int:
        return len(self._running)

    def share(self, value: Any) -> Handle:
        import ray

        with self._calling:
            return Handle(ray.put(value))

    def submit(
        self, function: Callable[..., Any], *args: Any, n_cores: float = 1.0, n_gpus: float = 0.0, name: str = ""
    ) -> Ticket:
        ticket = Ticket(next(self._numbers), name or name_of(function))
        remote = _remote_call(n_cores, ticket.name, n_gpus)
        with self._calling:
            reference = remote.remote(self._start_key(ticket), function, *references(args))
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
            with self._calling:
                timeout_now = max(0.0, min(left, CHECK_INTERVAL))
                ready, _ = ray.wait(list(self._running), num_returns=1, timeout=timeout_now)
            if not ready and left <= 0:
                return None
        ticket = self._running.pop(ready[0])
        with self._calling:
            return ticket, _outcome(ticket.name, ready[0], death_message=self._connection.death_message)

    def started(self) -> set[Ticket]:
        from ray.experimental.internal_kv import _internal_kv_list

        self._check_alive()
        with self._calling:
            found = set(_internal_kv_list(self._key_prefix))
        return {ticket for ticket in self._running.values() if self._start_key(ticket) in found}

    def _start_key(self, ticket: Ticket) -> bytes:
        return self._key_prefix + str(ticket.number).encode()

    def cancel(self, ticket: Ticket) -> None:
        (reference,) = (reference for reference, running in self._running.items() if running is ticket)
        with self._calling:
            _cancel([reference])
        del self._running[reference]

    def cancel_all(self) -> None:
        with self._calling:
            _cancel(self._running)
        self._running.clear()


@contextlib.contextmanager
def _local(n_workers: int | None) -> Iterator[_Connection]:
    """Start Ray on this machine for this user alone, and stop it at the end."""
    import ray
    import ray._private.ray_constants

    # Ray's servers listen on the node's address. Ray accepts the loopback as that address only if this variable says
    # so, as on Windows and macOS, and reads the variable once, on import.
    on_loopback = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
    token = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": None}
    with _environment(token | on_loopback), contextlib.ExitStack() as stack:
        try:
            ours = stack.enter_context(session(n_workers))
            stack.enter_context(_environment({"RAY_AUTH_TOKEN_PATH": str(ours.token)}))
            constants = ray._private.ray_constants
            stack.callback(setattr, constants, "ENABLE_RAY_CLUSTER", constants.ENABLE_RAY_CLUSTER)
            constants.ENABLE_RAY_CLUSTER = False
            stack.callback(_shut_down, ours)
            with ours.calling:
                _connect(address=ours.address)
        except Exception as error:
            raise PuddleError(
                f"Ray did not start on this machine: {error}\nIt needs free space in {SESSIONS_FOLDER} and /dev/shm "
                f"and memory for {n_workers or 'as many workers as there are cores'}. `--workers 0` runs without Ray."
            ) from error
        yield _Connection(ours.is_alive, ours.calling, RAY_DIED, has_cores=True)


def _shut_down(ours: Session) -> None:
    import ray

    ends_ray = threading.Timer(_SHUTDOWN_SECONDS, ours.kill)  # a stopped raylet would let ray.shutdown wait for ever
    ends_ray.daemon = True
    ends_ray.start()
    with ours.calling:
        ray.shutdown()
    ends_ray.cancel()


@contextlib.contextmanager
def _existing(address: str) -> Iterator[_Connection]:
    """Connect to a running cluster under its own token settings, and send it our packages."""
    check_reachable(address)
    import ray

    calling, over = Calls(), threading.Event()
    with _environment({}):
        try:
            packages = [_folder_of(package) for package in _PACKAGES]
            _connect(address=address, runtime_env={"env_vars": PINNED_THREADS, "py_modules": packages})
        except Exception as error:
            raise unusable(address, str(error)) from error
        else:
            server = server_of(ray.get_runtime_context().gcs_address if address == "auto" else address)
            threading.Thread(target=end_if_unreachable, args=(address, *server, over), daemon=True).start()
            threading.Thread(target=end_if_silent, args=(calling, over), daemon=True).start()
            yield _Connection(lambda: True, calling, NODE_DIED.format(address=address))
        finally:
            over.set()
            ray.shutdown()


def _connect(**where: Any) -> None:
    import ray
    import ray._private.worker
    from ray._raylet import AuthenticationTokenLoader, Config  # type: ignore[attr-defined]  # compiled

    # Ray reads the environment once, on import. Make it read it again, as its own start-up code does.
    Config.initialize("")
    AuthenticationTokenLoader.instance().reset_cache()
    # The outcome reports a dead worker; Ray would also print a paragraph on stdout, despite log_to_driver.
    ray._private.worker._worker_logs_enabled = False
    with signals_deferred():  # if interrupted while starting, Ray may crash and leave its files behind
        ray.init(log_to_driver=False, logging_level=logging.ERROR, **where)


def _folder_of(package: str) -> str:
    specification = importlib.util.find_spec(package)
    assert specification is not None and specification.submodule_search_locations
    return str(Path(specification.submodule_search_locations[0]).resolve())


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
        if not _in_ray_worker():
            return [self._function(item, *self._shared) for item in items]
        name = name_of(self._function)
        remote = _remote_call(1.0, name)
        references = [remote.remote(None, self._function, item, *self._stored) for item in items]
        results: list[Any] = []
        try:
            for index, reference in enumerate(references):
                outcome = _outcome(f"{name}, item {index}", reference)
                if isinstance(outcome, TaskFailed):
                    raise outcome
                results.append(outcome.result)
        finally:
            _cancel(references[len(results) :])
        return results


def _call(start_key: bytes | None, function: Callable[..., Any], *args: Any) -> Any:
    with _recorded_as_started(start_key) if start_key else contextlib.nullcontext(), memory_bounded():
        return function(*args)


@contextlib.contextmanager
def _recorded_as_started(key: bytes) -> Iterator[None]:
    """Record, in the key-value store of Ray's head, that a call runs: Ray does not say which calls run and which wait.

    The entry of a call whose worker was killed stays (50 bytes), so a call that Ray retries counts as started at once.
    """
    from ray.experimental.internal_kv import _internal_kv_del, _internal_kv_put

    _internal_kv_put(key, b"")
    try:
        yield
    finally:
        _internal_kv_del(key)


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
        return failure(name, error.cause, re.sub(r"\x1b\[[0-9;]*m", "", str(error)))
    except RayError as error:
        if death_message is not None and isinstance(error, LocalRayletDiedError):  # every later call would fail too
            raise PuddleError(death_message) from error
        message = str(error) or type(error).__name__
        return TaskFailed(name, f"{type(error).__name__}: {message.strip().splitlines()[0]}", message, True)


def _cancel(references: Any) -> None:
    import ray

    for reference in references:
        with contextlib.suppress(Exception):  # the call may have ended, or the cluster may be gone
            ray.cancel(reference, force=True, recursive=True)


def _in_ray_worker() -> bool:
    ray = sys.modules.get("ray")
    return bool(ray and ray.is_initialized() and ray.get_runtime_context().worker.mode == ray.WORKER_MODE)


@contextlib.contextmanager
def _environment(changes: Mapping[str, str | None]) -> Iterator[None]:
    """Set environment variables that Ray reads; None unsets one."""
    always = {
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_IGNORE_UNHANDLED_ERRORS": "1",  # a cancelled call's error is never collected
        "RAY_task_oom_retries": str(_N_INFRASTRUCTURE_RETRIES),  # unlimited by default
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # Ray's future default; without it Ray prints a warning
    }
    changes = always | dict(changes)
    before = {name: os.environ.get(name) for name in changes}
    _set_environment(changes)
    try:
        yield
    finally:
        _set_environment(before)


def _set_environment(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
