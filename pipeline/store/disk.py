"""The disk: the effects through which the store changes it, and the one way to put a file in its place.

Every change goes through :func:`write`, :func:`fsync`, :func:`rename`, :func:`mkdir`, :func:`unlink` and :func:`rmdir`,
looked up in this module at each call, so that a test can let the process die, or the disk fill, at any of them. Lock
files are apart: they hold nothing that has to outlive a process. POSIX only (flock).
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.store.encoding import digest

MAX_DOCUMENT_BYTES = 2**26
"""A JSON document's greatest length: the record of a study of half a million pieces."""

_PIECE_BYTES = 2**20
"""Of a file that is hashed."""

_OWN = os.O_NOFOLLOW | os.O_CLOEXEC


class NotAFileError(OSError):
    """Something else has a file's name."""


# -- the effects -----------------------------------------------------------------------------------------------------


def write(path: Path, data: bytes) -> None:
    """Write a whole file, in place of what is there."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | _OWN, 0o644), "wb") as file:
        file.write(data)


def fsync(path: Path) -> None:
    """Wait until a file, or a folder's list of names, is on the disk itself."""
    descriptor = os.open(path, os.O_RDONLY | _OWN)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def rename(path: Path, target: Path) -> None:
    """Give a file its final name, in place of what had it."""
    path.replace(target)


def mkdir(path: Path) -> None:
    """Make one folder, unless it is there."""
    path.mkdir(exist_ok=True)


def unlink(path: Path) -> None:
    """Remove a file, unless it is gone."""
    path.unlink(missing_ok=True)


def rmdir(path: Path) -> None:
    """Remove an empty folder."""
    path.rmdir()


# -- made of them ----------------------------------------------------------------------------------------------------


def temporary(path: Path) -> Path:
    """Return where a file's content lies before it has its final name."""
    return path.with_name(f".{path.name}.tmp")


def place(path: Path, data: bytes) -> None:
    """Put a file in its place: whole under its name, or not there at all, whatever happens meanwhile.

    Callers hold a lock on the folder: the temporary file's name is always the same, so that an interrupted call leaves
    at most one, which the next call writes over. What is in its place already is not written again: there may be no
    room for it twice.
    """
    if _holds(path, data):
        fsync(path.parent)
        return
    write(temporary(path), data)
    fsync(temporary(path))
    if digest(read(temporary(path), at_most=len(data))) != digest(data):
        raise PuddleError(
            f"{path}: expected the bytes just written, came others. They were not put in its place: whatever was kept "
            f"before is safe. Check the disk, ask `puddle verify` whether it holds what it held, and give the same "
            f"command again: it goes on from there."
        )
    rename(temporary(path), path)
    fsync(path.parent)


def _holds(path: Path, data: bytes) -> bool:
    try:
        return read(path, at_most=len(data)) == data
    except OSError:
        return False


def make_folders(root: Path, folder: Path) -> None:
    """Make the folders from a root (which exists) down to a folder below it, for good."""
    below = [path for path in (folder, *folder.parents) if path.is_relative_to(root) and path != root]
    missing = [path for path in below if not path.is_dir()]
    if deepest := below[len(missing) : len(missing) + 1]:
        fsync(deepest[0].parent)  # who made it may have died before it was safe
    for path in reversed(missing):
        mkdir(path)
        fsync(path.parent)


def read(path: Path, *, at_most: int = MAX_DOCUMENT_BYTES) -> bytes:
    """Read a regular file. Of one that is longer than it should be, it takes one byte too many and no more.

    Raises:
        NotAFileError: where it is a symbolic link, a folder, a pipe or the like.
        OSError: where it is not there or can't be read.
    """
    with _opened(path) as file:
        return file.read(min(at_most, os.fstat(file.fileno()).st_size) + 1)  # room for so much is made beforehand


def digest_of(path: Path, *, at_most: int) -> str:
    """Return the SHA-256 of what :func:`read` would read, in little memory; raises as it."""
    found, n_left = hashlib.sha256(), at_most + 1
    with _opened(path) as file:
        while piece := file.read(min(_PIECE_BYTES, n_left)):
            found.update(piece)
            n_left -= len(piece)
    return found.hexdigest()


