"""MLflow's pages: serve them from a store or a database, or find them on a server."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import sqlite3
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
import webbrowser
from pathlib import Path
from typing import NoReturn

from pipeline.errors import PuddleError
from pipeline.tracking.database import MLFLOW_ENVIRONMENT, check_own_database, check_reachable, database_uri
from pipeline.tracking.mlflow_writer import EXPERIMENT

_SECONDS_TO_START = 120.0  # time for the server to start before its address is no longer announced


def show_ui(store: Path, port: int, *, uri: str | None = None, study: str | None = None) -> None:
    """Print the address of the runs page, and open it where there is a desktop.

    Where MLflow is a server already, that is all. Otherwise this process becomes MLflow's server, so that signals reach
    the server itself.

    Args:
        store: the store's folder.
        port: port of the server on the loopback interface.
        uri: URI of an MLflow server or database; the store's own database by default.
        study: name of the study to show; all by default.

    Raises:
        PuddleError: the database or the server can't be used, or the port is taken.
    """
    if uri is not None and urllib.parse.urlsplit(uri).scheme in ("http", "https"):
        _announce(runs_page(uri.rstrip("/"), _experiment_on_server(uri), study), "")
        return
    if uri is None:
        check_own_database(store)
        uri, experiment = database_uri(store), _experiment_in(store / "mlflow.db")
        words = ["--default-artifact-root", (store.resolve() / "mlartifacts").as_uri()]
    else:
        check_reachable(uri)
        experiment, words = _experiment_of_database(uri), []
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise PuddleError(f"port {port} is not available ({error.strerror}). Choose another: --port.") from error
    _serve(uri, port, words, runs_page(f"http://127.0.0.1:{port}", experiment, study))


def runs_page(server: str, experiment: str | None, study: str | None = None) -> str:
    """Return the address of an experiment's runs, as MLflow shows them for model training rather than for agents.

    Args:
        server: address of the server.
        experiment: ID of the experiment; None if there is none yet.
        study: name of the study whose runs are shown; all by default.
    """
    query = {"workflowType": "machine_learning"}
    if study is not None:
        query["searchFilter"] = f"tags.study = '{study}'"
    page = "experiments" if experiment is None else f"experiments/{experiment}/runs"
    return f"{server}/#/{page}?{urllib.parse.urlencode(query, quote_via=urllib.parse.quote)}"


def _serve(uri: str, port: int, words: list[str], page: str) -> NoReturn:
    server = [sys.executable, "-m", "mlflow", "server", "--backend-store-uri", uri, *words]
    server += ["--host", "127.0.0.1", "--port", str(port), "--workers", "1", "--uvicorn-opts", "--log-level warning"]
    sys.stdout.flush()
    pid = os.getpid()
    if os.fork() == 0:  # the child's child announces the page, so that the server has no child to wait for
        if os.fork() == 0:
            with contextlib.suppress(KeyboardInterrupt):
                _announce_when_up(port, pid, page)
        os._exit(0)
    os.wait()
    os.execve(server[0], server, MLFLOW_ENVIRONMENT | os.environ)


def _announce_when_up(port: int, pid: int, page: str) -> None:
    end = time.monotonic() + _SECONDS_TO_START
    while time.monotonic() < end:
        try:
            os.kill(pid, 0)
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/health", timeout=1):
                break
        except ProcessLookupError:
            return
        except OSError:
            time.sleep(0.1)
    _announce(page, " (Ctrl-C stops it)")


def _announce(page: str, advice: str) -> None:
    print(f"MLflow: {page}{advice}", flush=True)
    desktop = sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if desktop and sys.stdout.isatty():
        webbrowser.open(page)


def _experiment_in(database: Path) -> str | None:
    """Return the ID of puddle's experiment in a SQLite database; None if there is none yet."""
    with contextlib.closing(sqlite3.connect(database)) as connection, contextlib.suppress(sqlite3.OperationalError):
        row = connection.execute("SELECT experiment_id FROM experiments WHERE name = ?", (EXPERIMENT,)).fetchone()
        return None if row is None else str(row[0])
    return None


def _experiment_of_database(uri: str) -> str | None:
    from mlflow.tracking import MlflowClient

    try:
        found = MlflowClient(uri).get_experiment_by_name(EXPERIMENT)
    except Exception as error:  # of any database's driver
        raise PuddleError(f"{uri}: MLflow cannot use it: {str(error).splitlines()[0]}") from error
    return None if found is None else str(found.experiment_id)


def _experiment_on_server(uri: str) -> str | None:
    """Return the ID of puddle's experiment on a server; None if it has none yet or wants a user's name."""
    check_reachable(uri)
    address = f"{uri.rstrip('/')}/api/2.0/mlflow/experiments/get-by-name?experiment_name={EXPERIMENT}"
    try:
        with urllib.request.urlopen(address, timeout=10) as answer:
            return str(json.load(answer)["experiment"]["experiment_id"])
    except urllib.error.HTTPError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PuddleError(f"{uri}: expected an MLflow server, got {error!r}") from error
