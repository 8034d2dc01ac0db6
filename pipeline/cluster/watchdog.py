"""The watchdog: end a driver whose Ray is gone, with a message. A call into Ray may then never return."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable

from pipeline.cluster.process import end_at_once

STUCK_SECONDS = 10.0  # time that a call into Ray may last once Ray is dead [s]
SILENT_SECONDS = 120.0  # time that any call into Ray may last [s]; on a busy machine some take ten seconds
GONE_SECONDS = 45.0  # time that an existing cluster may be silent [s]; Ray ends the process after a minute
CHECK_INTERVAL = 1.0  # time between two checks [s]

_ANSWER_SECONDS = 5.0  # time for the answer to one check [s]; with GONE_SECONDS it stays below Ray's minute

RAY_DIED = (
    "Ray on this machine died: its raylet or its GCS is gone (killed, or out of memory) or stopped.\n"
    "Committed results are safe: run the same command again to resume. Fewer `--workers` need less memory."
)
SILENT = (
    "Ray has not answered for {seconds:.0f} s: one of its processes is stopped or hangs.\n"
    "Committed results are safe: run the same command again to resume."
)
NODE_DIED = (
    "this machine's node of the Ray cluster at {address} died: its raylet is gone (killed, out of memory, or `ray "
    "stop`).\nCommitted results are safe: start a node here (`ray start`) and run the same command again to resume."
)
UNREACHABLE = (
    "the Ray cluster at {address} has not answered for {seconds:.0f} s: its head or the network is down.\n"
    "Committed results are safe: run the same command again once the cluster answers."
)


class Calls:
    """The driver's calls into Ray, one after another: a context that it holds during each."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._n_begun = self._n_ended = 0

    def __enter__(self) -> None:
        self._lock.acquire()
        self._n_begun += 1

    def __exit__(self, *_: object) -> None:
        self._n_ended += 1
        self._lock.release()

    @property
    def pending(self) -> int | None:
        """Number of the call that lasts; None between calls."""
        return self._n_begun if self._n_begun > self._n_ended else None

    def have_ended(self, timeout: float) -> bool:
        """Wait for the end of the present call; return whether it ended."""
        if ended := self._lock.acquire(timeout=timeout):
            self._lock.release()
        return ended


def end_if_stuck(wait: Callable[[], object], calls: Calls, over: threading.Event) -> None:
    """End this process if Ray died and a call into it does not return; a driver that does other work goes on.

    Args:
        wait: returns when Ray is dead.
        calls: the driver's calls into Ray.
        over: set when Ray is no longer needed.
    """
    wait()
    while calls.have_ended(STUCK_SECONDS):
        if over.wait(CHECK_INTERVAL):
            return
    end_at_once(f"puddle: {RAY_DIED}", 2)


def end_if_silent(calls: Calls, over: threading.Event) -> None:
    """End this process if a call into Ray does not return, as where the raylet is stopped; Ray would wait for ever.

    Checks count, not time: while this process is stopped (Ctrl-Z), none is made.
    """
    last, n_checks = None, 0
    while not over.wait(CHECK_INTERVAL):
        pending = calls.pending
        n_checks = n_checks + 1 if pending is not None and pending == last else 0
        last = pending
        if n_checks * CHECK_INTERVAL >= SILENT_SECONDS:
            end_at_once(f"puddle: {SILENT.format(seconds=SILENT_SECONDS)}", 2)


def end_if_unreachable(
    address: str,
    host: str,
    port: int,
    over: threading.Event,
    *,
    clock: Callable[[], float] = time.monotonic,
    connect: Callable[..., socket.socket] = socket.create_connection,
    end: Callable[[str, int], object] = end_at_once,
) -> None:
    """End this process if an existing cluster stops answering.

    Args:
        address: the cluster's address, for the message.
        host, port: its GCS server.
        over: set when the cluster is no longer needed.
        clock: returns the time [s].
        connect: connects to a host and port within a time-out.
        end: ends this process with a message and an exit code.
    """
    answered = clock()
    while not over.wait(CHECK_INTERVAL):
        with contextlib.suppress(OSError):
            connect((host, port), timeout=_ANSWER_SECONDS).close()
            answered = clock()
        if clock() - answered > GONE_SECONDS and not over.is_set():
            end(f"puddle: {UNREACHABLE.format(address=address, seconds=GONE_SECONDS)}", 2)
