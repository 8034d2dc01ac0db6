"""Figures of the benchmarks, and their measurement."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Benchmark:
    """A quantity measured in several rounds, and its bound."""

    name: str
    rounds: Sequence[float]
    unit: str
    bound: float | None = None
    at_least: bool = False
    """Whether the bound is a lower one."""

    @property
    def median(self) -> float:
        """Median of the rounds."""
        return statistics.median(self.rounds)

    @property
    def met(self) -> bool:
        """Whether the median meets the bound, if there is one."""
        if self.bound is None:
            return True
        return self.median >= self.bound if self.at_least else self.median <= self.bound

    @property
    def bound_text(self) -> str:
        """Bound as text."""
        return f"{'≥' if self.at_least else '≤'} {self.bound:g}"

    def as_dict(self) -> dict[str, Any]:
        """Return the figure for JSON."""
        return {**vars(self), "rounds": list(self.rounds), "median": self.median, "met": self.met}


def seconds(run: Callable[[], Any]) -> float:
    """Time one call."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start
