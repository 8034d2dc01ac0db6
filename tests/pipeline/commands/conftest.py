"""A copy of a finished study, which a test may change; no command imports MLflow, which takes seconds."""

from pathlib import Path

import pytest
from command_line import WITHOUT_MLFLOW

from pipeline.store.store import Store


@pytest.fixture(autouse=True)
def without_mlflow(monkeypatch) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", WITHOUT_MLFLOW[1])


@pytest.fixture
def store(options) -> Store:
    """A copy of a store with the finished study tiny."""
    return Store.open(Path(options[-1]), create=False)
