"""Disk access: the six effects through which the store changes the disk, and atomic writes built on them.

Every change goes through :func:`write`, :func:`fsync`, :func:`rename`, :func:`mkdir`, :func:`unlink` and :func:`rmdir`,
looked up in this module at each call, so that a test can kill the process or fill the disk at any of them. Lock files
are exempt, because nothing in them must outlive a process. POSIX only (flock). An OSError names its file; the command
line explains it.
"""

import contextlib
import fcntl
import hashlib
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from pipeline.errors import PuddleError


def write(path: Path, data: bytes) -> None:
    """Write a whole file, replacing what is there."""
    with _named(path):
        path.write_bytes(data)


def fsync(path: Path) -> None:
    """Flush a file, or a folder's list of names, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        with _named(path):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """Have an error name the file, as that of an open one does not."""
    try:
        yield
    except OSError as error:
        error.filename = error.filename or str(path)
        raise


def rename(path: Path, target: Path) -> None:
    """Rename a file, replacing what had that name."""
    path.replace(target)


def mkdir(path: Path) -> None:
    """Create one folder unless it exists."""
    path.mkdir(exist_ok=True)


def unlink(path: Path) -> None:
    """Remove a file if it exists."""
    path.unlink(missing_ok=True)


def rmdir(path: Path) -> None:
    """Remove an empty folder."""
    path.rmdir()


# -- built on the effects --------------------------------------------------------------------------------------------


def place(path: Path, data: bytes) -> None:
    """Write a file atomically: after a crash at any point it is complete under its name, or as it was before.

    The caller must hold a lock on the folder. An interrupted call leaves at most one temporary file, which the next
    call overwrites.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    write(temporary, data)
    fsync(temporary)
    rename(temporary, path)
    fsync(path.parent)


def make_folders(folder: Path) -> None:
    """Create a folder and those above it, and flush them."""
    if not folder.is_dir():
        make_folders(folder.parent)
        mkdir(folder)
        fsync(folder.parent)


def unused(path: Path) -> Path:
    """Return a path that nothing has, made from this one by the first number that makes it so: ``name-1.suffix``."""
    number = 1
    while os.path.lexists(free := path.with_stem(f"{path.stem}-{number}")):
        number += 1
    return free


def resolved(path: Path) -> Path:
    """Return an absolute path without links, ``~`` being the user's home."""
    return path.expanduser().resolve()


def digest_of(path: Path) -> str:
    """Return a file's SHA-256 without reading it whole into memory."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def locked(
    path: Path, *, seconds: float = 120.0, shared: bool = False, taken: Callable[[], str] | None = None
) -> Iterator[int]:
    """Hold a lock file, and yield its descriptor; it is released when the process ends.

    Args:
        path: the lock file.
        seconds: longest time to wait for other processes and threads [s]; a commit takes milliseconds.
        shared: whether others may share it.
        taken: returns what the error says if it is not that a process is stopped.

    Raises:
        PuddleError: another process still holds it, as one does that is stopped (Ctrl-Z).
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        end = time.monotonic() + seconds
        while not try_lock(descriptor, shared=shared):
            if time.monotonic() >= end:
                stopped = (
                    f"{path} has been locked for {seconds:.0f} s by another process of puddle. Continue it if it is "
                    f"stopped (fg), or end it. Committed results are safe: the same command resumes."
                )
                raise PuddleError(taken() if taken else stopped)
            time.sleep(0.01)
        yield descriptor
    finally:
        os.close(descriptor)


def try_lock(descriptor: int, *, shared: bool) -> bool:
    """Lock an open file, and return whether no other process holds it."""
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
