"""The watchdog: end a driver whose Ray is gone, with a message. A call into Ray may then never return."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable

from pipeline.cluster.process import end_at_once

STUCK_SECONDS = 10.0  # time that a call into Ray may last once Ray is dead [s]
GONE_SECONDS = 45.0  # time that an existing cluster may be silent [s]; Ray ends the process after a minute
CHECK_INTERVAL = 1.0  # time between two checks [s]

_ANSWER_SECONDS = 5.0  # time for the answer to one check [s]; with GONE_SECONDS it stays below Ray's minute

RAY_DIED = (
    "Ray on this machine died: its raylet or its GCS is gone (killed, or out of memory).\n"
    "Committed results are safe: run the same command again to resume. Fewer `--workers` need less memory."
)
NODE_DIED = (
    "this machine's node of the Ray cluster at {address} died: its raylet is gone (killed, out of memory, or `ray "
    "stop`).\nCommitted results are safe: start a node here (`ray start`) and run the same command again to resume."
)
UNREACHABLE = (
    "the Ray cluster at {address} has not answered for {seconds:.0f} s: its head or the network is down.\n"
    "Committed results are safe: run the same command again once the cluster answers."
)


def end_if_stuck(wait: Callable[[], object], calling: threading.RLock, over: threading.Event) -> None:
    """End this process if Ray died and a call into it does not return; a driver that does other work goes on.

    Args:
        wait: returns when Ray is dead.
        calling: the lock that the driver holds while it calls Ray.
        over: set when Ray is no longer needed.
    """
    wait()
    while calling.acquire(timeout=STUCK_SECONDS):
        calling.release()
        if over.wait(CHECK_INTERVAL):
            return
    end_at_once(f"puddle: {RAY_DIED}", 2)


def end_if_unreachable(address: str, host: str, port: int, over: threading.Event) -> None:
    """End this process if an existing cluster stops answering.

    Args:
        address: the cluster's address, for the message.
        host, port: its GCS server.
        over: set when the cluster is no longer needed.
    """
    answered = time.monotonic()
    while not over.wait(CHECK_INTERVAL):
        with contextlib.suppress(OSError):
            socket.create_connection((host, port), timeout=_ANSWER_SECONDS).close()
            answered = time.monotonic()
        if time.monotonic() - answered > GONE_SECONDS and not over.is_set():
            end_at_once(f"puddle: {UNREACHABLE.format(address=address, seconds=GONE_SECONDS)}", 2)
