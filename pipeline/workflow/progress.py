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
from dataclasses import dataclass
from datetime import timedelta
from typing import IO, Any, Protocol, cast

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from pipeline.text import printable

_BAR_FPS, _BAR_WIDTH = 4.0, 30
_ROUNDING = 1e-9  # relative error of a sum of costs
_TRUSTED_SECONDS = 60.0  # the expected times of stages count as much as this long a run [s]


@dataclass(frozen=True)
class Work:
    """An amount of work."""

    units: float = 0.0  # number of units, such as generations
    cost: float = 0.0  # cost, in units of average cost

    def __add__(self, other: Work) -> Work:
        return Work(self.units + other.units, self.cost + other.cost)

    def __sub__(self, other: Work) -> Work:
        return Work(self.units - other.units, self.cost - other.cost)


NOTHING = Work()


class Bar(Protocol):
    """A stage's progress, as seen by the work."""

    def advance(self, work: Work) -> None:
        """Count work just done."""


class Progress(Protocol):
    """Shows progress to the user."""

    def say(self, line: str) -> None:
        """Show a line that stays, above any bar."""

    @contextmanager
    def stage(
        self, name: str, *, unit: str, total: Work, done: Work = NOTHING, study: StudyPace | None = None
    ) -> Iterator[Bar]:
        """Return a context manager that shows a stage while it runs, and gives the bar to advance.

        Args:
            name: the stage's name.
            unit: unit of work, in the plural.
            total: work of the whole stage, including what is done.
            done: work that the store already has.
            study: the study that the stage belongs to, if it is one of a study's.
        """


@dataclass
class StudyPace:
    """The time left for a study: the expected times of its stages, corrected by how long they really take."""

    stages: tuple[str, ...]  # names of all stages, in order
    expected: Mapping[str, float]  # time of every stage that is to run [s]
    took: float = 0.0  # time of the stages that have run [s]
    should_have_taken: float = 0.0  # what was expected for the work that they did [s]

    def place(self, stage: str) -> str:
        """Return which of the stages one is."""
        return f"stage {self.stages.index(stage) + 1} of {len(self.stages)}, {stage}"

    def seconds_left(self, stage: Pace) -> float | None:
        """Return the time left for a stage and those after it [s]; None if those after it are not to run."""
        later = [self.expected.get(name, 0.0) for name in self.stages[self.stages.index(stage.name) + 1 :]]
        if later and not any(later):
            return None
        left = self.expected_left(stage) if stage.seconds_left is None else stage.seconds_left
        return left + sum(later) * self._slowness(stage)

    def expected_left(self, stage: Pace) -> float:
        """Return the time left for a stage by its expected time, corrected by how long the work really takes [s]."""
        return (1 - stage.fraction) * self.expected.get(stage.name, 0.0) * self._slowness(stage)

    def finish(self, stage: Pace) -> None:
        """Learn from a stage that has ended."""
        self.should_have_taken += self._expected_so_far(stage)
        self.took += stage.seconds

    def _slowness(self, stage: Pace) -> float:
        trust = _TRUSTED_SECONDS + 0.05 * sum(self.expected.values())
        return (self.took + stage.seconds + trust) / (self.should_have_taken + self._expected_so_far(stage) + trust)

    def _expected_so_far(self, stage: Pace) -> float:
        found = stage.found.cost / stage.total.cost if stage.total.cost > 0 else 0.0
        return max(0.0, stage.fraction - found) * self.expected.get(stage.name, 0.0)


@dataclass
class Pace:
    """Work done so far, and the rate and time that follow from it."""

    name: str
    unit: str
    total: Work
    found: Work  # work done before the stage started
    study: StudyPace | None = None
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        self.done, self.start = self.found, self.clock()

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
        """Time left [s]; None until some work is done.

        Where a time was expected, the rate so far counts in proportion to the work done: the first items of a study may
        wait for kernels.
        """
        since, left = (self.done - self.found).cost, max(0.0, (self.total - self.done).cost)
        if since <= 0:
            return None
        measured = left / since * self.seconds
        expected = self.study.expected_left(self) if self.study else 0.0
        share = since / (since + left) if expected > 0 else 1.0
        return share * measured + (1 - share) * expected

    @property
    def fraction(self) -> float:
        """Share of the cost that is done, from 0 to 1."""
        return min(1.0, self.done.cost / self.total.cost) if self.total.cost > 0 else 1.0

    @property
    def place(self) -> str:
        """The stage's name, and which of the study's stages it is."""
        return self.study.place(self.name) if self.study else self.name

    @property
    def study_left(self) -> str:
        """The time left for the whole study in words; empty if only this stage is to run."""
        seconds = self.study.seconds_left(self) if self.study else None
        return "" if seconds is None else f"study: about {_about(seconds)} left"

    def __str__(self) -> str:
        counts = f"{self.fraction:.0%}"
        if self.total.units >= 1:  # less than one unit is work beside the units, such as scoring what was made of them
            counts += (
                f", {_count(int(self.done.units + _ROUNDING))}/{_count(int(self.total.units + _ROUNDING))} {self.unit}"
            )
        rate = f", {_count(self.rate)}/s" if self.total.units >= 1 else ""
        if self.fraction >= 1 - _ROUNDING:
            return f"{counts}{rate}, took {_duration(self.seconds)}"
        if self.seconds_left is None:
            return f"{counts}, {_duration(self.seconds)} so far"
        return f"{counts}{rate}, {_duration(self.seconds_left)} left"


