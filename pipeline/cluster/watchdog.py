"""What ends a driver whose Ray is gone, and says so: a call into Ray may never return then, or end the process."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable

from pipeline.cluster.process import end_at_once

STUCK_SECONDS = 10.0
"""How long a call into Ray may last once Ray is dead. Ray itself gives up after a minute."""

GONE_SECONDS = 45.0
"""How long an existing cluster may be silent: it may come back. Ray ends the process after a minute, in its words."""

ANSWER_SECONDS = 5.0
"""How long an existing cluster may take to answer a look. Added to the above it is still less than Ray's minute."""

SECONDS_BETWEEN_LOOKS = 1.0

DEAD = (
    "Ray on this machine died: its raylet or its GCS is gone (killed, or out of memory).\n"
    "What was kept before is safe: give the same command again, and it goes on from there. Fewer `--workers` need less "
    "memory."
)
NODE_DEAD = (
    "this machine's node of the Ray cluster at {address} died: its raylet is gone (killed, out of memory, or `ray "
    "stop`).\nWhat was kept before is safe: start a node here (`ray start`), give the same command again, and it goes "
    "on from there."
)
GONE = (
    "the Ray cluster at {address} has not answered for {seconds:.0f} s: its head is gone, or the way to it.\n"
    "What was kept before is safe: give the same command again once it answers, and it goes on from there."
)


def end_if_stuck(wait: Callable[[], object], calling: threading.RLock, over: threading.Event) -> None:
    """End this process where Ray died and a call into it does not return. A driver that does other work goes on.

    Args:
        wait: returns when Ray is dead.
        calling: what the driver holds while it calls Ray.
        over: set when nobody needs Ray any more.
    """
    wait()
    while calling.acquire(timeout=STUCK_SECONDS):
        calling.release()
        if over.wait(SECONDS_BETWEEN_LOOKS):
            return
    end_at_once(f"puddle: {DEAD}", 2)


def end_if_gone(address: str, host: str, port: int, over: threading.Event) -> None:
    """End this process where an existing cluster does not answer any more.

    Args:
        address: of the cluster, for the message.
        host: of its server.
        port: of its server.
        over: set when nobody needs it any more.
    """
    answered = time.monotonic()
    while not over.wait(SECONDS_BETWEEN_LOOKS):
        with contextlib.suppress(OSError):
            socket.create_connection((host, port), timeout=ANSWER_SECONDS).close()
            answered = time.monotonic()
        if time.monotonic() - answered > GONE_SECONDS and not over.is_set():
            end_at_once(f"puddle: {GONE.format(address=address, seconds=GONE_SECONDS)}", 2)
