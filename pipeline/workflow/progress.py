"""Progress of a stage: the share of its work that is done, and the time left for it and for the study.

A terminal shows a bar; anything else (a log, a pipe, a batch job) gets a line now and then. Both go to standard error,
so that results on standard output can be piped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

_SECONDS_OF_PACE = 3600.0  # time over which the pace is a mean [s]: items may take minutes


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
    def stage(
        self, name: str, *, total: float, done: float = 0.0, later: float = 0.0
    ) -> Iterator[Callable[[float], None]]:
        """Return a context manager that shows a stage while it runs, and gives what counts work just done.

        Args:
            total: cost of the whole stage, including what is done.
            done: cost of the work that the store already has.
            later: time that the stages after it should take [s].
        """
        after = f"; then {timedelta(seconds=round(later))}" if later else ""
        number = self.bars.add_task(name, total=total, after=after)
        self.bars.update(number, completed=done)
        (task,) = (one for one in self.bars.tasks if one.id == number)

        def advance(work: float) -> None:
            self.bars.advance(number, work)
            if self.bars.disable and not task.finished and time.monotonic() >= self.last + self.seconds_between_lines:
                self.last = time.monotonic()
                seconds = task.time_remaining
                left = "" if seconds is None else f", {timedelta(seconds=round(seconds))} left{after}"
                self.say(f"{name}: {task.percentage:.0f}%{left}")

        try:
            yield advance
        finally:
            self.bars.remove_task(number)
            self.bars.refresh()
            self.say(f"{name}: {task.percentage:.0f}%, took {timedelta(seconds=round(task.elapsed or 0.0))}")


@contextmanager
def progress(console: Console | None = None, *, seconds_between_lines: float = 10.0) -> Iterator[Progress]:
    """Show progress on a console, standard error by default."""
    console = console or Console(stderr=True, highlight=False)
    with RichProgress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[after]}", markup=False),
        console=console,
        redirect_stdout=False,
        speed_estimate_period=_SECONDS_OF_PACE,
        disable=not console.is_interactive,  # no terminal, or one that can't move its cursor
    ) as bars:
        yield Progress(console, bars, seconds_between_lines)
