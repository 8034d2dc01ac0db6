"""A Ray of this driver's own: a folder that only this user can enter, a token, and a keeper that ends with the driver.

Linux and macOS.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import json
import os
import secrets
import select
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import psutil

from pipeline.cluster import supervisor
from pipeline.cluster.process import PINNED_THREADS
from pipeline.cluster.watchdog import end_if_stuck
from pipeline.errors import PuddleError

OBJECT_STORE_BYTES = 512 * 2**20
"""Shared memory of a local cluster. Ensembles and results are megabytes; Ray's default takes a third of the machine."""

PLACE = Path("/tmp")
"""Where sessions' folders are. The path of a Unix socket in one may have 107 bytes, so it must be short."""

PREFIX = "puddle-"

WORKERS_ON_DEMAND = {"RAY_enable_worker_prestart": "0", "RAY_prestart_worker_first_driver": "0"}
"""Of workers that it starts before there is work, Ray lets its first driver wait for all: for ever, if one is killed
meanwhile (ray-project/ray, issue 40131)."""

START_SECONDS = 120.0
"""How long Ray may take to start on a machine that has much else to do; ten seconds are usual."""


@dataclass(frozen=True)
class Session:
    """A running Ray of our own."""

    address: str
    token: Path
    """File with the token that its servers ask for."""
    alive: Callable[[], bool]
    """Tells whether it still runs."""
    calling: AbstractContextManager[object]
    """What the driver holds while it calls Ray: where Ray is dead and the call does not return, the process ends."""


@contextlib.contextmanager
def session(n_cores: int | None) -> Iterator[Session]:
    """Start Ray on this machine's loopback, open to this user alone; no process of it outlives this one.

    The environment must say already what Ray is to read from it, the token's path apart.

    Raises:
        PuddleError: Ray did not start; says why.
    """
    sweep()
    # A folder of our own, which nobody else can enter: /tmp/ray may be another user's, and Ray makes its folder open to
    # all.
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=PLACE))
    lock = _hold(folder)
    kept: subprocess.Popen[str] | None = None
    calling, over = threading.RLock(), threading.Event()
    environment = {**os.environ, **PINNED_THREADS}  # the workers inherit it from Ray, and Ray from the keeper
    try:
        token = token_of(folder)
        with os.fdopen(os.open(token, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(secrets.token_hex(32))
        words = [supervisor.__file__, str(folder), str(n_cores or 0), str(OBJECT_STORE_BYTES), str(lock)]
        with (folder / "keeper.log").open("w") as log:
            kept = subprocess.Popen(
                [sys.executable, "-P", *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                pass_fds=[lock],
                env={**environment, **WORKERS_ON_DEMAND, "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(token)},
                start_new_session=True,  # so that Ctrl-C in the terminal reaches Ray through us alone
            )
        address = _address(kept, folder)
        threading.Thread(target=end_if_stuck, args=(kept.wait, calling, over), daemon=True).start()
        yield Session(address, token, alive=functools.partial(_runs, kept), calling=calling)
    finally:
        over.set()
        if kept is not None:
            with contextlib.suppress(BrokenPipeError):
                kept.communicate()  # closes the pipe: the keeper kills what is left, removes the folder, and ends
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def _runs(process: subprocess.Popen[str]) -> bool:
    return process.poll() is None


def token_of(folder: Path) -> Path:
    """Return where a session's token is. The path in a process's environment tells whose it is."""
    return folder / "token"


def _address(kept: subprocess.Popen[str], folder: Path) -> str:
    assert kept.stdout is not None
    if not select.select([kept.stdout], [], [], START_SECONDS)[0]:
        raise PuddleError(f"it was not there after {START_SECONDS:.0f} s")
    answer = json.loads(kept.stdout.readline() or "{}")
    if "address" in answer:
        return str(answer["address"])
    log = (folder / "keeper.log").read_text(errors="replace").strip().splitlines()
    raise PuddleError(str(answer.get("error") or (log[-1] if log else "its process ended without a word")))


def _hold(folder: Path) -> int:
    """Lock a folder, so that no other driver sweeps it; a lock file that is there was always locked by someone."""
    descriptor = os.open(folder / "lock.new", os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    (folder / "lock.new").rename(folder / "lock")
    return descriptor


def sweep() -> None:
    """Remove the folders, and kill the processes, of sessions whose driver and keeper both were killed."""
    for folder in dead():
        supervisor.kill_all(functools.partial(_processes_of, folder))
        shutil.rmtree(folder, ignore_errors=True)


def dead() -> Iterator[Path]:
    """Find the folders of this user's sessions that no driver holds; each is held while the caller looks at it."""
    for folder in PLACE.glob(f"{PREFIX}*"):
        try:
            if folder.is_symlink() or folder.stat().st_uid != os.getuid():
                continue
            descriptor = os.open(folder / "lock", os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError:  # not a session's, or gone meanwhile
            continue
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield folder
        except BlockingIOError:  # it lives
            continue
        finally:
            os.close(descriptor)


def _processes_of(folder: Path) -> list[psutil.Process]:
    """Find the processes that were given a session's token."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.environ().get("RAY_AUTH_TOKEN_PATH") == str(token_of(folder)):
                found.append(process)
    return found
