"""The time left, and how it is shown with and without a terminal."""

import errno
import io
import os
import pty
import subprocess
import sys
import time

import pytest
from rich.console import Console

from pipeline.commands.terminal import to_stderr
from pipeline.workflow.progress import NOTHING, Pace, StudyTimes, Work, _about, progress


class Clock:
    """A clock that the test moves."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def even(units: float) -> Work:
    """Return work whose units all cost the same."""
    return Work(units, cost=units)


def pace(total: Work, found: Work = NOTHING) -> tuple[Pace, Clock]:
    clock = Clock()
    return Pace("evolve", "generations", total, found, clock=clock), clock


def test_rate_and_time_left_by_hand():
    evolve, clock = pace(total=even(1000))
    clock.now += 20
    evolve.done += even(200)
    assert evolve.rate == 10.0
    assert evolve.seconds_left == 80.0
    assert str(evolve) == "20%, 200/1,000 generations, 10/s, 0:01:20 left"


def test_the_time_left_follows_from_costs():
    """Generations of one environment cost four times those of another, and the expensive ones are done first."""
    evolve, clock = pace(total=Work(200, cost=100 * 1.6 + 100 * 0.4), found=Work(50, cost=50 * 1.6))
    clock.now += 10
    evolve.done += Work(10, cost=10 * 1.6)
    assert evolve.seconds_left == pytest.approx((200 - 96) / 1.6)
    assert str(evolve) == "48%, 60/200 generations, 1/s, 0:01:05 left"


def test_work_done_before_does_not_count_toward_the_rate():
    evolve, clock = pace(total=even(1000), found=even(800))
    clock.now += 10
    assert (evolve.rate, evolve.seconds_left, evolve.fraction) == (0.0, None, 0.8)
    assert str(evolve) == "80%, 800/1,000 generations, 0/s, 0:00:10 so far"
    evolve.done += even(50)
    assert evolve.rate == 5.0
    assert evolve.seconds_left == 30.0


def test_a_finished_stage_shows_how_long_it_took():
    evolve, clock = pace(total=even(50))
    clock.now += 100
    evolve.done = even(50)
    assert str(evolve) == "100%, 50/50 generations, 0.5/s, took 0:01:40"


def test_a_stage_without_work_is_done():
    empty, clock = pace(total=even(0))
    clock.now += 1
    assert empty.fraction == 1.0
    assert "took" in str(empty)


def test_lines_are_printed_now_and_then():
    out = io.StringIO()
    shown = progress(Console(file=out), seconds_between_lines=0.3)
    with shown as show, show.stage("evolve", unit="generations", total=even(100)) as bar:
        for _ in range(10):
            time.sleep(0.05)
            bar.advance(even(10))
        show.say("a word [in brackets] " + "that is long " * 20)
    lines = out.getvalue().splitlines()
    progressing = [line for line in lines if line.startswith("evolve: ")]
    assert len(progressing) >= 3  # at the start, at least once in 0.5 s, at the end
    assert progressing[0].startswith("evolve: 0%, 0/100 generations")
    assert " left" in progressing[1]
    assert progressing[-1].startswith("evolve: 100%, 100/100 generations")
    assert "a word [in brackets] " + "that is long " * 20 in lines  # neither interpreted nor wrapped


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_stage_that_fails_shows_how_far_it_got(error):
    out = io.StringIO()
    with pytest.raises(error), progress(Console(file=out)) as show:  # noqa: SIM117
        with show.stage("evolve", unit="generations", total=even(100), done=even(20)) as bar:
            bar.advance(even(30))
            raise error
    assert out.getvalue().splitlines()[-1].startswith("evolve: 50%, 50/100 generations")


SCRIPT = """
import time
from pipeline.workflow.progress import Work, progress
with progress() as show:
    with show.stage("evolve", unit="generations", total=Work(8, cost=8)) as bar:
        for k in range(8):
            if k == 4:
                show.say("half way")
            time.sleep(0.2)
            bar.advance(Work(1, cost=1))
