"""Background work on a thread: a study is mirrored to MLflow while it computes."""

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Self

SECONDS_OF_SILENCE = 2.0  # time that the end may wait before it tells the user what for [s]


class Background:
    """Runs calls one after another on a thread of its own; the end of the ``with`` block waits for all of them.

    A block that ends in an error does not wait, so that the error is reported at once. The thread then continues until
    the process ends.
    """

    def __init__(self, what: str, say: Callable[[str], None]) -> None:
        """Prepare to show the line ``what`` if the end has to wait; the thread starts with the first call."""
        self._what, self._say = what, say
        self._work: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None
        self._repeated: Callable[[], object] | None = None
        self._period: float | None = None  # [s]

    def do(self, work: Callable[[], object]) -> None:
        """Run a call after those before it. If it raises an error, the end of the ``with`` block raises that error."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=self._what, daemon=True)
            self._thread.start()
        self._work.put(work)

    @contextlib.contextmanager
    def repeat(self, work: Callable[[], object], *, every: float) -> Iterator[None]:
        """Run a call at once and then every few seconds while the block runs, after the calls before it.

        Args:
            work: the call.
            every: time from the end of a call to the next one [s].
        """
        self._repeated, self._period = work, every
        self.do(work)
        try:
            yield
        finally:
            self._repeated, self._period = None, None

    def _run(self) -> None:
        while True:
            try:
                work = self._work.get(timeout=self._period)
                if work is None:
                    return
            except queue.Empty:
                work = self._repeated or (lambda: None)  # the block may just have ended
            try:
                work()
            except BaseException as error:  # the end of the block raises it; the rest of the work continues
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
