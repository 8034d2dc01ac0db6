"""Lines on the terminal, with what could act on it escaped, and what happens where they cannot be written."""

import contextlib
import os
import sys
from collections.abc import Iterator

import typer

from pipeline.errors import PuddleError
from pipeline.text import printable


class OutputClosed(Exception):  # noqa: N818 (no mistake of anyone)
    """Raised where a command writes to a pipe that has no reader any more."""


def to_stdout(line: str) -> None:
    """Print a line of results. Raises OutputClosed or PuddleError if that is not possible."""
    with _written():
        typer.echo(printable(line))


def to_stderr(line: str) -> None:
    """Print a line about the course of a command, if that is possible: the terminal may be closed."""
    try:
        typer.echo(printable(line), err=True)
    except BrokenPipeError:
        raise
    except OSError:
        pass


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
        discard_output()
        if isinstance(error, BrokenPipeError):
            raise OutputClosed from error
        raise PuddleError(f"the output could not be written: {error.strerror}. Finished work is safe") from None


def discard_output() -> None:
    """Send the rest of the output nowhere: Python writes what is buffered once more at the end."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
