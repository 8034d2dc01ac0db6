"""The supervisor: a process that starts Ray on this machine for a driver, and ends it when the driver ends.

Ray's own processes outlive a killed driver by a minute, and Ray cannot be interrupted while it starts. So Ray is a
child of this process, which holds one end of a pipe to the driver. When the other end closes, because the driver
finished, was interrupted or was killed, every descendant is killed and the session's folder removed. On Linux this
process also adopts orphaned descendants, so that it finds all of them and no others.

``python -P supervisor.py FOLDER N_CORES OBJECT_STORE_BYTES LOCK``: N_CORES may be 0 for all; LOCK is the descriptor of
the folder's lock, which is held as long as this process or the driver lives. The answer on standard output is one line
of JSON, ``{"address": ...}`` or ``{"error": ...}``. If one of Ray's servers dies, this process ends with everything
below it: nothing works on half a Ray, and Ray itself takes a minute to notice.

It imports nothing from puddle and is started by its path, because the driver's import path need not be its own.
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

_PR_SET_CHILD_SUBREAPER = 36  # from Linux's <sys/prctl.h>
_KILL_SECONDS = 10.0  # time to kill all descendants [s]; one may hang in the kernel
_SERVERS = {"gcs_server", "raylet"}  # ray's names for the processes without which it is dead
_SERVER_CHECK_INTERVAL = 0.2  # time between two checks of the servers [s]


def main(folder: str, n_cores: int, object_store_bytes: int, lock: int) -> None:
    """Start Ray, print its address, and wait for the driver to end.

    Args:
        folder: the session's folder.
        n_cores: cores for Ray; 0 for all.
        object_store_bytes: shared memory for Ray's object store.
        lock: file descriptor of the folder's lock.
    """
    os.set_inheritable(lock, False)  # otherwise Ray's processes would hold the lock too
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
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
    while ray is None or not _SERVERS & {kind for kind, _ in ray.dead_processes()}:
        waiting.join(_SERVER_CHECK_INTERVAL)
    _end(folder)


def _start_ray(folder: str, n_cores: int, object_store_bytes: int) -> Node:
    """Start Ray as ``ray start --head`` does, but on the loopback and without the fixed port for remote drivers."""
    import ray._private.utils
    from ray._private.node import Node
    from ray._private.parameter import RayParams

    # Ray's agent of this machine loads the parts that serve a dashboard wherever their packages happen to be installed.
    ray._private.utils.get_dashboard_dependency_error = lambda: "there is no dashboard"

    class Quiet(Node):  # type: ignore[misc]  # Ray has no types
        def start_api_server(self, **_: object) -> None:
            """Skip a process that, without a dashboard, only queries the metadata servers of three cloud providers."""

    parameters = RayParams(
        node_ip_address="127.0.0.1",  # all of Ray's servers listen on this address alone
        gcs_server_port=0,
        num_cpus=n_cores or None,
        object_store_memory=object_store_bytes,
        include_dashboard=False,
        include_log_monitor=False,
        no_monitor=True,  # the autoscaler's monitor
        temp_dir=os.path.join(folder, "ray"),  # noqa: PTH118 (Ray wants a string)
    )
    return Quiet(parameters, head=True, shutdown_at_exit=False, spawn_reaper=True)


def _end_with_driver(folder: str) -> None:
    sys.stdin.buffer.read()
    _end(folder)


def _end(folder: str) -> None:
    kill_all(lambda: psutil.Process().children(recursive=True))
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


def kill_all(find: Callable[[], list[psutil.Process]]) -> None:
    """Kill processes until no more are found; some may start children meanwhile."""
    deadline = time.monotonic() + _KILL_SECONDS
    while time.monotonic() < deadline:
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
