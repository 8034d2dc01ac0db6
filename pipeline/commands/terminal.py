"""The terminal: lines, exit codes, and what is shown when a command is stopped."""

import atexit
import contextlib
import errno
import io
import json
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from pipeline.errors import PuddleError

INCOMPLETE = 1  # the study ran to its end but some work items or designs failed; the message names them
USER_ERROR = 2  # the user can correct the mistake
DEFECT = 70  # a bug in puddle, shown with its traceback: EX_SOFTWARE of sysexits.h
INTERRUPTED = 130  # Ctrl-C
OUTPUT_CLOSED = 141  # whatever read the output has closed it, as `head` does: 128 + SIGPIPE, as a shell has it

_STOPPED = (128 + signal.SIGTERM, 128 + signal.SIGHUP)


class OutputClosed(Exception):  # noqa: N818 (no mistake of anyone)
    """Raised where a command writes to a pipe that has no reader any more."""


def write_what_can_be_encoded() -> None:
    """Have a terminal or a log that is not UTF-8 show a question mark for what it can't show, whoever writes it."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # None where it was closed before the start
            stream.reconfigure(errors="replace")


def to_stdout(*lines: str) -> None:
    """Print lines of results. Raises OutputClosed or PuddleError if that is not possible."""
    with _written():
        for line in lines:
            typer.echo(line)


def to_stderr(line: str) -> None:
    """Print a line about the course of a command, if that is possible: the terminal may be closed."""
    try:
        typer.echo(line, err=True)
    except BrokenPipeError:
        raise
    except OSError:
        pass


def print_json(document: Any) -> None:
    """Print a JSON document on standard output."""
    to_stdout(json.dumps(document, indent=2, allow_nan=False))


def flush() -> None:
    """Write what is buffered of the results. Raises as :func:`to_stdout`."""
    with _written():
        if sys.stdout is not None:  # it is None where it was closed before the start
            sys.stdout.flush()


@contextlib.contextmanager
def _written() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        _discard_output()
        if isinstance(error, BrokenPipeError):
            raise OutputClosed from error
        raise PuddleError(f"the output could not be written: {error.strerror}. Finished work is safe") from None


def _discard_output() -> None:
    """Send the rest of the output nowhere: Python writes what is buffered once more at the end."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class Commands(TyperGroup):
    """A group of commands that leaves it to :func:`exit_with` how they end, where Typer has one code for everything."""

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        """Parse the arguments; this also prints the help."""
        with _named():
            return super().make_context(*arguments, **options)

    def invoke(self, ctx: Any) -> Any:
        """Run the command, which the user or the system may stop."""
        with _named(), interruptible():
            return super().invoke(ctx)


@contextlib.contextmanager
def _named() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError as error:
        raise OutputClosed from error
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):  # Rich found it
            raise OutputClosed from end
        raise
    except typer.Abort as abort:
        if isinstance(abort.__context__, KeyboardInterrupt):
            raise typer.Exit(INTERRUPTED) from None
        raise PuddleError("the input ended before the question was answered. Nothing was done") from abort
    except EOFError as error:
        raise PuddleError("the input ended too early. Finished work is safe") from error


def exit_with(error: Exception) -> NoReturn:
    """End the process as an error of a command demands: with a message or a traceback, and its exit code.

    An OSError is the disk's, or that of a path that the user named.
    """
    match error:
        case PuddleError():
            to_stderr(f"puddle: {error}")
            sys.exit(USER_ERROR)
        case OSError():
            file = error.filename2 or error.filename  # for a rename, the new name
            if not file and error.strerror == os.strerror(errno.ENOENT):  # only the working folder has no name
                file = "the working folder"
            advice = _DISK_ADVICE.get(error.errno or 0, "")
            to_stderr(f"puddle: {f'{file}: ' if file else ''}{error.strerror or error}. {advice}".rstrip())
            sys.exit(USER_ERROR)
        case MemoryError() | ImportError() if isinstance(error, MemoryError) or "failed to map" in str(error):
            what = f"memory or address space (ulimit -v) is short: {error or type(error).__name__}"
            to_stderr(f"puddle: {what}. Finished work is safe.")
            sys.exit(USER_ERROR)
        case OutputClosed():
            _discard_output()
            sys.exit(OUTPUT_CLOSED)
    traceback.print_exception(error)
    sys.exit(DEFECT)


_AGAIN = "Committed results are safe: run the same command again once you have"
_DISK_ADVICE = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), f"{_AGAIN} freed some space."),
    **dict.fromkeys((errno.EROFS, errno.EACCES, errno.EPERM), f"{_AGAIN} allowed access, or choose another folder."),
}


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Explain what is safe when the user or the system stops the command."""
    try:
        yield
    except KeyboardInterrupt:
        _explain_stop()
        raise typer.Exit(INTERRUPTED) from None
    except SystemExit as stop:
        if stop.code in _STOPPED:
            _explain_stop()
        raise


def _explain_stop() -> None:
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)  # it runs first: another Ctrl-C disturbs no exit
    with contextlib.suppress(OSError):  # the terminal may be closed
        to_stderr("\nStopped. Finished work is safe: the same command resumes from there.")