print("result")
"""


class ClosedTerminal(io.StringIO):
    """What a process finds whose terminal was closed, if it ignores the signal for that (`nohup`, `disown`)."""

    def write(self, text: str) -> int:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    def flush(self) -> None:
        self.write("")


@pytest.mark.parametrize("is_terminal", [True, False])
def test_work_goes_on_without_a_terminal(is_terminal, monkeypatch):
    console = Console(file=ClosedTerminal(), force_terminal=is_terminal)
    with progress(console, seconds_between_lines=0) as show, show.stage("evolve", unit="items", total=even(2)) as bar:
        show.say("starting the cluster")
        bar.advance(even(2))
    monkeypatch.setattr(sys, "stderr", ClosedTerminal())
    to_stderr("2 chains of work failed")


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "TERM": "xterm-256color", "COLUMNS": "120"}


def test_without_a_terminal_plain_lines_on_stderr():
    ran = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment(), capture_output=True, text=True, timeout=60, check=True
    )
    assert ran.stdout == "result\n"
    assert "\x1b" not in ran.stderr and "\r" not in ran.stderr
    first, said, last = ran.stderr.splitlines()
    assert first.startswith("evolve: 0%, 0/8 generations")
    assert said == "half way"
    assert last.startswith("evolve: 100%, 8/8 generations, ") and "took 0:00:0" in last


def test_on_a_terminal_a_bar_that_is_redrawn():
    terminal, inner = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT], env=environment(), stdin=inner, stdout=subprocess.PIPE, stderr=inner
    )
    os.close(inner)
    shown = b""
    while True:
        try:
            data = os.read(terminal, 4096)
        except OSError:  # the other end is closed
            break
        if not data:
            break
        shown += data
    out, _ = process.communicate(timeout=60)
    os.close(terminal)
    text = shown.decode()
    assert process.returncode == 0
    assert out == b"result\n"
    assert text.count("━") > 30
    assert text.count(" left") >= 3  # drawn again and again
    assert "half way" in text
    assert "\x1b[?25l" in text and text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l")  # the cursor is given back
    assert "evolve: 100%, 8/8 generations" in text


def test_weighted_units_that_do_not_add_up_exactly_are_a_whole_stage():
    """Ten tenths of a stage are a rounding error short of it, and still shown as 100 % with no time left."""
    evolve, clock = pace(total=even(1.0))
    clock.now += 10
    for _ in range(10):
        evolve.done += even(0.1)
    assert evolve.done.cost != 1.0
    assert str(evolve) == "100%, 1/1 generations, 0.1/s, took 0:00:10"
    evolve.done = even(1.0 + 1e-12)  # and as little beyond
    assert evolve.fraction == 1.0 and evolve.seconds_left == 0.0
    assert "took" in str(evolve)
    evolve.done = even(0.999)
    assert "left" in str(evolve)


def test_work_beside_the_units_is_not_counted_in_them():
    """Scoring champions without adapting them is a tenth of a generation: "0.094/0.094 generations" says nothing."""
    scoring, clock = pace(total=Work(0.094, cost=0.094))
    clock.now += 2
    scoring.done += Work(0.047, cost=0.047)
    assert str(scoring) == "50%, 0:00:02 left"
    scoring.done += Work(0.047, cost=0.047)
    assert str(scoring) == "100%, took 0:00:02"


def test_counts_are_whole_numbers():
    transfer, clock = pace(total=even(8.094))
    clock.now += 2
    transfer.done += even(4.094)
    assert str(transfer).startswith("51%, 4/8 generations, 2/s, ")


STUDY = StudyTimes(("train", "evolve", "report"), {"train": 60.0, "evolve": 600.0, "report": 60.0})


def test_the_time_left_for_a_study_adds_the_stages_to_come():
    clock = Clock()
    evolve = Pace("evolve", "generations", even(100), NOTHING, STUDY, clock=clock)
    assert str(evolve) == "0%, 0/100 generations, 0/s, 0:10:00 left; study: about 11 min left"  # as expected
    clock.now += 60
    evolve.advance(even(50))
    assert str(evolve) == "50%, 50/100 generations, 0.83/s, 0:01:00 left; study: about 2 min left"  # by its rate
    report = Pace("report", "pictures", even(10), NOTHING, STUDY, clock=clock)
    assert str(report) == "0%, 0/10 pictures, 0/s, 0:01:00 left"  # it is the last


def test_a_line_names_the_stage_and_the_time_left_for_the_study():
    out = io.StringIO()
    with progress(Console(file=out), seconds_between_lines=0) as show:  # noqa: SIM117
        with show.stage("evolve", unit="generations", total=even(10), study=STUDY) as bar:
            bar.advance(even(5))
            bar.advance(even(5))
    first, half, done = out.getvalue().splitlines()
    assert first.startswith("stage 2 of 3, evolve: 0%, 0/10 generations, ") and "; study: about 11 min left" in first
    assert "study: about" in half and done.startswith("stage 2 of 3, evolve: 100%, 10/10 generations")


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.2, "1 s"), (89, "89 s"), (90, "2 min"), (3600, "60 min"), (7200, "2.0 h")]
)
def test_an_estimate_is_coarse(seconds, text):
    assert _about(seconds) == text
