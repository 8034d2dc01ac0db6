"""Rules for every process of a study: one thread, and signals that leave nothing behind."""

import contextlib
import os
import resource
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import NoReturn

from pipeline.errors import PuddleError

PINNED_THREADS = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""One thread per process: torch's results change in their last bits with the number of threads, and a study's results
must not depend on the number of cores."""

_CGROUP = Path("/sys/fs/cgroup")
_QUOTAS = (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us"))
"""Files with a container's quota and period of processor time: of cgroups version 2, and of version 1."""

_ADDRESS_SPACE = 4.5e9  # most that a worker maps, its libraries and memory together [bytes]
_RAY_THREADS, _WORKER_THREADS = 220, 24  # of the driver and Ray's servers, and of each worker
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_SECONDS_UNTIL_RESENT = 0.05  # after which a signal that met an import is sent again
_SHOW_CURSOR = b"\x1b[?25h"  # the progress display hides it


def prepare_process() -> None:
    """Set what libraries read from the environment, for this process and its children. Call it before importing them.

    One thread each; figures without a display, whatever a notebook has chosen; and no proxy for the loopback.
    """
    os.environ.update(PINNED_THREADS, MPLBACKEND="agg")
    for name in ("no_proxy", "NO_PROXY"):
        others = [host for host in os.environ.get(name, "").split(",") if host and host not in _LOOPBACK]
        os.environ[name] = ",".join([*others, *_LOOPBACK])


def number_of_cores() -> int:
    """Return the cores that this process may use: its affinity (also Slurm's) and its container's quota, at least 1."""
    cores = float(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
    for files in _QUOTAS:
        with contextlib.suppress(OSError, ValueError):  # not in a container, or in one without a quota
            quota, period = (int(word) for name in files for word in (_CGROUP / name).read_text().split())
            cores = min(cores, quota / period) if quota > 0 else cores
    return max(1, int(cores))


def check_limits(n_workers: int) -> None:
    """Refuse limits under which libraries abort the process, and Ray waits a minute for processes that it can't start.

    Args:
        n_workers: number of Ray's workers on this machine; 0 without Ray.
    """
    address_space, _ = resource.getrlimit(resource.RLIMIT_AS)  # negative if there is no limit, as is the next
    if 0 <= address_space < _ADDRESS_SPACE:
        got = f"expected at least {_ADDRESS_SPACE / 1e9} GB, got {address_space / 1e9:.1f}"
        raise PuddleError(f"the limit of address space (ulimit -v): {got}. Raise it: ulimit -v unlimited.")
    needed = _RAY_THREADS + n_workers * _WORKER_THREADS
    left = needed if (n_processes := resource.getrlimit(resource.RLIMIT_NPROC)[0]) < 0 else n_processes - _own_threads()
    with contextlib.suppress(OSError, ValueError):  # not in a container, or in one without a limit
        most, now = (int((_CGROUP / name).read_text()) for name in ("pids.max", "pids.current"))
        left = min(left, most - now)
    if n_workers and left < needed:
        got = f"expected at least {needed:,} more for {n_workers} workers, got {left:,}"
        raise PuddleError(
            f"the limit of processes and threads (ulimit -u, or the container's): {got}. Raise it, or use fewer "
            f"--workers; --workers 0 runs without Ray."
        )


def _own_threads() -> int:
    """Count the threads of all processes of this user."""
    import psutil

    found = (process.info for process in psutil.process_iter(["num_threads", "uids"]))
    return sum(one["num_threads"] or 0 for one in found if one["uids"] and one["uids"].real == os.getuid())


@contextlib.contextmanager
def signals_unwind() -> Iterator[Callable[[], None]]:
    """Make SIGTERM and SIGHUP unwind the stack as Ctrl-C does, through every ``finally``, so that no process is left.

    All three wait for the end of an import: there, libraries swallow exceptions, and one in Python's own code may leave
    the lock of all imports taken. An ignored signal stays ignored, as `nohup` requests. Yields a function that installs
    the handlers again, for use after a library has replaced them.
    """
    ctrl_c = (signal.SIGINT,) if signal.getsignal(signal.SIGINT) is signal.default_int_handler else ()
    in_main = threading.current_thread() is threading.main_thread()
    numbers = (*ctrl_c, signal.SIGTERM, signal.SIGHUP) if in_main else ()
    received: list[int] = []

    def n_imports(frame: FrameType | None) -> int:
        return sum(one.f_code.co_filename.startswith("<frozen importlib") for one, _ in traceback.walk_stack(frame))

    n_before = n_imports(sys._getframe())

    def unwind(number: int, frame: FrameType | None) -> None:
        if n_imports(frame) > n_before:
            threading.Timer(_SECONDS_UNTIL_RESENT, os.kill, (os.getpid(), number)).start()
            return
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        received.append(number)
        raise SystemExit

    with handled(numbers, unwind) as catch:
        try:
            yield catch
        except SystemExit as stop:
            if received:
                raise SystemExit(128 + received[0]) from stop  # ray.wait replaces the code of a SystemExit by 1
            raise


@contextlib.contextmanager
def handled(numbers: Sequence[int], handle: Callable[[int, FrameType | None], None]) -> Iterator[Callable[[], None]]:
    """Handle signals, except ignored ones, within a block; yield a function that installs the handler again."""
    before = {number: signal.getsignal(number) for number in numbers}

    def catch() -> None:
        for number, handler in before.items():
            signal.signal(number, handler if handler == signal.SIG_IGN else handle)

    catch()
    try:
        yield catch
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def ended_by_signals(message: str) -> Iterator[None]:
    """Let SIGINT, SIGTERM and SIGHUP end this process at once within a block that must not be unwound."""

    def end(number: int, _frame: FrameType | None) -> NoReturn:
        end_at_once(message, 128 + number)

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    with handled(numbers if threading.current_thread() is threading.main_thread() else (), end):
        yield


def end_at_once(message: str, code: int) -> NoReturn:
    """Print a message, restore the cursor, and end this process without running any ``finally``."""
    with contextlib.suppress(OSError):  # the terminal may be closed
        os.write(2, (_SHOW_CURSOR if os.isatty(2) else b"") + f"\n{message}\n".encode())
    os._exit(code)
