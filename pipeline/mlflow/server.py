"""MLflow's pages: serve them from a store or a database, or find them on a server."""

from __future__ import annotations

import json
import os
import socket
import sys
import urllib.parse
from pathlib import Path
from typing import Any, NoReturn

from pipeline.errors import PuddleError, without_password
from pipeline.mlflow.database import (
    MLFLOW_ENVIRONMENT,
    artifacts_uri,
    database_uri,
    experiment_id,
    explained,
    open_client,
)

_VIEW = "puddle"  # name of the shared view that the list of studies opens with
_STUDIES = "tags.`puddle.kind` = 'study'"
_HEADLINES, _MOST_HEADLINES = ("m.", "score.", "share."), 4  # more would push the presets off the screen


def show_ui(store: Path, port: int, *, uri: str | None = None, study: str | None = None) -> None:
    """Print the address of the runs page.

    Where MLflow is a server already, that is all. Otherwise this process becomes MLflow's server, so that signals reach
    the server itself.

    Args:
        store: the store's folder.
        port: port of the server on the loopback interface.
        uri: URI of an MLflow server or database; the store's own database by default.
        study: name of the study whose runs are shown; the list of studies by default.
    """
    if uri is None and not (store / "mlflow.db").is_file():
        raise PuddleError(f"{store}: expected mlflow.db, found none. `puddle study` creates it.")
    try:
        client = open_client(store, uri)
        experiment = experiment_id(client)
        if experiment is not None:
            view = _trials(client, experiment, study) if study else _view(client, experiment)
            client.set_experiment_tag(experiment, f"mlflow.sharedViewState.{_view_name(study)}", json.dumps(view))
        if study and not (experiment and client.search_runs([experiment], f"tags.study = '{study}'", max_results=1)):
            raise PuddleError(
                f"{without_password(uri or str(store))}: MLflow has no runs of a study {study!r}; "
                f"`puddle ui` lists those it has"
            )
    except PuddleError:
        raise
    except Exception as error:  # of any database's driver
        raise PuddleError(explained(error, store, uri)) from None
    if uri is not None and urllib.parse.urlsplit(uri).scheme in ("http", "https"):
        print(f"MLflow: {_runs_page(without_password(uri).rstrip('/'), experiment, study)}")
        return
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise PuddleError(f"port {port} is not available ({error.strerror}). Choose another: --port.") from error
    words = [] if uri else ["--default-artifact-root", artifacts_uri(store)]
    _serve(uri or database_uri(store), port, words, _runs_page(f"http://127.0.0.1:{port}", experiment, study))


def _runs_page(server: str, experiment: str | None, study: str | None = None) -> str:
    """Return the address of an experiment's runs, as MLflow shows them for model training rather than for agents."""
    query = f"workflowType=machine_learning&viewStateShareKey={_view_name(study)}"
    page = "experiments" if experiment is None else f"experiments/{experiment}/runs"
    return f"{server}/#/{page}?{query}"


def _view_name(study: str | None) -> str:
    return _VIEW if study is None else f"{_VIEW}-{study}"


def _trials(client: Any, experiment: str, study: str) -> dict[str, Any]:
    """Return MLflow's list of the trials of a study as it is shared: where they evolved, and how far they get."""
    only = f"tags.study = '{study}' AND tags.stage = 'transfer' AND tags.`puddle.kind` = "
    columns = ["metrics.`zero_shot`", "metrics.`predicted`", "params.`environment`", "params.`depth`"]
    above = {run.info.run_id: True for run in client.search_runs([experiment], f"{only}'stage'")}
    view = {"searchFilter": f"{only}'trial'", "selectedColumns": columns, "runsExpanded": above}
    return view | {"orderByKey": "metrics.`zero_shot`", "orderByAsc": False}


def _view(client: Any, experiment: str) -> dict[str, Any]:
    """Return MLflow's list of studies as it is shared: with columns for their presets and headline figures."""
    studies = client.search_runs([experiment], _STUDIES, max_results=100)
    found = {name for run in studies for name in run.data.metrics if name.startswith(_HEADLINES)}
    # True slush, residual slush and then the others, each in metres and as a share
    headlines = sorted(found, key=lambda name: name.partition(".")[::-1], reverse=True)
    columns = ["attributes.`Created`", "tags.`preset`"]
    columns += [f"metrics.`{name}`" for name in headlines[:_MOST_HEADLINES]]
    return {"searchFilter": _STUDIES, "selectedColumns": columns}


def _serve(uri: str, port: int, words: list[str], page: str) -> NoReturn:
    server = [sys.executable, "-m", "mlflow", "server", "--backend-store-uri", uri, *words]
    server += ["--host", "127.0.0.1", "--port", str(port), "--workers", "1", "--uvicorn-opts", "--log-level warning"]
    print(f"MLflow: {page} (in about ten seconds; Ctrl-C stops it)", flush=True)
    os.execve(server[0], server, MLFLOW_ENVIRONMENT | os.environ)
