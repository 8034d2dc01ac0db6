"""Waiting for a file's lock for a limited time, and naming the processes that hold it."""

import datetime
import fcntl
import platform
import shlex
import time
from pathlib import Path

from pipeline.errors import PuddleError
from pipeline.text import printable

_SECONDS_BETWEEN_ATTEMPTS = 0.01


def wait_for_lock(descriptor: int, path: Path, *, seconds: float) -> None:
    """Lock an open file for this process alone.

    Args:
        descriptor: the open file.
        path: its path.
        seconds: longest time to wait [s]: a process that is stopped (Ctrl-Z) holds its locks for ever.

    Raises:
        PuddleError: another process holds the lock; the message names it.
    """
    end = time.monotonic() + seconds
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() >= end:
                raise PuddleError(
                    f"{path} has been locked for {seconds:.0f} s by {holders_of(path)}. Wait until that process ends, "
                    f"continue it if it is stopped (fg, or kill -CONT and its number), or end it. Committed results "
                    f"are safe: the same command resumes."
                ) from None
            time.sleep(_SECONDS_BETWEEN_ATTEMPTS)


def holders_of(path: Path) -> str:
    """Describe the processes that hold a file's lock, as far as this machine knows them."""
    try:
        inode = str(path.stat().st_ino)
        listed = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
    except OSError:  # not Linux
        return "another process"
    numbers = {int(words[4]) for words in listed if words[1] == "FLOCK" and words[5].rpartition(":")[2] == inode}
    return " and ".join(map(_described, sorted(numbers))) or "a process of another machine or container"


def _described(number: int) -> str:
    import psutil

    try:
        process = psutil.Process(number)
        since = datetime.datetime.fromtimestamp(process.create_time(), datetime.UTC).isoformat(timespec="seconds")
        command, state = " ".join(shlex.join(process.cmdline()).split()), process.status()
    except psutil.Error:
        return f"process {number} on {platform.node()}"
    stopped = " which is stopped," if state == psutil.STATUS_STOPPED else ""
    return printable(f"process {number} on {platform.node()}{stopped} since {since} ({command:.200})")
