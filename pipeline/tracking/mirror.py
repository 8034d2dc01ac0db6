"""The MLflow mirror of a store. Only this package imports mlflow.

Every run carries puddle's own keys as tags and is found by them, and only what is missing or different is sent. So
mirroring twice changes nothing, a mirror that fell behind catches up, and one that was deleted is rebuilt by running
the same command again. If MLflow fails, the study goes on: one warning, and the next call sends what is pending.

MLflow takes two seconds to import, so it is imported with the first stage to mirror.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import logging
import math
import os
import socket
import sqlite3
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NoReturn

from pipeline.errors import PuddleError

EXPERIMENT = "puddle"

_MAX_METRICS = 1000  # per log_batch
_MAX_PARAMS = 100  # per log_batch; tags too
_DATASET_DIGEST_LENGTH = 36  # characters that MLflow stores; the whole digest is in the data set's source

_MLFLOW_ENVIRONMENT = {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",  # its job workers outlive a SIGTERM
    "MLFLOW_LOGGING_LEVEL": "WARNING",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",  # an absent server costs seconds per stage, by default minutes
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "10",
}
"""Environment variables for MLflow in this process and for its server; the user's own values win."""


@dataclass(frozen=True)
class Run:
    """A run in MLflow: a study, one of its stages, or a trial of a stage."""

    name: str
    key: str  # identity, unique among its siblings
    params: Mapping[str, Any] = field(default_factory=dict)  # settings used; nested mappings become dotted names
    metrics: Mapping[str, float] = field(default_factory=dict)  # MLflow cannot store infinities and NaN
    curves: Mapping[str, Sequence[float]] = field(default_factory=dict)  # metrics by generation
    steps: Sequence[int] | None = None  # generations of the curves' points, if they are not 0, 1, 2, ...
    tags: Mapping[str, str] = field(default_factory=dict)  # further text to search by
    inputs: Mapping[str, str] = field(default_factory=dict)  # digests by name
    outputs: Mapping[str, str] = field(default_factory=dict)  # digests by name
    artifacts: Mapping[str, bytes] = field(default_factory=dict)  # contents of files to open from the UI, by path
    status: Literal["FINISHED", "FAILED"] | None = None  # None leaves it unchanged, which for a new run is running


class Tracker:
    """Mirrors studies to MLflow. It opens nothing until there is something to mirror."""

    def __init__(self, store: Path, uri: str | None = None, *, say: Callable[[str], None]) -> None:
        """Prepare.

        Args:
            store: the store's folder, which holds the database and the artifacts unless a URI is given.
            uri: URI of an MLflow server or database; defaults to MLFLOW_TRACKING_URI.
            say: shows a line to the user.
        """
        self._store, self._say = store, say
        self._uri = uri or os.environ.get("MLFLOW_TRACKING_URI") or None
        self._warned = False
        self._pending: dict[tuple[str, str], tuple[Run, Run, Sequence[Run]]] = {}
        self._experiment: _Experiment | None = None

    def mirror(self, study: Run, stage: Run, trials: Sequence[Run] = ()) -> None:
        """Bring a stage of a study and its trials up to date in MLflow. Errors of MLflow become one warning.

        Args:
            study: the study's run.
            stage: the stage's run, a child of the study's.
            trials: runs of the stage's trials, children of the stage's.
        """
        self._pending[study.key, stage.key] = (study, stage, trials)
        try:
            with _locked_database(self._store) if self._uri is None else contextlib.nullcontext():
                if self._experiment is None:
                    self._experiment = _open_experiment(self._store, self._uri)
                for key, pending in list(self._pending.items()):
                    self._experiment.mirror(*pending)
                    del self._pending[key]
        except Exception as error:
            if not self._warned:
                self._warned = True
                reason = (str(error) or "no reason given").splitlines()[0]
                self._say(
                    f"MLflow at {self._uri or self._store / 'mlflow.db'} failed: {type(error).__name__}: {reason}\n"
                    f"The study continues without it. What is missing in MLflow is sent with the next stage, or by the "
                    f"same command once MLflow works again; a damaged mlflow.db may be deleted."
                )


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


