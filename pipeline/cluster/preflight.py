"""Whether an existing Ray cluster answers, before anything else waits for it."""

from __future__ import annotations

import select
import socket
import subprocess
import sys
import tempfile
from subprocess import PIPE
from typing import IO
from urllib.parse import urlsplit

from pipeline.cluster import preflight_probe
from pipeline.errors import PuddleError

CONNECT_SECONDS = 15.0
"""How long an existing cluster may take to answer."""

START_SECONDS = 120.0
"""How long a process that asks it may take to start on a machine that has much else to do; one second is usual."""


def check_reachable(address: str) -> None:
    """Ask whether a cluster answers, in a process that can be given up on: ray.init takes two minutes to say no.

    That process ends with this one, however this one ends.

    Raises:
        PuddleError: nothing answers there, or it does not let us in.
    """
    if address != "auto":
        server = server_of(address)
        try:
            socket.create_connection(server, timeout=CONNECT_SECONDS).close()
        except OSError as error:
            raise unusable(address, f"nothing answers there ({error})") from error
    words = [sys.executable, "-P", preflight_probe.__file__, address]
    # In a session of its own, so that Ctrl-C in the terminal reaches it through us alone.
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(words, stdin=PIPE, stdout=PIPE, stderr=errors, start_new_session=True) as asking,
    ):
        try:
            reason = _refusal(asking)
        finally:
            asking.kill()
        if reason is not None:
            asking.wait()
            raise unusable(address, f"{reason}. Ray's last word: {_last_line(errors)}")


def _refusal(asking: subprocess.Popen[bytes]) -> str | None:
    """Wait for the end of a hello; say why it was not let in, if it was not."""
    assert asking.stdout is not None
    if not select.select([asking.stdout], [], [], START_SECONDS)[0]:
        return f"a process that asks it was not there after {START_SECONDS:.0f} s"
    asking.stdout.readline()  # from here on it is the cluster that takes time
    try:
        return "it did not let us in" if asking.wait(CONNECT_SECONDS) else None
    except subprocess.TimeoutExpired:
        return f"it did not let us in within {CONNECT_SECONDS:.0f} s"


def _last_line(errors: IO[bytes]) -> str:
    errors.seek(0)
    return (errors.read().decode(errors="replace").strip() or "none").splitlines()[-1]


def server_of(address: str) -> tuple[str, int]:
    """Read host and port.

    Raises:
        PuddleError: the address has none.
    """
    parts = urlsplit(f"//{address}")
    try:
        port = parts.port
    except ValueError:
        port = None
    if not parts.hostname or port is None:
        raise unusable(address, "it is not an address; expected host:port or auto")
    return parts.hostname, port


def unusable(address: str, reason: str) -> PuddleError:
    """Make the error of a cluster that can't be used."""
    return PuddleError(
        f"the Ray cluster at {address} can't be used: {reason}\n"
        f"Expected a running cluster with this machine's versions of Python and Ray and, if it asks for a token, "
        f"RAY_AUTH_MODE=token with RAY_AUTH_TOKEN or RAY_AUTH_TOKEN_PATH. "
        f"Check the address (`ray status` on the head), or leave out --address and RAY_ADDRESS to use this machine."
    )
