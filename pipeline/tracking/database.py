"""Where MLflow keeps what is mirrored: a store's own database, or a server; and whether it can be reached."""

from __future__ import annotations

import socket
import sqlite3
import urllib.error
import urllib.request
from contextlib import closing
from pathlib import Path
from urllib.parse import urlsplit

from pipeline.errors import PuddleError

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
_A_QUESTION = "/api/2.0/mlflow/experiments/search?max_results=1"  # /health would not ask the server's database
_PORTS = {"postgresql": 5432, "mysql": 3306, "mssql": 1433}


def database_uri(store: Path) -> str:
    """Return the URI of a store's own MLflow database; refuse a path that MLflow would read as another one."""
    from sqlalchemy import make_url  # installed with MLflow

    database = str(store.resolve() / "mlflow.db")
    uri = f"sqlite:///{database}"  # not escaped, because MLflow creates the folder of the path as it stands
    if make_url(uri).database != database or not database.isprintable():  # bytes that are not text are not printable
        raise PuddleError(
            f"{store}: expected a path that MLflow accepts unchanged, got one with ?, % or bytes that are not text. "
            f"Nothing was written elsewhere. Use a plainer path for the store, or your own MLflow with --tracking-uri."
        )
    return uri


def check_reachable(uri: str) -> None:
    """Check within seconds that a server answers, where MLflow itself would try for minutes.

    Raises:
        PuddleError: it does not answer, or reports that it fails.
    """
    parts = urlsplit(uri)
    if parts.scheme in ("http", "https"):
        try:
            with urllib.request.urlopen(f"{uri.rstrip('/')}{_A_QUESTION}", timeout=_SECONDS_TO_ANSWER):
                return
        except urllib.error.HTTPError as answer:
            if answer.code < 500:  # no experiment yet, or it wants a user's name, which MLflow's client sends
                return
            raise PuddleError(f"{uri} answers {answer.code} {answer.reason}") from None
        except (OSError, ValueError) as error:
            raise PuddleError(f"{uri} does not answer ({getattr(error, 'reason', error)})") from None
    port = parts.port or _PORTS.get(parts.scheme.partition("+")[0])
    if parts.hostname is None or port is None:
        return
    try:
        socket.create_connection((parts.hostname, port), timeout=_SECONDS_TO_ANSWER).close()
    except OSError as error:
        raise PuddleError(f"{parts.hostname}:{port} does not answer ({error})") from None


def check_own_database(store: Path) -> None:
    """Check that a store has a database that MLflow can use. Raises PuddleError otherwise."""
    database = store / "mlflow.db"
    if not database.is_file():
        raise PuddleError(f"{store}: expected mlflow.db, found none. `puddle study` creates it.")
    try:
        with closing(sqlite3.connect(database)) as connection:
            connection.execute("BEGIN IMMEDIATE")  # MLflow writes even when it only reads
            sound = connection.execute("PRAGMA quick_check(1)").fetchone() == ("ok",)
    except sqlite3.Error as error:
        raise PuddleError(
            f"{database}: MLflow cannot use it: {error}. Make it writable; or, if it is damaged, delete it and run "
            f"`puddle study` again, which rebuilds it from the store."
        ) from error
    if not sound:
        raise PuddleError(f"{database}: damaged. Delete it and run `puddle study` again, which rebuilds it.")
