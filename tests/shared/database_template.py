"""MLflow's database of a new store, copied from one that MLflow has made in this process: each takes it a second."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import PuddleError
from pipeline.mlflow import mirror
from pipeline.mlflow.database import database_uri

_open_experiment = mirror._open_experiment


def make_database(folder: Path) -> Path:
    """Have MLflow make an empty database; return its path."""
    from mlflow.tracking import MlflowClient

    folder.mkdir(exist_ok=True)
    MlflowClient(database_uri(folder)).search_experiments()
    return folder / "mlflow.db"


@contextmanager
def copied_databases(folder: Path) -> Iterator[None]:
    """Give every store without a database a copy of an empty one, which lies in a folder once it is needed."""

    def open_experiment(store: Path, uri: str | None) -> Any:
        with suppress(OSError, PuddleError):  # the mirror then says what is wrong
            database_uri(store)
            if uri is None and not (store / "mlflow.db").exists():
                empty = folder / "mlflow.db"
                shutil.copyfile(empty if empty.exists() else make_database(folder), store / "mlflow.db")
        return _open_experiment(store, uri)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mirror, "_open_experiment", open_experiment)
        yield


@contextmanager
def own_databases() -> Iterator[None]:
    """Have MLflow make the database of every store, in spite of :func:`copied_databases`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mirror, "_open_experiment", _open_experiment)
        yield
