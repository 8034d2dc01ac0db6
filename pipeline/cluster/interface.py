"""What a cluster is to the stages: submit pure functions, take their outcomes."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from pipeline.errors import PuddleError


@dataclass(frozen=True)
class Ticket:
    """What a submitted call is known by until its outcome comes."""

    number: int
    """Order of submission, from 0."""
    name: str


@dataclass(frozen=True)
class Handle:
    """A value that was put on the cluster once; a function submitted with it receives the value itself."""

    reference: Any


@dataclass(frozen=True)
class Done:
    """The result of a call."""

    result: Any


class TaskFailed(PuddleError):  # noqa: N818 (what it is, not that it went wrong)
    """A call that gave no result.

    Attributes:
        name: what the call was submitted as.
        reason: the exception's type and message.
        remote_traceback: the traceback where it happened, as text.
        infrastructure: whether the worker, its node or its memory failed, and not the function.
    """

    def __init__(self, name: str, reason: str, remote_traceback: str, infrastructure: bool) -> None:
        super().__init__(name, reason, remote_traceback, infrastructure)  # so that it survives pickling
        self.name = name
        self.reason = reason
        self.remote_traceback = remote_traceback
        self.infrastructure = infrastructure

    def __str__(self) -> str:
        return f"{self.name}: {self.reason}"


Outcome = Done | TaskFailed


class Cluster(Protocol):
    """Where calls run: what :func:`serial_cluster` and :func:`ray_cluster` give for the length of a ``with``."""

    @property
    def n_cores(self) -> float:
        """Cores that the cluster has now."""

    @property
    def n_gpus(self) -> float:
        """GPUs that the cluster has now."""

    @property
    def n_running(self) -> int:
        """Calls submitted whose outcome has not been taken yet."""

    def share(self, value: Any) -> Handle:
        """Put a large immutable value, such as an ensemble's weights, once for many calls."""

    def submit(
        self, function: Callable[..., Any], *args: Any, n_cores: float = 1.0, n_gpus: float = 0.0, name: str = ""
    ) -> Ticket:
        """Queue ``function(*args)``. An argument (not something inside one) may be a :class:`Handle`.

        A function that only waits for its own :func:`spread` takes ``n_cores=0``; each of those is a process, so a
        caller keeps only as many of them in flight as it has memory for.
        """

    def next_done(self, timeout: float | None = None) -> tuple[Ticket, Outcome] | None:
        """Take one outcome, in no particular order on Ray; None if none came within ``timeout`` [s] or none is due."""

    def begun(self) -> set[Ticket]:
        """Say which calls a worker has begun, of those whose outcome has not been taken; the others wait for a core."""

    def give_up(self, ticket: Ticket) -> None:
        """Stop one call, whose outcome has not been taken; none will come. What never returns holds this process."""

    def cancel_all(self) -> None:
        """Stop what runs and forget what waits; no outcome of it will come."""


def failure(name: str, cause: BaseException, remote_traceback: str) -> TaskFailed:
    """Make the outcome of a call that raised."""
    if isinstance(cause, TaskFailed):  # an item of a spread: what went wrong, went wrong there
        failed = TaskFailed(name, str(cause), cause.remote_traceback, cause.infrastructure)
    else:
        failed = TaskFailed(name, f"{type(cause).__name__}: {cause}", remote_traceback, False)
    failed.__cause__ = cause
    return failed


def references(args: tuple[Any, ...]) -> tuple[Any, ...]:
    """Replace handles by what they refer to."""
    return tuple(arg.reference if isinstance(arg, Handle) else arg for arg in args)


def name_of(function: Callable[..., Any]) -> str:
    """Name a call that its submitter did not."""
    inner = function.func if isinstance(function, functools.partial) else function
    return str(getattr(inner, "__qualname__", type(inner).__name__))
