"""What the torture shares: the nursery, which forks drivers that may die in milliseconds, and a place for stores."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent


class Nursery:
    """The process of tests/torture/nursery.py."""

    def __init__(self, size: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(HERE / "nursery.py"), size],
            env={**os.environ, "PYTHONPATH": str(HERE.parents[1]), "OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.keys: list[str] = self._answer()["keys"]
        """Of every piece of the study."""

    def _answer(self) -> dict[str, Any]:
        line = self._process.stdout.readline()
        assert line, "the nursery is dead"
        return json.loads(line)

    def drive(self, root: Path, **command: Any) -> dict[str, Any]:
        """Fork a driver of the study in a store; return what it said, and how it ended."""
        self._process.stdin.write(json.dumps({"root": str(root), **command}) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def finish(self, root: Path, **command: Any) -> dict[str, Any]:
        """Fork a driver that is to get to its end undisturbed."""
        answer = self.drive(root, **command)
        assert answer["status"] == 0 and "error" not in answer, answer.get("traceback") or answer.get("error")
        assert answer["wrong"] == []
        return answer

    def close(self) -> None:
        self._process.stdin.close()
        assert self._process.wait(timeout=30) == 0


@pytest.fixture(scope="session")
def nursery(request: pytest.FixtureRequest) -> Iterator[Nursery]:
    one = Nursery("large" if request.config.getoption("--torture") else "small")
    try:
        yield one
    finally:
        one.close()


@pytest.fixture
def place() -> Iterator[Callable[[], Path]]:
    """Give folders for stores, in memory where there is room: thousands are made."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(prefix="puddle-torture-", dir=memory if memory.is_dir() else None) as top:

        def make() -> Path:
            for old in Path(top).iterdir():
                shutil.rmtree(old)
            return Path(tempfile.mkdtemp(dir=top))

        yield make
