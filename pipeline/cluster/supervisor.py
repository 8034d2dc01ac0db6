"""The keeper: a process that starts Ray on this machine for a driver, and ends it when the driver ends, however.

Ray's own processes outlive a killed driver by a minute, and Ray can't be interrupted while it starts. So Ray is a child
of this process, and this process holds one end of a pipe to the driver: when the other end closes, because the driver
is done, was interrupted or was killed, every process below this one is killed and the session's folder removed. On
Linux this process is also the parent of orphans below it, so that it finds all of them and nobody else's.

``python -P keeper.py FOLDER N_CORES OBJECT_STORE_BYTES LOCK``: N_CORES may be 0 for all; LOCK is the descriptor of the
folder's lock, which is held as long as this process or the driver lives. It answers on standard output with one line of
JSON: ``{"address": ...}`` or ``{"error": ...}``. Where a server of Ray's dies, this process ends with all that is left:
nothing can be done on half a Ray, and Ray itself takes a minute to say so.

It imports nothing of puddle, and is started by its path: the driver's way of finding puddle need not be its own.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import psutil

if TYPE_CHECKING:
    from ray._private.node import Node

LOOPBACK = "127.0.0.1"

PR_SET_CHILD_SUBREAPER = 36
"""Of Linux's <sys/prctl.h>."""

PATIENCE_SECONDS = 10.0

SERVERS = {"gcs_server", "raylet"}
"""Ray's names for those of its processes without which it is dead."""

SECONDS_BETWEEN_LOOKS = 0.2
"""At them."""


def main(folder: str, n_cores: int, object_store_bytes: int, lock: int) -> None:
    """Start Ray, say where it is, and wait for the driver's end."""
    os.set_inheritable(lock, False)  # else Ray's processes would hold it too
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    waiting = threading.Thread(target=_end_with_driver, args=(folder,), daemon=True)
    waiting.start()
    ray: Node | None = None
    try:
        ray = _start_ray(folder, n_cores, object_store_bytes)
        answer = {"address": str(ray.address)}
    except BaseException as error:
        answer = {"error": f"{type(error).__name__}: {error}"}
    with contextlib.suppress(BrokenPipeError):
        print(json.dumps(answer), flush=True)
    while ray is None or not SERVERS & {kind for kind, _ in ray.dead_processes()}:
        waiting.join(SECONDS_BETWEEN_LOOKS)
    _end(folder)


def _start_ray(folder: str, n_cores: int, object_store_bytes: int) -> Node:
    """Do what ``ray start --head`` does, but on the loopback and without its fixed port for remote drivers."""
    from ray._private.node import Node
    from ray._private.parameter import RayParams

    class Quiet(Node):  # type: ignore[misc]  # Ray has no types
        def start_api_server(self, **_: object) -> None:
            """Leave out the dashboard's process, which Ray starts even without a dashboard.

            All that it does then is tell Ray's makers, where usage statistics are off, that they are off; and it asks
            the metadata servers of three clouds which of them this is.
            """

    parameters = RayParams(
        node_ip_address=LOOPBACK,  # all of Ray's servers then listen there alone
        gcs_server_port=0,
        num_cpus=n_cores or None,
        object_store_memory=object_store_bytes,
        include_dashboard=False,
        include_log_monitor=False,
        no_monitor=True,  # the autoscaler's
        temp_dir=os.path.join(folder, "ray"),  # noqa: PTH118 (Ray wants a string)
    )
    return Quiet(parameters, head=True, shutdown_at_exit=False, spawn_reaper=True)


def _end_with_driver(folder: str) -> None:
    """Wait for the end of the pipe."""
    sys.stdin.buffer.read()
    _end(folder)


def _end(folder: str) -> None:
    """Leave nothing."""
    kill_all(lambda: psutil.Process().children(recursive=True))
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


def kill_all(find: Callable[[], list[psutil.Process]]) -> None:
    """Kill processes until none is found any more: some may have children meanwhile."""
    patience = time.monotonic() + PATIENCE_SECONDS  # with a process that hangs in the kernel
    while time.monotonic() < patience:
        n_killed = 0
        for process in find():
            with contextlib.suppress(psutil.NoSuchProcess):
                if process.status() != psutil.STATUS_ZOMBIE:
                    process.kill()
                    n_killed += 1
        if not n_killed:
            return
        time.sleep(0.02)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
