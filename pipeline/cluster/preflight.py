"""The preflight check, which asks whether an existing Ray cluster answers before anything waits for it."""

import select
import socket
import subprocess
import sys
import tempfile
from subprocess import PIPE
from urllib.parse import urlsplit

from pipeline.cluster import preflight_probe
from pipeline.errors import PuddleError

CONNECT_SECONDS = 15.0  # time that an existing cluster has to accept a connection [s]
ADMIT_SECONDS = 45.0  # time that it has to admit us [s]; one is usual, twenty where its nodes have just started
_PROBE_START_SECONDS = 120.0  # time that the probe has to start on a busy machine [s]; one second is usual


def check_reachable(address: str, seconds: float = ADMIT_SECONDS) -> None:
    """Check that a cluster accepts a connection and admits us within some seconds.

    ``ray.init`` takes two minutes to fail, so a separate process tries it. That process ends with this one, however
    this one ends.
    """
    if address != "auto":
        server = server_of(address)
        try:
            socket.create_connection(server, timeout=CONNECT_SECONDS).close()
        except OSError as error:
            raise unusable(address, f"nothing answers there ({error})") from error
    command = [sys.executable, "-P", preflight_probe.__file__, address]
    # In its own session, so that Ctrl-C in the terminal does not reach it directly.
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(command, stdin=PIPE, stdout=PIPE, stderr=errors, start_new_session=True) as probe,
    ):
        try:
            reason = _refusal(probe, seconds)
        finally:
            probe.kill()
        if reason is not None:
            probe.wait()
            errors.seek(0)
            message = (errors.read().decode(errors="replace").strip() or "none").splitlines()[-1]
            raise unusable(address, f"{reason}. Ray's last message: {message}")


def _refusal(probe: subprocess.Popen[bytes], seconds: float) -> str | None:
    """Wait for the probe to end; return why the cluster refused it, or None."""
    assert probe.stdout is not None
    if not select.select([probe.stdout], [], [], _PROBE_START_SECONDS)[0]:
        return f"the process that tries to join did not start within {_PROBE_START_SECONDS:.0f} s"
    probe.stdout.readline()  # Ray is imported; from here on the cluster's own time counts
    try:
        return "it refused the connection" if probe.wait(seconds) else None
    except subprocess.TimeoutExpired:
        return f"it did not admit us within {seconds:.0f} s"


def server_of(address: str) -> tuple[str, int]:
    """Split an address into host and port; refuse any other."""
    parts = urlsplit(f"//{address}")
    try:
        port = parts.port
    except ValueError:
        port = None
    if not parts.hostname or port is None:
        raise unusable(address, "expected host:port or auto")
    return parts.hostname, port


def unusable(address: str, reason: str) -> PuddleError:
    """Build the error for a cluster that cannot be used."""
    return PuddleError(
        f"cannot use the Ray cluster at {address}: {reason}\n"
        f"Expected a running cluster with this machine's versions of Python and Ray and, if it requires a token, "
        f"RAY_AUTH_MODE=token with RAY_AUTH_TOKEN or RAY_AUTH_TOKEN_PATH. "
        f"Check the address (`ray status` on the head), or omit --address and RAY_ADDRESS to use this machine."
    )
