"""A private Ray for one driver on Linux or macOS: a folder of this user's alone, a token, and a supervisor process."""

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
from dataclasses import dataclass
from pathlib import Path

import psutil

from pipeline.cluster import supervisor
from pipeline.cluster.process import PINNED_THREADS
from pipeline.cluster.watchdog import Calls, end_if_silent, end_if_stuck
from pipeline.errors import PuddleError

OBJECT_STORE_BYTES = 512 * 2**20  # shared memory of a local cluster; ensembles and results take megabytes
SESSIONS_FOLDER = Path("/tmp")  # short, because the path of a Unix socket has at most 107 bytes

_SESSION_PREFIX = "puddle-"
_MARK = b"session of puddle\n"  # content of a session's lock, without which a folder is somebody else's
_START_SECONDS = 120.0  # time that Ray has to start on a busy machine [s]; ten seconds are usual
_WORKERS_ON_DEMAND = {"RAY_enable_worker_prestart": "0", "RAY_prestart_worker_first_driver": "0"}
"""Ray makes its first driver wait for all workers that it starts in advance: for ever, if one is killed meanwhile
(ray-project/ray, issue 40131)."""


@dataclass(frozen=True)
class Session:
    """A running private Ray."""

    address: str
    token: Path  # file with the token that its servers require
    is_alive: Callable[[], bool]
    kill: Callable[[], None]  # ends Ray at once
    calling: Calls  # held while the driver calls Ray; if Ray dies meanwhile or does not answer, the process ends


@contextlib.contextmanager
def session(n_cores: int | None) -> Iterator[Session]:
    """Start Ray on this machine's loopback for this user alone; none of its processes outlives this one.

    The environment must already hold everything that Ray reads from it, except for the token's path.
    """
    sweep()
    # A private folder: /tmp/ray may belong to another user, and Ray makes its folder accessible to all.
    folder = Path(tempfile.mkdtemp(prefix=_SESSION_PREFIX, dir=SESSIONS_FOLDER))
    lock = _lock(folder)
    child: subprocess.Popen[str] | None = None
    calling, over = Calls(), threading.Event()
    environment = {**os.environ, **PINNED_THREADS}  # inherited by the supervisor, Ray and its workers
    try:
        token = _token_of(folder)
        with os.fdopen(os.open(token, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(secrets.token_hex(32))
        arguments = [str(folder), str(n_cores or 0), str(OBJECT_STORE_BYTES), str(lock)]
        with (folder / "supervisor.log").open("w") as log:
            child = subprocess.Popen(
                [sys.executable, "-P", supervisor.__file__, *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                pass_fds=[lock],
                env={**environment, **_WORKERS_ON_DEMAND, "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(token)},
                start_new_session=True,  # so that Ctrl-C in the terminal does not reach Ray directly
            )
        address = _address(child, folder)
        threading.Thread(target=end_if_stuck, args=(child.wait, calling, over), daemon=True).start()
        threading.Thread(target=end_if_silent, args=(calling, over), daemon=True).start()
        poll, pipe = child.poll, child.stdin
        assert pipe is not None
        yield Session(address, token, is_alive=lambda: poll() is None, kill=pipe.close, calling=calling)
    finally:
        over.set()
        if child is not None and child.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                child.stdin.close()  # the supervisor then kills what is left, removes the folder, and ends
            child.wait()
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def _token_of(folder: Path) -> Path:
    """Return the path of a session's token, by which a process's environment shows the session it belongs to."""
    return folder / "token"


def _address(child: subprocess.Popen[str], folder: Path) -> str:
    assert child.stdout is not None
    if not select.select([child.stdout], [], [], _START_SECONDS)[0]:
        raise PuddleError(f"it did not start within {_START_SECONDS:.0f} s")
    answer = json.loads(child.stdout.readline() or "{}")
    if "address" in answer:
        return str(answer["address"])
    log = (folder / "supervisor.log").read_text(errors="replace").strip().splitlines()
    raise PuddleError(str(answer.get("error") or (log[-1] if log else "its process ended without a message")))


def _lock(folder: Path) -> int:
    """Lock a folder against other drivers' sweeps. The rename ensures that no lock file is ever unlocked at first."""
    descriptor = os.open(folder / "lock.new", os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    os.write(descriptor, _MARK)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    (folder / "lock.new").rename(folder / "lock")
    return descriptor


def sweep() -> None:
    """Kill the processes and remove the folders of sessions whose driver and supervisor were both killed."""
    for folder in abandoned_sessions():
        supervisor.kill_all(functools.partial(_processes_of, folder))
        shutil.rmtree(folder, ignore_errors=True)


def abandoned_sessions() -> Iterator[Path]:
    """Yield the folders of this user's sessions that no driver has locked; each is locked while it is visited."""
    for folder in SESSIONS_FOLDER.glob(f"{_SESSION_PREFIX}*"):
        try:
            if folder.is_symlink() or folder.stat().st_uid != os.getuid():
                continue
            descriptor = os.open(folder / "lock", os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError:  # not a session's folder, or removed meanwhile
            continue
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.read(descriptor, len(_MARK) + 1) == _MARK:
                yield folder
        except BlockingIOError:  # its driver or supervisor is alive
            continue
        finally:
            os.close(descriptor)


def _processes_of(folder: Path) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.environ().get("RAY_AUTH_TOKEN_PATH") == str(_token_of(folder)):
                found.append(process)
    return found
