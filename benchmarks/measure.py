"""Figures of the benchmarks, and their measurement."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Figure:
    """A quantity measured in several rounds, and its promised bound."""

    name: str
    rounds: Sequence[float]
    unit: str
    promise: float | None = None
    at_least: bool = False
    """Whether the promise is a lower bound."""

    @property
    def median(self) -> float:
        """Median of the rounds."""
        return statistics.median(self.rounds)

    @property
    def kept(self) -> bool:
        """Whether the median meets the promise, if there is one."""
        if self.promise is None:
            return True
        return self.median >= self.promise if self.at_least else self.median <= self.promise

    @property
    def promise_text(self) -> str:
        """Promise as text."""
        return f"{'≥' if self.at_least else '≤'} {self.promise:g}"

    def as_dict(self) -> dict[str, Any]:
        """Return the figure for JSON."""
        return {**vars(self), "rounds": list(self.rounds), "median": self.median, "kept": self.kept}


def seconds(run: Callable[[], Any]) -> float:
    """Time one call."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start
