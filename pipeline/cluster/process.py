"""Rules for every process of a study: one thread, bounded memory, and signals that leave nothing behind."""

import contextlib
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

_DEFERRED_SECONDS = 2.0  # longest time that a signal is deferred [s]
_SHARE_OF_FREE_MEMORY = 0.9  # share of the free memory that one task may take
_SHOW_CURSOR = b"\x1b[?25h"  # the progress display hides it


def pin_threads() -> None:
    """Limit this process and its children to one thread each. Call it before numpy, numba or torch is imported."""
    os.environ.update(PINNED_THREADS)


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
def signals_deferred() -> Iterator[None]:
    """Defer SIGINT, SIGTERM and SIGHUP until the end of a block that must not be interrupted.

    The block has two seconds from the first signal. After that the process ends at once, for which the store and the
    supervisor of Ray's processes are designed. An ignored signal stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []

    def defer(number: int, _frame: FrameType | None) -> None:
        if not received:
            last_resort.start()
        received.append(number)

    def end() -> None:
        message = "Stopped while Ray was starting. Committed results are safe: the same command resumes."
        end_at_once(message, 128 + received[0])

    last_resort = threading.Timer(_DEFERRED_SECONDS, end)
    last_resort.daemon = True
    try:
        with _handled((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), defer):
            yield
    finally:
        last_resort.cancel()
        if received:
            signal.raise_signal(received[0])


def end_at_once(message: str, code: int) -> NoReturn:
    """Print a message, restore the cursor, and end this process without running any ``finally``."""
    with contextlib.suppress(OSError):  # the terminal may be closed
        os.write(2, (_SHOW_CURSOR if os.isatty(2) else b"") + f"\n{message}\n".encode())
    os._exit(code)
