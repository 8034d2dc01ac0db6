"""Work that nothing else waits for, done beside what does: MLflow is told of a stage while the next one computes."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

SECONDS_OF_SILENCE = 2.0
"""How long this process may wait at its end before it says what for."""


class Background:
    """Does one thing after another on a thread of its own; at the end of a ``with`` all of it has been done.

    Only an interruption does not wait. The thread ends with the process then, whatever it was at.
    """

    def __init__(self, what: str, say: Callable[[str], None]) -> None:
        """Begin.

        Args:
            what: is said where one has to wait for it.
            say: shows a line to the user.
        """
        self._what, self._say = what, say
        self._work: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    def do(self, work: Callable[[], object]) -> None:
        """Have something done after all that was asked for before. What it raises, the end of the ``with`` raises."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._go_on, name=self._what, daemon=True)
            self._thread.start()
        self._work.put(work)

    def _go_on(self) -> None:
        while True:
            work = self._work.get()
            try:
                work()
            except BaseException as error:  # a thread that died would be waited for for ever
                self._error = self._error or error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread is None or (kind is not None and not issubclass(kind, Exception)):
            return
        all_done = threading.Event()
        self.do(all_done.set)
        if not all_done.wait(SECONDS_OF_SILENCE):
            self._say(self._what)
            all_done.wait()
        if self._error is not None and kind is None:
            raise self._error
