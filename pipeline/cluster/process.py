"""What holds for a process that works on a study: one thread, and signals that leave nothing behind."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import NoReturn

PINNED_THREADS = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}
"""One thread per process: torch's results change in their last bits with the number of threads (reliability rule 8)."""


def pin_threads() -> None:
    """Hold this process and its children to one thread each. Call it before numpy, numba or torch is imported."""
    os.environ.update(PINNED_THREADS)


@contextlib.contextmanager
def signals_unwind() -> Iterator[Callable[[], None]]:
    """Let SIGTERM and a closed terminal leave as Ctrl-C does, through every ``finally``, so that no process is left.

    Yields a function that takes the signals back from whoever took them since.
    """
    numbers = (signal.SIGTERM, signal.SIGHUP) if threading.current_thread() is threading.main_thread() else ()
    before = {number: signal.getsignal(number) for number in numbers}
    received: list[int] = []

    def unwind(number: int, _frame: FrameType | None) -> NoReturn:
        received.append(number)
        raise SystemExit

    def catch() -> None:
        for number in numbers:
            signal.signal(number, unwind)

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
    """Keep Ctrl-C and the like back until the end of what must not be cut in two, and let them through then."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []

    def hold(number: int, _frame: FrameType | None) -> None:
        received.append(number)

    before = {number: signal.signal(number, hold) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if received:
            signal.raise_signal(received[0])
