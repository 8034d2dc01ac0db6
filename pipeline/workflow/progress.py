"""Progress of a stage: the share done, and the time left.

A terminal shows a bar; anything else (a log, a pipe, a batch job) gets a line now and then. Both go to standard error,
so that results on standard output can be piped. The count is in units, but the share done and the time left follow
their cost, because some units cost ten times as much as others.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as RichProgress

_BAR_WIDTH = 30
_ROUNDING = 1e-9  # relative error of a sum of costs


@dataclass(frozen=True)
class Work:
    """An amount of work."""

    units: float = 0.0  # number of units, such as generations
    cost: float = 0.0  # relative to that of other work of the same stage

    def __add__(self, other: Work) -> Work:
        return Work(self.units + other.units, self.cost + other.cost)

    def __sub__(self, other: Work) -> Work:
        return Work(self.units - other.units, self.cost - other.cost)


NOTHING = Work()


@dataclass
class Pace:
    """Work done so far, and the time left that follows from it."""

    unit: str
    total: Work
    found: Work = NOTHING  # work done before the stage started
    changed: Callable[[], None] = lambda: None
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        self.done, self.start = self.found, self.clock()

    def advance(self, work: Work) -> None:
        """Count work just done."""
        self.done += work
        self.changed()

    @property
    def fraction(self) -> float:
        """Share of the cost that is done, from 0 to 1."""
        left = self.total.cost - self.done.cost
        return 1.0 if left <= _ROUNDING * self.total.cost else self.done.cost / self.total.cost

    def __str__(self) -> str:
        seconds, since = self.clock() - self.start, self.done.cost - self.found.cost
        text = f"{self.fraction:.0%}"
        if self.total.units >= 1:  # less than one unit is work beside the units, such as scoring what was made of them
            text += f", {int(self.done.units + _ROUNDING):,}/{int(self.total.units + _ROUNDING):,} {self.unit}"
        if self.fraction == 1.0:
            return f"{text}, took {_duration(seconds)}"
        if since <= 0:
            return f"{text}, {_duration(seconds)} so far"
        return f"{text}, {_duration(seconds * (self.total.cost - self.done.cost) / since)} left"


def _duration(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


@dataclass
class Progress:
    """Shows progress to the user: bars where there is a terminal, else lines now and then."""

    console: Console
    bars: RichProgress
    seconds_between_lines: float
    last: float = -float("inf")

    def say(self, line: str) -> None:
        """Show a line that stays, above any bar."""
        self.console.print(line, markup=False, soft_wrap=True)

    @contextmanager
    def stage(self, name: str, *, unit: str, total: Work, done: Work = NOTHING) -> Iterator[Pace]:
        """Return a context manager that shows a stage while it runs, and gives the bar to advance.

        Args:
            name: the stage's name.
            unit: unit of work, in the plural.
            total: work of the whole stage, including what is done.
            done: work that the store already has.
        """
        pace = Pace(unit, total, done)
        task = self.bars.add_task(name, total=1.0, pace=pace)

        def show() -> None:
            self.bars.update(task, completed=pace.fraction)
            due = self.last + self.seconds_between_lines
            if self.bars.disable and pace.fraction < 1.0 and pace.clock() >= due:
                self.last = pace.clock()
                self.say(f"{name}: {pace}")

        pace.changed = show
        show()
        try:
            yield pace
        finally:
            self.bars.remove_task(task)
            self.bars.refresh()
            self.say(f"{name}: {pace}")


@contextmanager
def progress(console: Console | None = None, *, seconds_between_lines: float = 10.0) -> Iterator[Progress]:
    """Show progress on a console, standard error by default."""
    console = console or Console(stderr=True, highlight=False)
    place, pace = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[pace]}"))
    no_bars = not console.is_interactive  # no terminal, or one that can't move its cursor
    with RichProgress(
        place, BarColumn(_BAR_WIDTH), pace, console=console, redirect_stdout=False, disable=no_bars
    ) as bars:
        yield Progress(console, bars, seconds_between_lines)
