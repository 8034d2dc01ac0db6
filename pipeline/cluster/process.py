"""What holds for a process that works on a study: one thread, and signals that leave nothing behind."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import NoReturn

PINNED_THREADS = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""One thread per process: torch's results change in their last bits with the number of threads, and a study's must not
depend on how many cores there are."""

HELD_SECONDS = 2.0
"""How long a signal is kept back at most."""

SHARE_OF_FREE_MEMORY = 0.9
"""That one task may take."""

SHOW_CURSOR = b"\x1b[?25h"
"""To a terminal: the progress display hides it."""


def pin_threads() -> None:
    """Hold this process and its children to one thread each. Call it before numpy, numba or torch is imported."""
    os.environ.update(PINNED_THREADS)


@contextlib.contextmanager
def memory_bounded() -> Iterator[None]:
    """Let a task that allocates without end fail with a MemoryError, before it takes the machine with it.

    It may take nine tenths of the memory that is free as it begins. Where several together take too much, Ray's own
    monitor ends the last one, which is tried again a finite number of times. Linux only: elsewhere that monitor is all.
    """
    if sys.platform != "linux":
        yield
        return
    import psutil

    before = resource.getrlimit(resource.RLIMIT_DATA)
    bound = psutil.Process().memory_info().data + int(SHARE_OF_FREE_MEMORY * free_memory())
    limits = [limit for limit in (bound, *before) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min(limits), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def free_memory() -> int:
    """Return the bytes that are free for this process: on the machine, and within its container."""
    import psutil

    free = int(psutil.virtual_memory().available)
    with contextlib.suppress(OSError, ValueError):  # no container, or one without a limit
        allowed = int(Path("/sys/fs/cgroup/memory.max").read_text())
        free = min(free, allowed - int(Path("/sys/fs/cgroup/memory.current").read_text()))
    return max(0, free)


@contextlib.contextmanager
def signals_unwind() -> Iterator[Callable[[], None]]:
    """Let SIGTERM and a closed terminal leave as Ctrl-C does, through every ``finally``, so that no process is left.

    A signal that is ignored stays so: `nohup` asks for that. Yields a function that takes the signals back from whoever
    took them since.
    """
    numbers = (signal.SIGTERM, signal.SIGHUP) if threading.current_thread() is threading.main_thread() else ()
    before = {number: signal.getsignal(number) for number in numbers}
    received: list[int] = []

    def unwind(number: int, _frame: FrameType | None) -> NoReturn:
        received.append(number)
        raise SystemExit

    def catch() -> None:
        for number, handler in before.items():
            signal.signal(number, handler if handler == signal.SIG_IGN else unwind)

    catch()
    try:
        yield catch
    except SystemExit as stop:
        if received:
            raise SystemExit(128 + received[0]) from stop  # Ray's waiting replaces the code of a SystemExit by 1
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def signals_held() -> Iterator[None]:
    """Keep Ctrl-C and the like back until the end of what must not be cut in two, and let them through then.

    It has :data:`HELD_SECONDS` from the first signal to come to its end. After that this process ends at once, which
    the store and the keeper of Ray's processes are made for. A signal that is ignored stays so.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []

    def hold(number: int, _frame: FrameType | None) -> None:
        if not received:
            last_resort.start()
        received.append(number)

    def end() -> None:
        message = "Stopped while Ray was starting. What is done is kept: the same command goes on from there."
        end_at_once(message, 128 + received[0])

    last_resort = threading.Timer(HELD_SECONDS, end)
    last_resort.daemon = True
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    for number, handler in before.items():
        signal.signal(number, handler if handler == signal.SIG_IGN else hold)
    try:
        yield
    finally:
        last_resort.cancel()
        for number, handler in before.items():
            signal.signal(number, handler)
        if received:
            signal.raise_signal(received[0])


def end_at_once(message: str, code: int) -> NoReturn:
    """Say why, and end this process without any ``finally``; what these would do to a terminal is done."""
    with contextlib.suppress(OSError):  # nobody is there to read it
        os.write(2, (SHOW_CURSOR if os.isatty(2) else b"") + f"\n{message}\n".encode())
    os._exit(code)
