"""The time left, and how it is shown with and without a terminal."""

import contextlib
import io
import os
import pty
import subprocess
import sys

import pytest
from rich.console import Console

from pipeline.workflow.progress import NOTHING, Pace, Work, progress


def even(units: float) -> Work:
    """Return work whose units all cost the same."""
    return Work(units, cost=units)


@pytest.mark.parametrize(
    ("total", "found", "done", "seconds", "text"),
    [
        (even(1000), NOTHING, even(200), 20, "20%, 200/1,000 generations, 0:01:20 left"),
        # 100 generations that cost 1.6 and 100 that cost 0.4, the expensive ones first: 104 / 1.6 s are left
        (Work(200, 200), Work(50, 80), Work(10, 16), 10, "48%, 60/200 generations, 0:01:05 left"),
        # what the store had does not count toward the rate
        (even(1000), even(800), NOTHING, 10, "80%, 800/1,000 generations, 0:00:10 so far"),
        (even(1000), even(800), even(50), 10, "85%, 850/1,000 generations, 0:00:30 left"),
        (even(50), NOTHING, even(50), 100, "100%, 50/50 generations, took 0:01:40"),
        (even(0), NOTHING, NOTHING, 1, "100%, took 0:00:01"),
        # ten tenths add up to a rounding error less than a stage
        (even(1), NOTHING, even(sum([0.1] * 10)), 10, "100%, 1/1 generations, took 0:00:10"),
        (even(1), NOTHING, even(1 + 1e-12), 10, "100%, 1/1 generations, took 0:00:10"),
        # less than a unit is work beside the units, such as scoring
        (even(0.094), NOTHING, even(0.047), 2, "50%, 0:00:02 left"),
        (even(8.094), NOTHING, even(4.094), 2, "51%, 4/8 generations, 0:00:02 left"),
    ],
)
def test_the_share_done_the_rate_and_the_time_left(total, found, done, seconds, text):
    now = [100.0]
    evolve = Pace("generations", total, found, clock=lambda: now[0])
    now[0] += seconds
    evolve.advance(done)
    assert str(evolve) == text
    assert 0 <= evolve.fraction <= 1


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


def test_on_a_terminal_a_bar_that_is_redrawn():
    terminal, inner = pty.openpty()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "TERM": "xterm-256color", "COLUMNS": "120"}
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT], env=environment, stdin=inner, stdout=subprocess.PIPE, stderr=inner
    )
    os.close(inner)
    text = b""
    with contextlib.suppress(OSError):  # the other end is closed
        while data := os.read(terminal, 4096):
            text += data
    out, _ = process.communicate(timeout=60)
    os.close(terminal)
    text = text.decode()
    assert (process.returncode, out) == (0, b"result\n")
    assert text.count("━") > 30
    assert text.count(" left") >= 3  # drawn again and again
    assert "half way" in text
    assert "\x1b[?25l" in text and text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l")  # the cursor is given back
    assert "evolve: 100%, 8/8 generations" in text


def test_without_a_terminal_lines_now_and_then():
    out = io.StringIO()
    with progress(Console(file=out), seconds_between_lines=0) as show:  # noqa: SIM117
        with show.stage("stage 2 of 3, evolve", unit="generations", total=even(10)) as bar:
            bar.advance(even(5))
            show.say("a word [in brackets] " + "that is long " * 20)
            bar.advance(even(5))
    first, half, said, done = out.getvalue().splitlines()
    assert first.startswith("stage 2 of 3, evolve: 0%, 0/10 generations, ") and half.endswith(" left")
    assert done.startswith("stage 2 of 3, evolve: 100%, 10/10 generations")
    assert said == "a word [in brackets] " + "that is long " * 20  # neither interpreted nor wrapped
