"""A copy of a finished study, which a test may change."""

from pathlib import Path

import pytest

from pipeline.store.store import Store


@pytest.fixture
def store(options) -> Store:
    """A copy of a store with the finished study tiny."""
    return Store.open(Path(options[-1]), create=False)
