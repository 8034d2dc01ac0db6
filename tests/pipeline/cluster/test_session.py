"""A driver that waits for a Ray that died ends, and says so: its call would never return. One that works goes on."""

import contextlib
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence

import psutil
import pytest

from pipeline.cluster.watchdog import RAY_DIED

APART = """
import pathlib, sys
from pipeline.cluster import session, watchdog
session.SESSIONS_FOLDER = pathlib.Path(sys.argv[1])
"""
"""A place of its own: a session that starts sweeps what the dead drivers of other tests left."""

WAITS = """
import threading
watchdog.STUCK_SECONDS = 1.0
with session.session(1) as ours, ours.calling:
    print("up", flush=True)
    threading.Event().wait()
"""
"""A driver in a call that never returns."""

WORKS = """
import time
watchdog.STUCK_SECONDS = watchdog.CHECK_INTERVAL = 0.1
with session.session(1) as ours:
    print("up", flush=True)
    while ours.is_alive():
        time.sleep(0.1)
    time.sleep(2.0)
    with ours.calling:
        print("kept", flush=True)
"""
"""A driver that does other work when its Ray dies, and then calls Ray, which answers."""


@pytest.fixture
def place():
    with tempfile.TemporaryDirectory(dir="/tmp", prefix="apart-") as folder:  # a socket's path in it must be short
        yield folder


def named(processes: Sequence[psutil.Process], name: str) -> list[psutil.Process]:
    """Find those of a name; a process that has ended since it was listed has none."""
    found = []
    for process in processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            if process.name() == name:
                found.append(process)
    return found


def driving(program: str, place: str) -> subprocess.Popen[str]:
    words = [sys.executable, "-c", APART + program, place]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("server", ["raylet", "gcs_server"])
def test_a_driver_that_is_stuck_ends_when_its_ray_dies(server, place):
    driver = driving(WAITS, place)
    try:
        assert driver.stdout is not None
        assert driver.stdout.readline() == "up\n"
        processes = psutil.Process(driver.pid).children(recursive=True)
        (victim,) = named(processes, server)
        victim.send_signal(signal.SIGKILL)
        _, said = driver.communicate(timeout=60)
        assert driver.returncode == 2
        assert f"\npuddle: {RAY_DIED}" in said
        end = time.monotonic() + 60
        while time.monotonic() < end and any(process.is_running() for process in processes):
            time.sleep(0.1)
        assert not any(process.is_running() for process in processes)
    finally:
        driver.kill()
        driver.wait()


def test_a_driver_that_does_other_work_goes_on_when_its_ray_dies(place):
    driver = driving(WORKS, place)
    try:
        assert driver.stdout is not None
        assert driver.stdout.readline() == "up\n"
        children = psutil.Process(driver.pid).children(recursive=True)
        named(children, "raylet")[0].kill()
        assert driver.communicate(timeout=60) == ("kept\n", "")
        assert driver.returncode == 0
    finally:
        driver.kill()
        driver.wait()


CONNECTS = """
from pipeline.cluster import ray_cluster
with ray_cluster("local", 2):
    print("up", flush=True)
"""


def workers_of(driver: psutil.Process) -> Iterator[psutil.Process]:
    """Find the workers that its raylet has started. It has other children, and some are not yet what they will be."""
    for raylet in named(driver.children(recursive=True), "raylet"):
        for process in raylet.children():
            words = process.cmdline()
            if any("default_worker.py" in word for word in words[:3]) or words[:1] == ["ray::IDLE"]:
                yield process


def test_no_worker_can_die_while_the_driver_connects(place):
    """Ray keeps its first driver waiting for the workers that it starts by itself: for ever, if one of them dies."""
    driver, killed = driving(CONNECTS, place), []
    try:
        end = time.monotonic() + 60
        while driver.poll() is None:
            assert time.monotonic() < end, f"the driver hangs; killed {killed}"
            with contextlib.suppress(psutil.Error):
                for worker in workers_of(psutil.Process(driver.pid)):
                    killed.append(" ".join(worker.cmdline()))
                    worker.kill()
            time.sleep(0.02)
        said, errors = driver.communicate()
        assert (driver.returncode, said) == (0, "up\n"), errors
        assert killed == []
    finally:
        driver.kill()
        driver.wait()
