"""Rules for every process of a study: one thread, bounded memory, and signals that leave nothing behind."""

import contextlib
import faulthandler
import math
import os
import resource
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import NoReturn

PINNED_THREADS = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""One thread per process: torch's results change in their last bits with the number of threads, and a study's results
must not depend on the number of cores."""

_CGROUP = Path("/sys/fs/cgroup")
_QUOTAS = (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us"))
"""Files with a container's quota and period of processor time: of cgroups version 2, and of version 1."""

_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_SHARE_OF_FREE_MEMORY = 0.9  # share of the free memory that one task may take
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


@contextlib.contextmanager
def memory_bounded() -> Iterator[None]:
    """Make a task that allocates without end fail with a MemoryError before the machine runs out of memory.

    If several together take too much, Ray's memory monitor ends the newest, which is retried a finite number of times.
    Other systems than Linux have only that monitor.
    """
    if sys.platform != "linux":
        yield
        return
    import psutil

    before = resource.getrlimit(resource.RLIMIT_DATA)
    bound = psutil.Process().memory_info().data + int(_SHARE_OF_FREE_MEMORY * free_memory())
    limits = [limit for limit in (bound, *before) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min(limits), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """End this process if a block takes longer, even within compiled code: what hangs must not hold a core for ever."""
    if math.isfinite(seconds):
        faulthandler.dump_traceback_later(seconds, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


def free_memory() -> int:
    """Return the memory that is free for this process, on the machine and within its container [bytes]."""
    import psutil

    free = int(psutil.virtual_memory().available)
    with contextlib.suppress(OSError, ValueError):  # not in a container, or in one without a limit
        allowed = int(Path("/sys/fs/cgroup/memory.max").read_text())
        free = min(free, allowed - int(Path("/sys/fs/cgroup/memory.current").read_text()))
    return max(0, free)


@contextlib.contextmanager
def signals_unwind() -> Iterator[Callable[[], None]]:
    """Make SIGTERM and SIGHUP unwind the stack as Ctrl-C does, through every ``finally``, so that no process is left.

    An ignored signal stays ignored, as `nohup` requests. Yields a function that installs the handlers again, for use
    after a library has replaced them.
    """
    numbers = (signal.SIGTERM, signal.SIGHUP) if threading.current_thread() is threading.main_thread() else ()
    received: list[int] = []

    def unwind(number: int, _frame: FrameType | None) -> NoReturn:
        received.append(number)
        raise SystemExit

    with _handled(numbers, unwind) as catch:
        try:
            yield catch
        except SystemExit as stop:
            if received:
                raise SystemExit(128 + received[0]) from stop  # ray.wait replaces the code of a SystemExit by 1
            raise


@contextlib.contextmanager
def _handled(numbers: Sequence[int], handle: Callable[[int, FrameType | None], None]) -> Iterator[Callable[[], None]]:
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
    with _handled(numbers if threading.current_thread() is threading.main_thread() else (), end):
        yield


def end_at_once(message: str, code: int) -> NoReturn:
    """Print a message, restore the cursor, and end this process without running any ``finally``."""
    with contextlib.suppress(OSError):  # the terminal may be closed
        os.write(2, (_SHOW_CURSOR if os.isatty(2) else b"") + f"\n{message}\n".encode())
    os._exit(code)
