"""How a stage's chains would keep a cluster busy: the driver's own policy, played through on simulated cores.

As in pipeline/workflow/dispatcher.py, the heaviest remaining chain is handed out first, two pieces for each core; as on Ray, tasks
begin in the order in which they came; and one driver takes every result, one after another. A piece whose generations
are split holds no core itself: it hands a generation's batches to the cores, waits for all, and selects. Trials that go
side by side are played one by one, each at its share of their time, though with cores enough for all they go alone.
"""

from __future__ import annotations

import heapq
import itertools
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from pipeline.workflow.dispatcher import QUEUED_PER_CORE

TASK_SECONDS = 0.003
"""What Ray takes to hand out one task, measured."""


@dataclass(frozen=True)
class Work:
    """What one piece costs."""

    n_rounds: int
    """Generations that follow one another."""
    n_batches: int
    """Tasks of a round, side by side; of a piece that is not split, one round of one task is all."""
    batch_seconds: float
    between_seconds: float = 0.0
    """From the last batch of a round to the next round: asking, telling, selecting."""

    @property
    def core_seconds(self) -> float:
        """On the cores, all together."""
        return self.n_rounds * self.n_batches * self.batch_seconds

    @property
    def least_seconds(self) -> float:
        """On cores without end."""
        return self.n_rounds * (self.batch_seconds + self.between_seconds)


@dataclass(frozen=True)
class Schedule:
    """How a stage went on simulated cores."""

    seconds: float
    """To the end."""
    critical_seconds: float
    """Of the longest chain, which no number of cores gets below."""
    busy: float
    """Share of the cores' time with a task of ours, from 0 to 1."""
    driver_busy: float
    """Share of the driver's time with results, from 0 to 1."""


def play(chains: Sequence[Sequence[Work]], n_cores: int, *, driver_seconds: float) -> Schedule:
    """Play a stage through.

    Args:
        chains: their pieces, in order.
        n_cores: of the cluster.
        driver_seconds: what one result costs the driver: keeping it, and handing out the next piece.
    """
    played = _Play(n_cores, driver_seconds, [list(chain) for chain in chains])
    played.run()
    critical = max((sum(work.least_seconds for work in chain) for chain in chains), default=0.0)
    n_results = sum(len(chain) for chain in chains)
    total = max(played.now, 1e-9)
    return Schedule(
        seconds=played.now,
        critical_seconds=critical,
        busy=played.core_seconds / (n_cores * total),
        driver_busy=n_results * driver_seconds / total,
    )


@dataclass
class _Play:
    n_cores: int
    driver_seconds: float
    chains: list[list[Work]]
    now: float = 0.0
    core_seconds: float = 0.0
    _events: list[tuple[float, int, Callable[[], None]]] = field(default_factory=list)
    _order: itertools.count[int] = field(default_factory=itertools.count)
    _waiting: deque[tuple[float, Callable[[], None]]] = field(default_factory=deque)
    _driver_free: float = 0.0
    _n_running: int = 0
    _n_free: int = 0
    _ready: list[tuple[float, int]] = field(default_factory=list)

    def run(self) -> None:
        self._n_free = self.n_cores
        for number in range(len(self.chains)):
            self._make_ready(number)
        self._top_up()
        while self._events:
            self.now, _, happen = heapq.heappop(self._events)
            happen()

    def _at(self, time: float, happen: Callable[[], None]) -> None:
        heapq.heappush(self._events, (time, next(self._order), happen))

    def _make_ready(self, number: int) -> None:
        if left := sum(work.core_seconds for work in self.chains[number]):
            heapq.heappush(self._ready, (-left, number))

    def _top_up(self) -> None:
        while self._ready and self._n_running < QUEUED_PER_CORE * self.n_cores:
            self._n_running += 1
            number = heapq.heappop(self._ready)[1]
            self._round(number, self.chains[number].pop(0))

    def _round(self, number: int, work: Work, n_done: int = 0) -> None:
        """Hand out a round's batches; the last of them to end begins the next round."""
        left = itertools.count(work.n_batches - 1, -1)

        def batch_ended() -> None:
            self._n_free += 1
            self._begin_waiting()
            if next(left):
                return
            if n_done + 1 < work.n_rounds:
                self._at(self.now + work.between_seconds, lambda: self._round(number, work, n_done + 1))
            else:
                self._driver_free = max(self._driver_free, self.now) + self.driver_seconds
                self._at(self._driver_free, lambda: self._taken(number))

        for _ in range(work.n_batches):
            self._waiting.append((work.batch_seconds, batch_ended))
        self._begin_waiting()

    def _begin_waiting(self) -> None:
        while self._waiting and self._n_free:
            self._n_free -= 1
            seconds, ended = self._waiting.popleft()
            self.core_seconds += seconds
            self._at(self.now + seconds + TASK_SECONDS, ended)

    def _taken(self, number: int) -> None:
        self._n_running -= 1
        self._make_ready(number)
        self._top_up()