@contextlib.contextmanager
def _locked_database(store: Path) -> Iterator[None]:
    """Keep other drivers of a store out of its database: creating it twice at once fails, and writing may."""
    with (store / "mlflow.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # released when the file is closed, however this process ends
        yield


def _open_experiment(store: Path, uri: str | None) -> _Experiment:
    for name, value in _MLFLOW_ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    from mlflow.tracking import MlflowClient

    logging.getLogger("mlflow").setLevel(logging.WARNING)
    client = MlflowClient(uri or database_uri(store))
    found = client.get_experiment_by_name(EXPERIMENT)
    if found is not None:
        return _Experiment(client, found.experiment_id)
    location = None if uri else (store.resolve() / "mlartifacts").as_uri()
    return _Experiment(client, client.create_experiment(EXPERIMENT, artifact_location=location))


@dataclass(frozen=True)
class _Experiment:
    client: Any
    id: str

    def mirror(self, study: Run, stage: Run, trials: Sequence[Run]) -> None:
        existing = self._runs(study.key)
        shared = {"puddle.study": study.name, "puddle.study_key": study.key}
        parent = self._update(study, ("study", study.key), shared, existing)
        shared["mlflow.parentRunId"] = parent
        child = self._update(stage, ("stage", stage.key), shared, existing)
        shared["mlflow.parentRunId"] = child
        for trial in trials:
            self._update(trial, ("trial", f"{stage.key}/{trial.key}"), shared, existing)

    def _runs(self, study_key: str) -> dict[tuple[str, str], Any]:
        """Find a study's runs, by kind and key."""
        runs: dict[tuple[str, str], Any] = {}
        page = None
        while page is None or page.token:
            token = page.token if page else None
            page = self.client.search_runs([self.id], f"tags.`puddle.study_key` = '{study_key}'", page_token=token)
            runs |= {(run.data.tags["puddle.kind"], run.data.tags["puddle.key"]): run for run in page}
        return runs

    def _update(
        self, wanted: Run, slot: tuple[str, str], shared: Mapping[str, str], existing: Mapping[tuple[str, str], Any]
    ) -> str:
        """Send what MLflow lacks of a run, its status last; return MLflow's ID of the run."""
        tags = {f"puddle.output.{name}": digest for name, digest in wanted.outputs.items()}
        tags |= {**wanted.tags, **shared, "puddle.kind": slot[0], "puddle.key": slot[1]}
        run = existing.get(slot)
        if run is None:
            run = self.client.create_run(self.id, run_name=wanted.name, tags=tags)
        self._send_values(run, wanted, tags)
        self._send_inputs(run, wanted)
        self._send_files(run, wanted)
        if wanted.status is not None and run.info.status != wanted.status:
            self.client.set_terminated(run.info.run_id, wanted.status)
        return str(run.info.run_id)

    def _send_values(self, run: Any, wanted: Run, tags: Mapping[str, str]) -> None:
        from mlflow.entities import Metric, Param, RunTag
        from mlflow.utils.time import get_current_time_millis

        params = [Param(name, str(value)) for name, value in _flat(wanted.params) if name not in run.data.params]
        new_tags = [RunTag(name, value) for name, value in tags.items() if run.data.tags.get(name) != value]
        now = get_current_time_millis()
        metrics = [
            Metric(name, float(value), now, 0)
            for name, value in wanted.metrics.items()
            if math.isfinite(value) and run.data.metrics.get(name) != value
        ]
        # A curve's points carry the time at which the run began, so that a point sent again is the same row of the
        # database and is not stored twice.
        digest = _digest({name: [float(y) for y in curve] for name, curve in wanted.curves.items()})
        if wanted.curves and run.data.tags.get("puddle.curves") != digest:
            metrics += [
                Metric(name, float(y), run.info.start_time, generation)
                for name, curve in wanted.curves.items()
                for generation, y in zip(wanted.steps or range(len(curve)), curve, strict=True)
                if math.isfinite(y)
            ]
            new_tags.append(RunTag("puddle.curves", digest))
        for start in range(0, len(metrics), _MAX_METRICS):
            self.client.log_batch(run.info.run_id, metrics=metrics[start : start + _MAX_METRICS])
        for start in range(0, max(len(params), len(new_tags)), _MAX_PARAMS):
            batch = slice(start, start + _MAX_PARAMS)
            self.client.log_batch(run.info.run_id, params=params[batch], tags=new_tags[batch])

    def _send_inputs(self, run: Any, wanted: Run) -> None:
        from mlflow.entities import Dataset, DatasetInput, InputTag

        sent = {(one.dataset.name, one.dataset.digest) for one in run.inputs.dataset_inputs} if run.inputs else set()
        inputs = [
            DatasetInput(
                Dataset(name, digest[:_DATASET_DIGEST_LENGTH], "puddle", json.dumps({"sha256": digest})),
                [InputTag("mlflow.data.context", "input")],
            )
            for name, digest in wanted.inputs.items()
            if (name, digest[:_DATASET_DIGEST_LENGTH]) not in sent
        ]
        if inputs:
            self.client.log_inputs(run.info.run_id, inputs)

    def _send_files(self, run: Any, wanted: Run) -> None:
        files = dict(wanted.artifacts)
        if wanted.inputs or wanted.outputs:
            lineage = {"inputs": dict(wanted.inputs), "outputs": dict(wanted.outputs)}
            files["lineage.json"] = json.dumps(lineage, indent=2, sort_keys=True).encode()
        digest = _digest({path: hashlib.sha256(content).hexdigest() for path, content in files.items()})
        if not files or run.data.tags.get("puddle.files") == digest:
            return
        with tempfile.TemporaryDirectory() as folder:
            for path, content in files.items():
                target = Path(folder, path)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
            self.client.log_artifacts(run.info.run_id, folder)
        self.client.set_tag(run.info.run_id, "puddle.files", digest)


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _flat(params: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in params.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def serve_ui(store: Path, port: int) -> NoReturn:
    """Replace this process by the MLflow UI's server, so that signals reach the server itself."""
    database = store / "mlflow.db"
    if not database.is_file():
        raise PuddleError(f"{store}: expected mlflow.db, found none. `puddle study` creates it.")
    try:
        with contextlib.closing(sqlite3.connect(database)) as connection:
            connection.execute("BEGIN IMMEDIATE")  # MLflow writes even when it only reads
            sound = connection.execute("PRAGMA quick_check(1)").fetchone() == ("ok",)
    except sqlite3.Error as error:
        raise PuddleError(
            f"{database}: MLflow cannot use it: {error}. Make it writable; or, if it is damaged, delete it and run "
            f"`puddle study` again, which rebuilds it from the store."
        ) from error
    if not sound:
        raise PuddleError(f"{database}: damaged. Delete it and run `puddle study` again, which rebuilds it.")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise PuddleError(f"port {port} is not available ({error.strerror}). Choose another: --port.") from error
    words = [sys.executable, "-m", "mlflow", "server", "--backend-store-uri", database_uri(store)]
    words += ["--default-artifact-root", (store.resolve() / "mlartifacts").as_uri()]
    words += ["--host", "127.0.0.1", "--port", str(port), "--workers", "1"]
    print(f"MLflow's UI: http://127.0.0.1:{port} (Ctrl-C stops it)", flush=True)
    os.execve(words[0], words, _MLFLOW_ENVIRONMENT | os.environ)
