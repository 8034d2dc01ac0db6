"""Fixtures of the torture tests: quick studies, and folders for stores."""

import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from quick_study import QuickStudy


@pytest.fixture(scope="session")
def tiny() -> QuickStudy:
    return QuickStudy()


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
