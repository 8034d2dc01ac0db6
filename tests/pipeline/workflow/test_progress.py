"""The time left, and how it is shown with and without a terminal."""

import contextlib
import io
import os
import pty
import subprocess
import sys
import time

import pytest
from rich.console import Console

from pipeline.workflow.progress import progress


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_stage_that_fails_shows_how_far_it_got(error):
    out = io.StringIO()
    with pytest.raises(error), progress(Console(file=out)) as show:  # noqa: SIM117
        with show.stage("evolve", total=100, done=20) as advance:
            advance(30)
            raise error
    assert out.getvalue().splitlines()[-1].startswith("evolve: 50%, took 0:00:0")


SCRIPT = """
import time
from pipeline.workflow.progress import progress
with progress() as show:
    with show.stage("evolve", total=8) as advance:
        for k in range(8):
            if k == 4:
                show.say("half way")
            time.sleep(0.2)
            advance(1)
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
    assert text.count("evolve") >= 3  # drawn again and again
    assert "half way" in text
    assert "\x1b[?25l" in text and text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l")  # the cursor is given back
    assert "evolve: 100%, took 0:00:0" in text


def test_without_a_terminal_lines_now_and_then():
    out = io.StringIO()
    with progress(Console(file=out), seconds_between_lines=0) as show:  # noqa: SIM117
        with show.stage("stage 2 of 3, evolve", total=10, later=90.0) as advance:
            advance(2)
            time.sleep(1.0)
            advance(3)  # at 3 a second
            show.say("a word [in brackets] " + "that is long " * 20)
            advance(5)
    first, half, said, done = out.getvalue().splitlines()
    assert first == "stage 2 of 3, evolve: 20%" and done == "stage 2 of 3, evolve: 100%, took 0:00:01"
    assert half == "stage 2 of 3, evolve: 50%, 0:00:02 left; then 0:01:30"
    assert said == "a word [in brackets] " + "that is long " * 20  # neither interpreted nor wrapped
