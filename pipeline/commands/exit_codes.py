"""Exit codes, and what the terminal shows when a command is interrupted."""

import contextlib
import signal
from collections.abc import Iterator

import typer

INCOMPLETE = 1  # the study ran to its end but some work items or designs failed; the message names them
USER_ERROR = 2  # the user can correct the mistake
DEFECT = 70  # a bug in puddle, shown with its traceback: EX_SOFTWARE of sysexits.h
INTERRUPTED = 130  # ctrl-C

_STOPPED = (128 + signal.SIGTERM, 128 + signal.SIGHUP)


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
    with contextlib.suppress(OSError):  # the terminal may be closed
        to_stderr("\nStopped. Finished work is safe: the same command resumes from there.")


def to_stderr(line: str) -> None:
    """Print a line on standard error."""
    typer.echo(line, err=True)
