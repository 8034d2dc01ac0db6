"""How far a stage has got, at what rate, and how long it will take.

On a terminal a bar; elsewhere (a log, a pipe, a batch job) a plain line now and then. Both go to standard error, so
that results on standard output can be piped. What is counted is units, but the share done and the time left are those
of their cost: where one unit costs ten times another, the one would mislead. What was found done in the store counts as
done but not toward the rate.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Protocol

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

SECONDS_BETWEEN_LINES = 10.0
"""How often a line may be printed where there is no terminal."""

FRAMES_PER_SECOND = 4.0
"""How often the bar is drawn where there is one: often enough for the eye, too seldom to matter."""

BAR_WIDTH = 30

ROUNDING = 1e-9
"""Share of the total by which a sum of costs may miss it."""


@dataclass(frozen=True)
class Work:
    """An amount of work."""

    units: float = 0.0
    """As a person counts it, such as generations."""
    cost: float = 0.0
    """In units of average cost."""

    def __add__(self, other: Work) -> Work:
        return Work(self.units + other.units, self.cost + other.cost)

    def __sub__(self, other: Work) -> Work:
        return Work(self.units - other.units, self.cost - other.cost)


NOTHING = Work()


class Bar(Protocol):
    """A stage's progress, as the work sees it."""

    def advance(self, work: Work) -> None:
        """Count work just done."""


class Progress(Protocol):
    """What shows progress."""

    def say(self, line: str) -> None:
        """Show a line that stays, above any bar."""

    @contextmanager
    def stage(self, name: str, *, unit: str, total: Work, done: Work = NOTHING) -> Iterator[Bar]:
        """Show a stage while it runs.

        Args:
            name: of the stage.
            unit: what its work is counted in, in the plural.
            total: work of the whole stage, what is done already included.
            done: work found done.
        """


@dataclass
class Pace:
    """Work done so far, and what follows from it."""

    name: str
    unit: str
    total: Work
    found: Work
    """Work found done when the stage began."""
    clock: Callable[[], float] = time.monotonic
    done: Work = field(init=False)
    start: float = field(init=False)

    def __post_init__(self) -> None:
        self.done = self.found
        self.start = self.clock()

    @property
    def seconds(self) -> float:
        """Since the stage began."""
        return self.clock() - self.start

    @property
    def rate(self) -> float:
        """Units a second, of the work done since the stage began; 0 until some is."""
        return (self.done - self.found).units / self.seconds if self.seconds > 0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """None until there is a pace to tell from."""
        since = (self.done - self.found).cost
        return max(0.0, (self.total - self.done).cost) / since * self.seconds if since > 0 else None

    @property
    def fraction(self) -> float:
        """Of the cost, from 0 to 1."""
        return min(1.0, self.done.cost / self.total.cost) if self.total.cost > 0 else 1.0

    def __str__(self) -> str:
        counts = f"{self.fraction:.0%}, {_count(self.done.units)}/{_count(self.total.units)} {self.unit}"
        if self.fraction >= 1 - ROUNDING:
            return f"{counts}, {_count(self.rate)}/s, took {_duration(self.seconds)}"
        if self.seconds_left is None:
            return f"{counts}, {_duration(self.seconds)} so far"
        return f"{counts}, {_count(self.rate)}/s, {_duration(self.seconds_left)} left"


def _count(units: float) -> str:
    return f"{units:,.0f}" if units >= 10 else f"{units:.2g}"


def _duration(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


@contextmanager
def progress(console: Console | None = None) -> Iterator[Progress]:
    """Show progress on a console, standard error by default: bars if it is a terminal, else lines now and then."""
    console = console or Console(stderr=True, highlight=False)
    if not console.is_interactive:  # no terminal, or one that can't move its cursor
        yield _Lines(console)
        return
    with Live(console=console, refresh_per_second=FRAMES_PER_SECOND, redirect_stdout=False) as live:
        yield _Bars(live)


class _Bars:
    """Progress on a terminal."""

    def __init__(self, live: Live) -> None:
        self._live = live

    def say(self, line: str) -> None:
        self._live.console.print(line, markup=False)

    @contextmanager
    def stage(self, name: str, *, unit: str, total: Work, done: Work = NOTHING) -> Iterator[Bar]:
        pace = Pace(name, unit, total, done)
        self._live.update(_Drawing(pace))
        try:
            yield _Counter(pace, lambda: None)  # the live display draws by itself
        finally:
            self._live.update(Group())
            self.say(f"{name}: {pace}")


@dataclass(frozen=True)
class _Drawing:
    """A bar that says the time left as it is when it is drawn."""

    pace: Pace

    def __rich__(self) -> Text:
        n_full = round(BAR_WIDTH * self.pace.fraction)
        full, empty = "━" * n_full, "─" * (BAR_WIDTH - n_full)
        return Text.assemble(f"{self.pace.name:<9} ", (full, "cyan"), (empty, "dim"), f" {self.pace}")


class _Lines:
    """Progress where there is no terminal."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._last = -float("inf")

    def say(self, line: str) -> None:
        self._console.print(line, markup=False, soft_wrap=True)

    @contextmanager
    def stage(self, name: str, *, unit: str, total: Work, done: Work = NOTHING) -> Iterator[Bar]:
        pace = Pace(name, unit, total, done)

        def now_and_then() -> None:
            if pace.fraction < 1 - ROUNDING and pace.clock() - self._last >= SECONDS_BETWEEN_LINES:
                self._last = pace.clock()
                self.say(f"{name}: {pace}")

        now_and_then()
        try:
            yield _Counter(pace, now_and_then)
        finally:
            self.say(f"{name}: {pace}")


@dataclass(frozen=True)
class _Counter:
    pace: Pace
    changed: Callable[[], None]

    def advance(self, work: Work) -> None:
        self.pace.done += work
        self.changed()
