"""Processes with a mark in their environment, which children inherit: all are found even if their parent is gone."""

from __future__ import annotations

import contextlib
import secrets
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import psutil

Found = TypeVar("Found")


@dataclass
class Marked:
    """A process that writes into a log, and those that it started."""

    process: subprocess.Popen[bytes]
    mark: str
    log: Path

    def family(self) -> list[psutil.Process]:
        """Find every process that this one started, and the process itself."""
        found = []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if process.environ().get("PUDDLE_MARK") == self.mark and process.status() != psutil.STATUS_ZOMBIE:
                    found.append(process)
        return found

    def ended(self) -> bool:
        """Return whether the process has ended and has left no other behind."""
        return self.process.poll() is not None and not self.family()

    def said(self) -> str:
        return self.log.read_text(errors="replace")

    def wait_for(self, found: Callable[[], Found], seconds: float = 200.0) -> Found:
        """Wait until something is found; its first work item may have to compile kernels on a busy machine."""
        end = time.monotonic() + seconds
        while not (what := found()):
            assert time.monotonic() < end, f"{self.said()}\nstill there: {self.family()}"
            time.sleep(0.05)
        return what


@contextlib.contextmanager
def started(words: Sequence[str | Path], log: Path, environment: dict[str, str], **options: Any) -> Iterator[Marked]:
    """Start a process; kill whatever is left of its family at the end.

    Args:
        words: its command.
        log: the file that receives what it says.
        environment: its environment, without the mark.
        options: other options of subprocess.Popen.
    """
    mark = secrets.token_hex(16)
    with log.open("wb") as sink:
        process = subprocess.Popen(
            words, stdout=sink, stderr=sink, env={**environment, "PUDDLE_MARK": mark}, start_new_session=True, **options
        )
    one = Marked(process, mark, log)
    try:
        yield one
    finally:
        for left in one.family():
            with contextlib.suppress(psutil.Error):
                left.kill()
        process.wait()