def _opened(path: Path) -> BinaryIO:
    if not stat.S_ISREG(path.lstat().st_mode):
        raise NotAFileError(errno.EINVAL, "not a regular file", str(path))
    return os.fdopen(os.open(path, os.O_RDONLY | _OWN), "rb")


def read_document(path: Path) -> bytes:
    """Read a JSON document; raises as :func:`read`, and DamagedArtifact where it is too long to be one of ours."""
    data = read(path)
    if len(data) > MAX_DOCUMENT_BYTES:
        raise DamagedArtifact(f"{path}: expected at most {MAX_DOCUMENT_BYTES} bytes, came {path.stat().st_size}")
    return data


def below(folder: Path) -> Iterator[Path]:
    """Give everything in a folder and below. What others remove meanwhile is left out; links are not followed."""
    for place, folders, files in os.walk(folder):  # rglob fails where a folder has gone
        yield from (Path(place, name) for name in (*folders, *files))


def size_bytes(folder: Path) -> int:
    """Return the length of all files in a folder and below."""
    total = 0
    for path in below(folder):
        with contextlib.suppress(FileNotFoundError):  # a commit renames its temporary files meanwhile
            found = path.lstat()
            total += found.st_size if stat.S_ISREG(found.st_mode) else 0
    return total


def inside(root: Path, *parts: str) -> Path:
    """Return a path below a root. The parts are single names that the caller has checked.

    Raises:
        PuddleError: where one of them is a symbolic link.
    """
    path = root
    for part in parts:
        path = path / part
        if path.is_symlink():
            raise PuddleError(
                f"{path}: expected a file or a folder, came a symbolic link. It was not followed, and whatever was "
                f"kept is safe. A store holds none: replace the link by what it points at, or move the whole store; "
                f"then `puddle verify` tells whether all is well, and the same command goes on from there."
            )
    return path


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock file, waiting for other processes (and threads); it is let go when the process ends, however."""
    with os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | _OWN, 0o644), "rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def try_lock(path: Path, *, kind: int = fcntl.LOCK_EX, only_ask: bool = False) -> int | None:
    """Take a lock file if it is free; return its descriptor, whose closing lets go, or None where it is taken.

    Args:
        path: of the lock file.
        kind: fcntl.LOCK_EX, or LOCK_SH for a lock that many share.
        only_ask: do not create the file. As an asker is in the way for an instant, others try for half a second.
    """
    flags = os.O_RDONLY if only_ask else os.O_RDWR | os.O_CREAT
    descriptor = os.open(path, flags | _OWN, 0o644)
    patience = time.monotonic() + (0.0 if only_ask else 0.5)
    while True:
        try:
            fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
            return descriptor
        except BlockingIOError:
            if time.monotonic() >= patience:
                os.close(descriptor)
                return None
            time.sleep(0.02)


@contextlib.contextmanager
def explained(
    doing: str, path: Path, *, advice: str = "give the same command again: it goes on from there"
) -> Iterator[None]:
    """Turn an OSError into a PuddleError that says what failed, what is safe and what to do.

    Args:
        doing: what failed.
        path: of what it was done to.
        advice: what to do once the cause is mended.
    """
    try:
        yield
    except OSError as error:
        match error.errno:
            case errno.ENOSPC | errno.EDQUOT:
                mend = f"Free some space and {advice}."
            case errno.EROFS | errno.EACCES | errno.EPERM:
                mend = f"Allow it (permissions, a read-only disk), or choose another place; then {advice}."
            case _:
                mend = f"Mend the cause and {advice}."
        file = error.filename2 or error.filename  # of a rename, the name that was wanted
        where = f" ({file})" if file else ""
        raise PuddleError(
            f"{path}: {doing} failed: {error.strerror or error}{where}. Whatever was kept before is safe. {mend}"
        ) from error
