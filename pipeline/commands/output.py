"""Lines on the terminal, with what could act on it escaped."""

import typer

from pipeline.text import printable


def to_stdout(line: str) -> None:
    """Print a line of results."""
    typer.echo(printable(line))


def to_stderr(line: str) -> None:
    """Print a line about the course of a command."""
    typer.echo(printable(line), err=True)
