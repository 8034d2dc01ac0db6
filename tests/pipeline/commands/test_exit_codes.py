"""The exit codes of docs/reliability.md, seen from outside."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from command_line import call, refused

from pipeline.commands.app import _PANELS, main
from pipeline.commands.terminal import DEFECT, INCOMPLETE, INTERRUPTED, OUTPUT_CLOSED, USER_ERROR, Commands

ROOT = Path(__file__).parents[3]
COMMANDS = [name for commands in _PANELS.values() for name in commands] + ["servo", "servo play", "servo calibrate"]


def to_a_closed_pipe(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a command whose output has no reader."""
    command = [sys.executable, "-m", "pipeline", *words]
    reader, writer = os.pipe()
    os.close(reader)
    try:
        return subprocess.run(command, cwd=ROOT, stdout=writer, stderr=subprocess.PIPE, text=True)
    finally:
        os.close(writer)


def test_the_documentation_lists_every_code():
    table = (ROOT / "docs" / "reliability.md").read_text().partition("## Exit codes")[2].partition("\n## ")[0]
    listed = {int(code) for codes in re.findall(r"^\| ([\d, ]+) \|", table, flags=re.M) for code in codes.split(",")}
    signals = {128 + number for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)}
    assert listed == {0, INCOMPLETE, USER_ERROR, DEFECT, OUTPUT_CLOSED} | signals and INTERRUPTED in signals


@pytest.mark.parametrize("command", COMMANDS)
def test_help_without_a_reader_ends_a_command_quietly(command, capsys, monkeypatch):
    """In this process; those of the next test also end without a word from the interpreter."""
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        assert call(*command.split(), "--help") == OUTPUT_CLOSED
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "words",
    [("settings", "--preset", "smoke"), ("studies", "--json"), ("status",), ("study", "--help"), ("servo", "--help")],
)
def test_output_without_a_reader_ends_a_command_quietly(words, done):
    store = ("--store", str(done / "store")) if words[0] in ("studies", "status") else ()
    study = ("tiny",) if words[0] == "status" else ()
    ended = to_a_closed_pipe(*words, *study, *store)
    assert (ended.returncode, ended.stderr) == (OUTPUT_CLOSED, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_output_to_a_full_disk_is_a_message():
    with Path("/dev/full").open("w") as full:
        words = [sys.executable, "-m", "pipeline", "settings", "--preset", "smoke"]
        ended = subprocess.run(words, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True)
    said = "puddle: the output could not be written: No space left on device. Finished work is safe\n"
    assert (ended.returncode, ended.stderr) == (USER_ERROR, said)


def test_a_command_without_an_output_ends_well():
    words = ["sh", "-c", 'exec "$@" >&-', "sh", sys.executable, "-m", "pipeline", "settings", "--preset", "smoke"]
    ended = subprocess.run(words, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize("command", COMMANDS)
def test_an_unknown_option_is_a_users_mistake(command, capsys):
    assert "--no-such-option" in refused(capsys, *command.split(), "--no-such-option")


def raises(error: BaseException):
    """Return an application with one command, which raises an error."""
    app = typer.Typer(cls=Commands, pretty_exceptions_enable=False)

    @app.callback()
    def group() -> None: ...

    @app.command()
    def fails() -> None:
        raise error

    return app


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (EOFError(), USER_ERROR, "puddle: the input ended too early"),
        (typer.Abort(), USER_ERROR, "puddle: the input ended before the question was answered"),
        (BrokenPipeError(32, "Broken pipe"), OUTPUT_CLOSED, ""),
        (KeyboardInterrupt(), INTERRUPTED, ""),
        (ArithmeticError("a defect"), DEFECT, "ArithmeticError: a defect"),
        (OSError(5, "Input/output error"), DEFECT, "Input/output error"),
    ],
)
def test_every_end_of_a_command_has_its_code(error, code, said, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["fails"], run=raises(error))
    assert ended.value.code == code
    shown = capsys.readouterr().err
    assert said in shown and bool(shown) == bool(said) and "Aborted" not in shown


STOPPED_TWICE = """
import atexit, os, signal, time, typer
from pipeline.commands.terminal import interruptible
def clean_up():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.05)
    print("cleaned up")
atexit.register(clean_up)
try:
    with interruptible():
        raise KeyboardInterrupt
except typer.Exit as end:
    raise SystemExit(end.exit_code)
"""


def test_another_interrupt_does_not_disturb_the_exit():
    done = subprocess.run([sys.executable, "-c", STOPPED_TWICE], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (130, "cleaned up\n") and "Traceback" not in done.stderr
