"""Locks: who waits for another process learns which one, and does not wait for ever."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.errors import PuddleError
from pipeline.locks import holders_of
from pipeline.store import disk
from pipeline.store.store import Store
from pipeline.tracking import mirror

HOLDER = """
import sys
from pathlib import Path
from pipeline.store import disk
with disk.locked(Path(sys.argv[1])):
    print("locked", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture
def hold():
    """Hold a lock in another process, which is stopped as by Ctrl-Z."""
    started: list[subprocess.Popen] = []

    def hold(path: Path) -> subprocess.Popen:
        command = [sys.executable, "-c", HOLDER, str(path)]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout.readline() == "locked\n"
        process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED)
        return process

    yield hold
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.skipif(not Path("/proc/locks").exists(), reason="only Linux tells who holds a lock")
def test_a_stopped_process_with_a_lock_is_named(store: Store, hold, monkeypatch) -> None:
    lock = store.root / "commit.lock"
    process = hold(lock)
    named = rf"{lock} has been locked for 0 s by process {process.pid} on .* which is stopped, since 20.*kill -CONT"
    with pytest.raises(PuddleError, match=named), disk.locked(lock, seconds=0.3):
        raise AssertionError("took the lock")
    process.send_signal(signal.SIGCONT)
    assert " stopped" not in holders_of(lock)
    process.stdin.write("\n")
    process.stdin.flush()
    with disk.locked(lock):  # it waits for the other process to end
        assert f"process {os.getpid()} " in holders_of(lock)

    said: list[str] = []
    tracker = mirror.Tracker(store.root, say=said.append)
    process = hold(store.root / "mlflow.lock")
    monkeypatch.setattr(mirror, "_SECONDS_TO_WAIT", 0.1)
    monkeypatch.setattr(mirror, "_SECONDS_WHEN_WARNED", 0.1)
    for _ in range(2):
        tracker.mirror(mirror.Run("tiny", "tiny"), mirror.Run("collect", "c"))
    assert (
        len(said) == 1 and f"by process {process.pid} on" in said[0] and "The study continues without MLflow" in said[0]
    )
