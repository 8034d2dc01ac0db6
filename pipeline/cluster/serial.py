"""A cluster that consists of this process alone."""

import contextlib
import itertools
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from pipeline.cluster.interface import Cluster, Done, Outcome, Ticket, failure
from pipeline.cluster.process import signals_unwind


@contextlib.contextmanager
def serial_cluster() -> Iterator[Cluster]:
    """Yield a cluster that runs each call in this process when its outcome is collected, in order of submission."""
    with signals_unwind():
        yield _Serial()


class _Serial:
    n_cores = 1.0

    def __init__(self) -> None:
        self._numbers = itertools.count()
        self._waiting: deque[tuple[Ticket, Callable[..., Any], tuple[Any, ...]]] = deque()

    @property
    def n_gpus(self) -> float:
        from tasks.residual.torch_descent import n_cuda_devices

        return float(n_cuda_devices())

    def share(self, value: Any) -> Any:
        return value

    def submit(
        self,
        function: Callable[..., Any],
        *args: Any,
        n_cores: float = 1.0,  # noqa: ARG002 (a call gets whatever this process has)
        n_gpus: float = 0.0,  # noqa: ARG002
        name: str = "",
    ) -> Ticket:
        ticket = Ticket(next(self._numbers), name or repr(function))
        self._waiting.append((ticket, function, args))
        return ticket

    def next_done(self, timeout: float | None = None) -> tuple[Ticket, Outcome] | None:  # noqa: ARG002
        if not self._waiting:
            return None
        ticket, function, args = self._waiting.popleft()
        try:
            return ticket, Done(function(*args))
        except Exception as error:
            return ticket, failure(ticket.name, error)

    def cancel_all(self) -> None:
        self._waiting.clear()
