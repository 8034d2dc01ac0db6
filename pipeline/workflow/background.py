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

    Only what ends in an error does not wait: it is to be said at once. The thread goes on then until the process ends.
    """

    def __init__(self, what: str, say: Callable[[str], None]) -> None:
        """Begin.

        Args:
            what: is said where one has to wait for it.
            say: shows a line to the user.
        """
        self._what, self._say = what, say
        self._work: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    def do(self, work: Callable[[], object]) -> None:
        """Have something done after all that was asked for before. What it raises, the end of the ``with`` raises."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._go_on, name=self._what, daemon=True)
            self._thread.start()
        self._work.put(work)

    def _go_on(self) -> None:
        while (work := self._work.get()) is not None:
            try:
                work()
            except BaseException as error:  # it is for the end to raise, and the rest of the work is none the worse
                self._error = self._error or error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._work.put(None)
        if self._thread is None or kind is not None:
            return
        self._thread.join(SECONDS_OF_SILENCE)
        if self._thread.is_alive():
            self._say(self._what)
            self._thread.join()
        if self._error is not None:
            raise self._error
