"""The exit codes of docs/reliability.md, seen from outside; the help and the version."""

import importlib.metadata
import os
import subprocess
import sys
from pathlib import Path
from typing import IO

import pytest
import typer
from command_line import call, refused

from pipeline.commands.app import PANELS, main
from pipeline.commands.terminal import Commands

ROOT = Path(__file__).parents[3]
COMMANDS = [name for commands in PANELS.values() for name in commands] + ["servo", "servo play", "servo calibrate"]


def in_a_process(*words: str, stdout: IO[str]) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pipeline", *words]
    return subprocess.run(command, cwd=ROOT, stdout=stdout, stderr=subprocess.PIPE, text=True)


def test_output_without_a_reader_ends_a_command_quietly():
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stdout:
        ended = in_a_process("servo", "--help", stdout=stdout)
    assert (ended.returncode, ended.stderr) == (141, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_output_to_a_full_disk_is_a_message():
    with Path("/dev/full").open("w") as full:
        ended = in_a_process("settings", "--preset", "smoke", stdout=full)
    assert ended.returncode == 2 and len(ended.stderr.splitlines()) == 1
    assert "the output could not be written: No space left on device" in ended.stderr


def test_a_command_without_an_output_ends_well():
    words = ["sh", "-c", 'exec "$@" >&-', "sh", sys.executable, "-m", "pipeline", "servo", "--help"]
    ended = subprocess.run(words, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_terminal_that_is_not_utf_8_shows_what_it_can(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "cp1252:strict")
    with (tmp_path / "shown").open("w+b") as shown:
        ended = in_a_process("settings", "--preset", "smoke", stdout=shown)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert b"?/2" in (tmp_path / "shown").read_bytes()  # π/2


def test_short_options_and_the_version(capsys):
    shown = [call(option) or capsys.readouterr().out for option in ("-h", "--help", "--version")]
    assert shown[0] == shown[1] and all(command in shown[0] for command in COMMANDS if " " not in command)
    assert shown[2] == f"puddle {importlib.metadata.version('puddle')}\n"


@pytest.mark.parametrize("command", COMMANDS)
def test_an_unknown_option_is_a_users_mistake(command, capsys):
    assert "--no-such-option" in refused(capsys, *command.split(), "--no-such-option")


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (EOFError(), 2, "puddle: the input ended too early"),
        (typer.Abort(), 2, "puddle: the input ended before the question was answered"),
        (BrokenPipeError(32, "Broken pipe"), 141, ""),
        (KeyboardInterrupt(), 130, "Stopped. Finished work is safe"),
        (ArithmeticError("a defect"), 70, "ArithmeticError: a defect"),
        (OSError(5, "Input/output error"), 2, "puddle: Input/output error."),
        (OSError(28, "No space left on device", "a/b"), 2, "puddle: a/b: No space left on device. Committed results"),
        (OSError(30, "Read-only file system", "a/b"), 2, "allowed access, or choose another folder."),
    ],
)
def test_every_end_of_a_command_has_its_code(error, code, said, capsys):
    app = typer.Typer(cls=Commands, pretty_exceptions_enable=False)

    @app.callback()
    def group() -> None: ...

    @app.command()
    def fails() -> None:
        raise error

    with pytest.raises(SystemExit) as ended:
        main(["fails"], run=app)
    assert ended.value.code == code
    shown = capsys.readouterr().err
    assert said in shown and bool(shown) == bool(said) and "Aborted" not in shown
    assert shown.startswith("Traceback") == (code == 70)


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


def test_a_missing_gpu_is_a_message_before_anything_is_made(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("tasks.residual.torch_descent.n_cuda_devices", lambda: 0)
    store = tmp_path / "store"
    said = refused(capsys, "study", "--preset", "smoke", "--set", "training.device=cuda", "--store", str(store))
    assert "training.device is cuda, and there is no CUDA device: torch" in said and "training.device=cpu" in said
    assert not store.exists()
