"""Where MLflow keeps what is mirrored: a store's own database, or a server; and puddle's experiment there."""

from __future__ import annotations

import contextlib
import logging
import os
import sqlite3
from pathlib import Path
from typing import Any

from pipeline.errors import PuddleError, without_password

EXPERIMENT = "puddle"
MLFLOW_ENVIRONMENT = {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",  # its job workers outlive a SIGTERM
    "MLFLOW_LOGGING_LEVEL": "WARNING",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",  # an absent server costs seconds per stage, by default minutes
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "10",
}
"""Environment variables for MLflow in this process and for its server; the user's own values win."""

_SECONDS_TO_ANSWER = 3.0  # time for a server to answer before it counts as unreachable
_OTHER_VERSION, _DAMAGED = ("schema", "revision"), ("not a database", "malformed", "no such")  # words of errors


def database_uri(store: Path) -> str:
    """Return the URI of a store's own MLflow database."""
    from sqlalchemy.engine import URL

    # Of "sqlite:///" MLflow would create the folder as it is spelt in the URI, with its escapes.
    return URL.create("sqlite+pysqlite", database=str(store.resolve() / "mlflow.db")).render_as_string()


def artifacts_uri(store: Path) -> str:
    """Return the URI of the folder for a store's artifacts."""
    return (store.resolve() / "mlartifacts").as_uri()


def open_client(store: Path, uri: str | None) -> Any:
    """Return an MLflow client for a URI, or for the store's own database, which follows the store if it was moved."""
    for name, value in MLFLOW_ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    if uri is not None:
        check_reachable(uri)
    from mlflow.store.db import utils
    from mlflow.tracking import MlflowClient

    utils.MAX_RETRY_COUNT = 2  # a database that can't be opened costs a moment per stage, by default 100 s
    logging.getLogger("mlflow").setLevel(logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)
    if uri is None and (store / "mlflow.db").exists():
        _follow(store)
    return MlflowClient(uri or database_uri(store))


def _follow(store: Path) -> None:
    """Have the artifacts of a store's own database lie in the store: MLflow keeps the folder they were first in."""
    here = artifacts_uri(store)
    with contextlib.closing(sqlite3.connect(store / "mlflow.db")) as connection, contextlib.suppress(sqlite3.Error):
        found = connection.execute("SELECT artifact_location FROM experiments WHERE name = ?", (EXPERIMENT,)).fetchone()
        if found and found[0] != here:
            for table, column in (("experiments", "artifact_location"), ("runs", "artifact_uri")):
                connection.execute(f"UPDATE {table} SET {column} = replace({column}, ?, ?)", (found[0], here))
            connection.commit()


def experiment_id(client: Any) -> str | None:
    """Return the ID of puddle's experiment, restored if it was deleted; None if there is none."""
    found = client.get_experiment_by_name(EXPERIMENT)
    if found is not None and found.lifecycle_stage == "deleted":
        client.restore_experiment(found.experiment_id)
    return None if found is None else str(found.experiment_id)


def explained(error: Exception, store: Path, uri: str | None) -> str:
    """Say in a sentence why MLflow fails, and what to do."""
    if isinstance(error, PuddleError):  # a lock, or a server that does not answer
        return str(error).rstrip(".")
    place = uri or str(store / "mlflow.db")
    reason = (str(error) or type(error).__name__).splitlines()[0].partition(". ")[0].rstrip(".")
    of_other_version = any(word in reason for word in _OTHER_VERSION)
    is_unfit = of_other_version or any(word in reason for word in _DAMAGED)
    if of_other_version:
        reason = "it was made by another version of MLflow"
    advice = ""
    if uri is None and is_unfit:  # a sound one is not to be deleted
        advice = "; delete it, and `puddle study` rebuilds it from the store"
    elif uri is not None and "://" not in uri:
        advice = "; unset MLFLOW_TRACKING_URI, and puddle uses a database in the store"
    return without_password(f"{place}: MLflow cannot use it: {reason}{advice}")


def check_reachable(uri: str) -> None:
    """Check within seconds that a server answers, where MLflow itself would try for minutes."""
    if not uri.startswith(("http://", "https://")):
        return
    from mlflow.exceptions import MlflowException
    from mlflow.tracking._tracking_service.utils import get_default_host_creds
    from mlflow.utils.rest_utils import http_request  # as MLflow's client asks: with its certificates and passwords

    try:
        credentials = get_default_host_creds(uri)
        http_request(credentials, "/health", "GET", timeout=_SECONDS_TO_ANSWER, max_retries=0, raise_on_status=False)
    except MlflowException as error:
        reason = str(error).rpartition(": ")[2].partition(". ")[0].partition(" (")[0].strip("'\")")
        raise PuddleError(without_password(f"{uri} does not answer ({reason})")) from None
