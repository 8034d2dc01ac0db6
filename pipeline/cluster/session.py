"""The folder of a private Ray: readable by this user alone, locked by its driver, and removed once that is gone."""

import contextlib
import fcntl
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

SESSIONS_FOLDER = Path("/tmp")  # short, because the path of a Unix socket has at most 107 bytes; TMPDIR may be longer

_PREFIX = "puddle-"
_LOCK = ".puddle-session"  # without this file a folder is somebody else's


@contextlib.contextmanager
def session_folder() -> Iterator[Path]:
    """Make a folder with a secret in its file ``token``, and remove it at the end."""
    sweep()
    folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=SESSIONS_FOLDER))  # ray's own, /tmp/ray, is open to all users
    try:
        with os.fdopen(os.open(folder / "token", os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(secrets.token_hex(32))
        with (folder / ".lock.new").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            (folder / ".lock.new").rename(folder / _LOCK)  # a lock file that is not locked is a dead driver's
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def sweep() -> None:
    """Remove the folders of drivers that were killed; Ray's processes end by themselves half a minute later."""
    for folder in abandoned_sessions():
        shutil.rmtree(folder, ignore_errors=True)


def abandoned_sessions() -> Iterator[Path]:
    """Yield the folders of this user's sessions that no driver has locked; each is locked while it is visited."""
    for folder in SESSIONS_FOLDER.glob(f"{_PREFIX}*"):
        try:
            if folder.is_symlink() or folder.stat().st_uid != os.getuid():
                continue
            descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError:  # not a session's folder, or removed meanwhile
            continue
        try:
            with contextlib.suppress(BlockingIOError):  # its driver is alive
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                yield folder
        finally:
            os.close(descriptor)
