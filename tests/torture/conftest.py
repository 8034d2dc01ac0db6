"""What the torture shares: the nursery, which forks drivers that may die in milliseconds, and a place for stores."""

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


class Nursery:
    """The process of tests/torture/nursery.py."""

    def __init__(self, size: str, inside: Sequence[str] = ()) -> None:
        self._process = subprocess.Popen(
            [*inside, sys.executable, str(HERE / "nursery.py"), size],
            env={**os.environ, "PYTHONPATH": str(HERE.parents[1]), "OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.pid = self._process.pid

    def _answer(self) -> Any:
        line = self._process.stdout.readline()
        assert line, "the nursery is dead"
        return json.loads(line)

    def ask(self, **command: Any) -> Any:
        """Have a command carried out by a child."""
        self._process.stdin.write(json.dumps(command) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def drive(self, root: Path, **command: Any) -> dict[str, Any]:
        """Drive the study in a store; return what the driver noted, and how it ended."""
        told = self.ask(roots=[str(root)], **command)
        return {**next(iter(told["answers"]), {}), **told}  # none where the driver did not come to its study

    def finish(self, roots: Sequence[Path], **command: Any) -> list[dict[str, Any]]:
        """Drive the study in some stores, which should be well afterwards."""
        told = self.ask(roots=[str(root) for root in roots], **command)
        assert told["status"] == 0, told["traceback"]
        for answer in told["answers"]:
            assert "error" not in answer, answer["error"]
            assert answer["wrong"] == []
        return told["answers"]

    def drive_at_once(self, root: Path, studies: Sequence[str], **command: Any) -> list[dict[str, Any]]:
        """Drive studies in one store, each in a process of its own; return what each driver noted."""
        told = self.ask(roots=[str(root)], studies=studies, **command)
        for one in told:
            assert one["status"] == 0, one["traceback"]
        return [one["answers"][0] for one in told]

    def close(self) -> None:
        self._process.stdin.close()
        assert self._process.wait(timeout=120) == 0


@pytest.fixture(scope="session")
def start_nursery(request: pytest.FixtureRequest) -> Iterator[Callable[..., Nursery]]:
    """Start nurseries, each by the words of a program, if any, which becomes it."""
    size = "large" if request.config.getoption("--torture") else "small"
    with contextlib.ExitStack() as stack:
        yield lambda *inside: stack.enter_context(contextlib.closing(Nursery(size, inside)))


@pytest.fixture(scope="session")
def nursery(start_nursery: Callable[..., Nursery]) -> Nursery:
    return start_nursery()


@pytest.fixture
def place() -> Iterator[Callable[[], Path]]:
    """Give folders for stores, in memory where there is room: thousands are made."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(prefix="puddle-torture-", dir=memory if memory.is_dir() else None) as top:
        yield lambda: Path(tempfile.mkdtemp(dir=top))


@pytest.fixture
def short_folder() -> Iterator[Path]:
    """A folder whose path leaves room for those of Ray's sockets."""
    folder = Path(tempfile.mkdtemp(prefix="puddle-", dir="/tmp"))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)
