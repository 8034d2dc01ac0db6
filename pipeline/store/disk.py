"""Disk access: the six effects through which the store changes the disk, and atomic writes built on them.

Every change goes through :func:`write`, :func:`fsync`, :func:`rename`, :func:`mkdir`, :func:`unlink` and :func:`rmdir`,
looked up in this module at each call, so that a test can kill the process or fill the disk at any of them. Lock files
are exempt, because nothing in them must outlive a process. POSIX only (flock). An OSError names its file; the command
line explains it.
"""

import contextlib
import errno
import fcntl
import hashlib
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

from pipeline.errors import PuddleError

_SECONDS_TO_LOCK = 0.5  # a query holds a lock for an instant
_NO_FLUSH = (errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.ENOSYS)
"""What file systems say that flush no folders, such as VirtualBox's shared ones; none means that the disk fails."""


LOST_AND_FOUND = "lost+found"  # in the root of a disk: nothing of the user's


def read(path: Path) -> bytes:
    """Return the content of a file."""
    with named(path):
        return path.read_bytes()


def write(path: Path, data: bytes) -> None:
    """Write a whole file, replacing what is there."""
    with named(path):
        path.write_bytes(data)


def fsync(path: Path) -> None:
    """Flush a file, or a folder's list of names where the file system does that, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        with named(path):
            os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NO_FLUSH or not path.is_dir():
            raise
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def named(path: Path) -> Iterator[None]:
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


def digest_of(path: Path) -> str:
    """Return a file's SHA-256 without reading it whole into memory."""
    with named(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def locked(path: Path, *, shared: bool = False, taken: Callable[[], str] | None = None) -> Iterator[None]:
    """Hold a lock file, alone unless it is shared; it is released when the process ends.

    This waits for others for as long as it takes, or, with ``taken``, half a second: then it raises PuddleError with
    what that returns.
    """
    with path.open("ab") as file:
        end = time.monotonic() + _SECONDS_TO_LOCK
        while not lock(file, shared=shared, wait=taken is None):
            if taken and time.monotonic() >= end:
                raise PuddleError(taken())
            time.sleep(0.01)
        yield


def lock(file: IO[Any], *, shared: bool = False, wait: bool = False) -> bool:
    """Lock an open file; return False if another process holds it. Nothing stands in where a file system has no locks.

    A file that is a lock by its existence would outlive a killed process.
    """
    try:
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except OSError as error:
        raise PuddleError(
            f"{file.name}: its file system has no locks ({error.strerror}), which keep two processes from writing at "
            f"once. Put the store on a local disk (--store), or have this one mounted with locks (Lustre: -o flock)."
        ) from None
    return True
