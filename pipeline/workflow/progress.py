"""Progress of a stage: the share done, the rate, and the time left for it and for the whole study.

A terminal shows a bar; anything else (a log, a pipe, a batch job) gets a line now and then. Both go to standard error,
so that results on standard output can be piped. The count is in units, but the share done and the time left follow
their cost, because some units cost ten times as much as others. Work that the store already has counts as done, but
not toward the rate.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
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


@dataclass(frozen=True)
class StudyTimes:
    """How long the stages of a study that are to run should take [s]."""

    stages: tuple[str, ...] = ()  # names of all stages, in order
    expected: Mapping[str, float] = field(default_factory=dict)  # of what is left of each stage that is to run

    def place(self, stage: str) -> str:
        """Return which of the stages one is."""
        return f"stage {self.stages.index(stage) + 1} of {len(self.stages)}, {stage}" if self.stages else stage

    def later(self, stage: str) -> float:
        """Return the time of the stages after one [s]."""
        after = self.stages[self.stages.index(stage) + 1 :] if self.stages else ()
        return sum(self.expected.get(name, 0.0) for name in after)


@dataclass
class Pace:
    """Work done so far, and the rate and time that follow from it."""

    name: str
    unit: str
    total: Work
    found: Work = NOTHING  # work done before the stage started
    study: StudyTimes = StudyTimes()
    changed: Callable[[], None] = lambda: None
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        self.done, self.start = self.found, self.clock()

    def advance(self, work: Work) -> None:
        """Count work just done."""
        self.done += work
        self.changed()

    @property
    def seconds(self) -> float:
        """Time since the stage started [s]."""
        return self.clock() - self.start

    @property
    def rate(self) -> float:
        """Units per second since the stage started; 0 until some are done."""
        return (self.done - self.found).units / self.seconds if self.seconds > 0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Time left [s]: by the work done so far, or as expected until some is; None where nothing was expected."""
        since, left = (self.done - self.found).cost, max(0.0, (self.total - self.done).cost)
        return left / since * self.seconds if since > 0 else self.study.expected.get(self.name)

    @property
    def fraction(self) -> float:
        """Share of the cost that is done, from 0 to 1."""
        return min(1.0, self.done.cost / self.total.cost) if self.total.cost > 0 else 1.0

    @property
    def finished(self) -> bool:
        """Whether all of the work is done."""
        return self.fraction >= 1 - _ROUNDING

    def __str__(self) -> str:
        text = f"{self.fraction:.0%}"
        if self.total.units >= 1:  # less than one unit is work beside the units, such as scoring what was made of them
            counts = (_count(int(work.units + _ROUNDING)) for work in (self.done, self.total))
            text += f", {'/'.join(counts)} {self.unit}, {_count(self.rate)}/s"
        if self.finished:
            return f"{text}, took {_duration(self.seconds)}"
        if self.seconds_left is None:
            return f"{text}, {_duration(self.seconds)} so far"
        later = self.study.later(self.name)
        study_left = f"; study: about {_about(self.seconds_left + later)} left" if later else ""
        return f"{text}, {_duration(self.seconds_left)} left{study_left}"


def _count(units: float) -> str:
    return f"{units:,.0f}" if units >= 10 else f"{units:.2g}"


def _about(seconds: float) -> str:
    """Write an estimate in the coarse unit that a person thinks in."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{round(seconds / 60)} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _duration(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


@dataclass
class Progress:
    """Shows progress to the user: bars where there is a terminal, else lines now and then."""

    console: Console
    seconds_between_lines: float
    bars: RichProgress | None
    last: float = -float("inf")

    def say(self, line: str) -> None:
        """Show a line that stays, above any bar."""
        self.console.print(line, markup=False, soft_wrap=True)

    @contextmanager
    def stage(
        self, name: str, *, unit: str, total: Work, done: Work = NOTHING, study: StudyTimes | None = None
    ) -> Iterator[Pace]:
        """Return a context manager that shows a stage while it runs, and gives the bar to advance.

        Args:
            name: the stage's name.
            unit: unit of work, in the plural.
            total: work of the whole stage, including what is done.
            done: work that the store already has.
            study: the study that the stage belongs to, if it is one of a study's.
        """
        pace = Pace(name, unit, total, done, study or StudyTimes())
        place = pace.study.place(name)
        task = self.bars.add_task(place, total=1.0, pace=pace) if self.bars else None

        def show() -> None:
            if self.bars and task is not None:
                self.bars.update(task, completed=pace.fraction)
            elif not pace.finished and pace.clock() - self.last >= self.seconds_between_lines:
                self.last = pace.clock()
                self.say(f"{place}: {pace}")

        pace.changed = show
        show()
        try:
            yield pace
        finally:
            if self.bars and task is not None:
                self.bars.remove_task(task)
                self.bars.refresh()
            self.say(f"{place}: {pace}")


@contextmanager
def progress(console: Console | None = None, *, seconds_between_lines: float = 10.0) -> Iterator[Progress]:
    """Show progress on a console, standard error by default."""
    console = console or Console(stderr=True, highlight=False)
    if not console.is_interactive:  # no terminal, or one that can't move its cursor
        yield Progress(console, seconds_between_lines, None)
        return
    place, pace = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[pace]}"))
    with RichProgress(place, BarColumn(_BAR_WIDTH), pace, console=console, redirect_stdout=False) as bars:
        yield Progress(console, seconds_between_lines, bars)
