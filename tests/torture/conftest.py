"""Fixtures of the torture tests: the fork server, and folders for stores."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent


class ForkServer:
    """The process of tests/torture/fork_server.py."""

    def __init__(self, size: str, inside: Sequence[str] = ()) -> None:
        self._process = subprocess.Popen(
            [*inside, sys.executable, str(HERE / "fork_server.py"), size],
            env={**os.environ, "PYTHONPATH": str(HERE.parents[1]), "OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.pid = self._process.pid

    def execute(self, **command: Any) -> Any:
        """Have a child execute a command; return the answer."""
        self._process.stdin.write(json.dumps(command) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, "the fork server is dead"
        return json.loads(line)

    def drive(self, root: Path, **command: Any) -> dict[str, Any]:
        """Drive the study in a store; return what the driver recorded, and how it ended."""
        answer = self.execute(roots=[str(root)], **command)
        return {**next(iter(answer["answers"]), {}), **answer}  # no answers if the driver ended before its study

    def finish(self, roots: Sequence[Path], **command: Any) -> list[dict[str, Any]]:
        """Drive the study in some stores to its end; check that all is well afterwards."""
        answer = self.execute(roots=[str(root) for root in roots], **command)
        assert answer["status"] == 0, answer["traceback"]
        for one in answer["answers"]:
            assert "error" not in one, one["error"]
            assert one["wrong"] == []
        return answer["answers"]

    def drive_at_once(self, root: Path, studies: Sequence[str], **command: Any) -> list[dict[str, Any]]:
        """Drive studies in one store, each in a process of its own; return what each driver recorded."""
        answer = self.execute(roots=[str(root)], studies=studies, **command)
        for one in answer:
            assert one["status"] == 0, one["traceback"]
        return [one["answers"][0] for one in answer]

    def close(self) -> None:
        self._process.stdin.close()
        assert self._process.wait(timeout=120) == 0


@pytest.fixture(scope="session")
def start_fork_server(request: pytest.FixtureRequest) -> Iterator[Callable[..., ForkServer]]:
    """Start fork servers; the arguments, if any, are a program that execs its remaining arguments."""
    size = "large" if request.config.getoption("--torture") else "small"
    with contextlib.ExitStack() as stack:
        yield lambda *inside: stack.enter_context(contextlib.closing(ForkServer(size, inside)))


@pytest.fixture(scope="session")
def fork_server(start_fork_server: Callable[..., ForkServer]) -> ForkServer:
    return start_fork_server()


@pytest.fixture
def new_folder() -> Iterator[Callable[[], Path]]:
    """Make folders for stores, in memory where there is room: thousands are made."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(prefix="puddle-torture-", dir=memory if memory.is_dir() else None) as top:
        yield lambda: Path(tempfile.mkdtemp(dir=top))


@pytest.fixture
def short_folder() -> Iterator[Path]:
    """A folder whose path leaves room for the names of Ray's sockets."""
    folder = Path(tempfile.mkdtemp(prefix="puddle-", dir="/tmp"))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)
