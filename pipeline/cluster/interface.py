"""The interface of a cluster: submit pure functions, collect their outcomes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from pipeline.errors import PuddleError


@dataclass(frozen=True)
class Ticket:
    """The identity of a submitted call until its outcome arrives."""

    number: int  # order of submission, from 0
    name: str


@dataclass(frozen=True)
class Done:
    """The result of a call."""

    result: Any


class TaskFailed(PuddleError):  # noqa: N818 (an outcome as much as an exception)
    """A call that returned no result."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(name, reason)  # so that it survives pickling
        self.name = name
        self.reason = reason  # the exception's type and message

    def __str__(self) -> str:
        return f"{self.name}: {self.reason}"


Outcome = Done | TaskFailed


class Cluster(Protocol):
    """A place where calls run; :func:`serial_cluster` and :func:`ray_cluster` yield one."""

    @property
    def n_cores(self) -> float:
        """Number of cores in the cluster now."""

    @property
    def n_gpus(self) -> float:
        """Number of GPUs in the cluster now."""

    def share(self, value: Any) -> Any:
        """Store a large immutable value, such as an ensemble's weights, once for many calls.

        A function that is submitted with what this returns receives the value itself.
        """

    def submit(
        self, function: Callable[..., Any], *args: Any, n_cores: float = 1.0, n_gpus: float = 0.0, name: str = ""
    ) -> Ticket:
        """Return the ticket of ``function(*args)``, which is queued.

        Args:
            function: a pure function that can be pickled.
            args: its arguments; a shared value must be one, not be inside of one.
            n_cores: cores that the call occupies. A function that only waits for its own :class:`Spread` takes 0;
                each such call is a process, so the caller limits their number by memory.
            n_gpus: GPUs that the call occupies.
            name: shown in messages.
        """

    def next_done(self, timeout: float | None = None) -> tuple[Ticket, Outcome] | None:
        """Collect one outcome, on Ray in no particular order; None if none arrives within ``timeout`` [s]."""

    def cancel_all(self) -> None:
        """Stop every running call and drop every queued one."""


def failure(name: str, cause: BaseException) -> TaskFailed:
    """Return the outcome of a call that raised; the cause may itself be the failure of an item of a spread."""
    failed = TaskFailed(name, str(cause) if isinstance(cause, TaskFailed) else f"{type(cause).__name__}: {cause}")
    failed.__cause__ = cause
    return failed
