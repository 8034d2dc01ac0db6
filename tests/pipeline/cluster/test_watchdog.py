"""A driver whose existing cluster is gone ends, and says so; one whose cluster was away for a moment goes on."""

import signal
import socket
import subprocess
import sys
import time

import pytest

from pipeline.cluster import watchdog
from pipeline.cluster.watchdog import SILENT, UNREACHABLE

RAYS_OWN_SECONDS = 60.0
"""After which Ray ends a driver whose cluster is silent."""

DRIVER = """
import sys, threading
from pipeline.cluster import watchdog
watchdog.GONE_SECONDS, watchdog.CHECK_INTERVAL = 2.0, 0.05
over = threading.Event()
looks = threading.Thread(target=watchdog.end_if_unreachable, args=("head:6379", "127.0.0.1", int(sys.argv[1]), over))
looks.start()
print("up", flush=True)
sys.stdin.read()
over.set()
looks.join()
"""


def server(port: int = 0) -> socket.socket:
    return socket.create_server(("127.0.0.1", port), backlog=100)


def driving(port: int) -> subprocess.Popen[str]:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    driver = subprocess.Popen([sys.executable, "-c", DRIVER, str(port)], text=True, **pipes)
    assert driver.stdout is not None
    assert driver.stdout.readline() == "up\n"
    return driver


def test_a_driver_ends_when_its_cluster_is_gone():
    with server() as listening:
        driver = driving(listening.getsockname()[1])
        time.sleep(0.5)
        assert driver.poll() is None
    assert driver.wait(timeout=30) == 2
    _, said = driver.communicate()
    assert said == f"\npuddle: {UNREACHABLE.format(address='head:6379', seconds=2.0)}\n"


def test_a_driver_goes_on_when_its_cluster_comes_back():
    with server() as listening:
        port = listening.getsockname()[1]
        driver = driving(port)
    time.sleep(0.5)
    with server(port):
        time.sleep(3.0)
        assert driver.poll() is None
        assert driver.communicate(timeout=30) == ("", "")
    assert driver.returncode == 0


def test_a_way_to_a_cluster_that_swallows_what_is_sent_is_told_before_ray_ends_the_driver():
    """Connections are refused at first, and later nothing comes back at all: time passes in both, and in waits."""
    now = 0.0

    class Over:
        def wait(self, seconds: float) -> bool:
            nonlocal now
            now += seconds
            return False

        def is_set(self) -> bool:
            return False

    class Ended(Exception):  # noqa: N818
        pass

    def connect(server: tuple[str, int], timeout: float) -> socket.socket:
        nonlocal now
        if now < watchdog.GONE_SECONDS - 1.0:
            raise ConnectionRefusedError
        now += timeout
        raise TimeoutError

    def end(message: str, code: int) -> None:
        raise Ended

    with pytest.raises(Ended):
        watchdog.end_if_unreachable("head:6379", "head", 6379, Over(), clock=lambda: now, connect=connect, end=end)
    assert watchdog.GONE_SECONDS < now < RAYS_OWN_SECONDS - 5.0


SILENT_RAY = """
import os, sys, threading, time
from pipeline.cluster import watchdog
watchdog.SILENT_SECONDS, watchdog.CHECK_INTERVAL = 1.0, 0.05
calls, over = watchdog.Calls(), threading.Event()
threading.Thread(target=watchdog.end_if_silent, args=(calls, over), daemon=True).start()
for _ in range(8):  # more time than the limit, in calls that return, and in other work
    for context in (calls, threading.Lock()):
        with context:
            time.sleep(0.2)
print("up", flush=True)
with calls:
    sys.stdin.read() if sys.argv[1] == "hangs" else None
"""


@pytest.mark.parametrize(("what", "code"), [("hangs", 2), ("returns", 0)])
def test_a_driver_ends_when_a_call_into_ray_does_not_return(what, code):
    """A stopped raylet lets calls wait for ever, and with them the handlers of signals."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", SILENT_RAY, what], text=True, **pipes) as driver:
        assert driver.stdout.readline() == "up\n"
        if what == "hangs":
            driver.send_signal(signal.SIGSTOP)  # time in which the driver itself is stopped does not count
            time.sleep(1.5)
            driver.send_signal(signal.SIGCONT)
            time.sleep(0.3)
            assert driver.poll() is None
        assert driver.wait(timeout=30) == code
        assert driver.stderr.read() == (f"\npuddle: {SILENT.format(seconds=1.0)}\n" if code else "")