def _count(units: float) -> str:
    return f"{units:,.0f}" if units >= 10 else f"{units:.2g}"


def _about(seconds: float) -> str:
    """Write an estimate in the coarse unit that a person thinks in."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{round(seconds / 60)} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _duration(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


@contextmanager
def progress(console: Console | None = None, *, seconds_between_lines: float = 10.0) -> Iterator[Progress]:
    """Show progress on a console, standard error by default: bars if it is a terminal, else lines now and then."""
    console = console or Console(stderr=True, highlight=False)
    console.file = cast(IO[str], _Tolerant(console.file))
    if not console.is_interactive:  # no terminal, or one that can't move its cursor
        yield _Lines(console, seconds_between_lines)
        return
    with Live(console=console, refresh_per_second=_BAR_FPS, redirect_stdout=False) as live:
        yield _Bars(live)


class _Tolerant:
    """A stream that drops what can't be written: a study goes on when its terminal is closed or its log's disk full.

    A pipe without a reader still raises BrokenPipeError.
    """

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with _dropped():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with _dropped():
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def _dropped() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError:
        pass


class _Bars:
    """Progress on a terminal."""

    def __init__(self, live: Live) -> None:
        self._live = live

    def say(self, line: str) -> None:
        self._live.console.print(printable(line), markup=False)

    @contextmanager
    def stage(
        self, name: str, *, unit: str, total: Work, done: Work = NOTHING, study: StudyPace | None = None
    ) -> Iterator[Bar]:
        pace = Pace(name, unit, total, done, study)
        self._live.update(_Drawing(pace))
        try:
            yield _Counter(pace)  # the live display draws by itself
        finally:
            self._live.update(Group())
            _conclude(pace, self.say)


@dataclass(frozen=True)
class _Drawing:
    """A bar that computes the time left whenever it is drawn."""

    pace: Pace

    def __rich__(self) -> Text:
        n_full = round(_BAR_WIDTH * self.pace.fraction)
        full, empty = "━" * n_full, "─" * (_BAR_WIDTH - n_full)
        bar = Text.assemble(f"{self.pace.place:<9} ", (full, "cyan"), (empty, "dim"))
        if self.pace.study is None:
            return bar.append(f" {self.pace}")
        study_left = self.pace.study_left
        return bar.append(f"  {study_left}\n  {self.pace}" if study_left else f"\n  {self.pace}")


def _conclude(pace: Pace, say: Callable[[str], None]) -> None:
    say(f"{pace.place}: {pace}")
    if pace.study is not None:
        pace.study.finish(pace)


class _Lines:
    """Progress where there is no terminal."""

    def __init__(self, console: Console, seconds_between_lines: float) -> None:
        self._console, self._seconds_between_lines = console, seconds_between_lines
        self._last = -float("inf")

    def say(self, line: str) -> None:
        self._console.print(printable(line), markup=False, soft_wrap=True)

    @contextmanager
    def stage(
        self, name: str, *, unit: str, total: Work, done: Work = NOTHING, study: StudyPace | None = None
    ) -> Iterator[Bar]:
        pace = Pace(name, unit, total, done, study)

        def now_and_then() -> None:
            if pace.fraction < 1 - _ROUNDING and pace.clock() - self._last >= self._seconds_between_lines:
                self._last = pace.clock()
                self.say("; ".join(filter(None, [f"{pace.place}: {pace}", pace.study_left])))

        now_and_then()
        try:
            yield _Counter(pace, now_and_then)
        finally:
            _conclude(pace, self.say)


@dataclass(frozen=True)
class _Counter:
    pace: Pace
    changed: Callable[[], None] = lambda: None

    def advance(self, work: Work) -> None:
        self.pace.done += work
        self.changed()
