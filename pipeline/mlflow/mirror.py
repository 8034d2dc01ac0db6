"""The MLflow mirror of a store. Only this package imports mlflow.

Every run carries puddle's own keys as tags and is found by them, and only what is missing or different is sent. So
mirroring twice changes nothing, and a mirror that fell behind or was deleted is rebuilt by running the same command
again. If MLflow fails, the study goes on, with one warning. MLflow takes two seconds to import, so it is imported with
the first stage to mirror.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.mlflow.database import EXPERIMENT, artifacts_uri, experiment_id, explained, open_client
from pipeline.mlflow.run import Run

_MAX_METRICS, _MAX_PARAMS = 1000, 100  # per log_batch
_LAST_PART, _FILES = "puddle.curves", "puddle.files"
"""Tags that say what has been sent: the last part of a run's curves, and digests of sets of files."""

_SQLITE = "sqlite:///"
_FAILURE = "failure"  # tag of a run that failed, which goes where it is tried again

_Slot = tuple[str, str]  # a run's kind and key


class Tracker:
    """Mirrors studies to MLflow. It opens nothing until there is something to mirror."""

    def __init__(self, store: Path, uri: str | None = None, *, say: Callable[[str], None]) -> None:
        """Prepare to use the database in a store's folder, or the MLflow of a URI, by default MLFLOW_TRACKING_URI."""
        self._store, self._say = store, say
        self._uri = uri or os.environ.get("MLFLOW_TRACKING_URI") or None
        if self._uri and self._uri.startswith(_SQLITE):  # Ray changes the working folder for a while
            self._uri = f"{_SQLITE}{Path(self._uri.removeprefix(_SQLITE)).resolve()}"
        self._warned = False
        self._client: Any = None
        self._experiment = ""
        self._studies: dict[str, dict[_Slot, Any]] = {}  # runs that MLflow holds; no other process changes a study's

    def mirror(self, study: Run, stage: Run, trials: Sequence[Run] = ()) -> None:
        """Bring a stage of a study and some of its trials up to date in MLflow. Errors of MLflow become one warning.

        Trials that are left out stay as they are.
        """
        try:
            with self._database():
                if self._client is None:
                    self._studies = {}
                    self._client, self._experiment = _open_experiment(self._store, self._uri)
                self._mirror(study, stage, trials)
        except Exception as error:
            self._client = None  # what MLflow holds is asked again
            if not self._warned:
                self._warned = True
                self._say(f"{explained(error, self._store, self._uri)}. The study continues without MLflow.")

    @contextlib.contextmanager
    def _database(self) -> Iterator[None]:
        """Keep other drivers of the store out of its database: creating it twice at once fails, and writing may."""
        if self._uri is not None:
            yield
            return
        with (self._store / "mlflow.lock").open("w") as lock:  # released when it is closed, however this process ends
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def _mirror(self, study: Run, stage: Run, trials: Sequence[Run]) -> None:
        if study.key not in self._studies:
            self._studies[study.key] = dict(self._runs(study.key))
        runs = self._studies[study.key]
        shared = {**study.tags, "study": study.name, "study_digest": study.key}
        parent = self._update(study, ("study", study.key), shared, runs)
        shared |= {"mlflow.parentRunId": parent, "stage": stage.name}
        shared["mlflow.parentRunId"] = self._update(stage, ("stage", stage.key), shared, runs)
        for trial in trials:
            self._update(trial, ("trial", f"{stage.key}/{trial.key}"), shared, runs)

    def _runs(self, study_key: str) -> Iterator[tuple[_Slot, Any]]:
        """Find a study's runs, by kind and key."""
        page = None
        while page is None or page.token:
            token = page.token if page else None
            page = self._client.search_runs([self._experiment], f"tags.study_digest = '{study_key}'", page_token=token)
            yield from (((run.data.tags["puddle.kind"], run.data.tags["puddle.key"]), run) for run in page)

    def _update(self, wanted: Run, slot: _Slot, shared: Mapping[str, str], runs: dict[_Slot, Any]) -> str:
        """Send what MLflow lacks of a run, its status last; return the run's ID."""
        tags = {**shared, "puddle.kind": slot[0], "puddle.key": slot[1], "mlflow.user": os.environ.get("USER", "")}
        if slot not in runs:
            runs[slot] = self._client.create_run(self._experiment, run_name=wanted.name, tags=tags)
        run = runs[slot]
        name = str(run.info.run_id)
        if wanted.note:
            at = f"#/experiments/{self._experiment}/runs/{name}/artifacts"
            tags["mlflow.note.content"] = wanted.note.format(artifacts=at)
        changed = self._send_values(run, wanted, {**tags, **wanted.tags})
        changed |= self._send_files(run, wanted.artifacts)
        if wanted.status is not None and run.info.status != wanted.status:
            self._client.set_terminated(name, wanted.status)
            changed = True
        if changed:
            runs[slot] = self._client.get_run(name)
        return name

    def _send_values(self, run: Any, wanted: Run, tags: dict[str, str]) -> bool:
        from mlflow.entities import Metric, Param, RunTag

        held, started, now = run.data, run.info.start_time, round(1000 * time.time())
        params = [Param(name, str(value)) for name, value in _flat(wanted.params) if name not in held.params]
        metrics = [
            Metric(name, float(value), now, 0)
            for name, value in wanted.metrics.items()
            if math.isfinite(value) and held.metrics.get(name) != value
        ]
        digests, last = [part.digest for part in wanted.curves], held.tags.get(_LAST_PART)
        for part in wanted.curves[digests.index(last) + 1 if last in digests else 0 :]:
            tags[_LAST_PART] = part.digest
            points = part.read()
            metrics += [  # MLflow stores a point that is sent again with the same time once
                Metric(name, float(y), started, int(step))
                for name, curve in points.values.items()
                for step, y in zip(points.steps, curve, strict=True)
                if math.isfinite(y)
            ]
        new_tags = [RunTag(name, value) for name, value in tags.items() if held.tags.get(name) != value]
        for start in range(0, len(metrics), _MAX_METRICS):
            self._client.log_batch(run.info.run_id, metrics=metrics[start : start + _MAX_METRICS])
        for start in range(0, len(params), _MAX_PARAMS):
            self._client.log_batch(run.info.run_id, params=params[start : start + _MAX_PARAMS])
        if new_tags:  # last: after a failure, points are sent twice rather than never
            self._client.log_batch(run.info.run_id, tags=new_tags)
        if outdated := _FAILURE in held.tags and _FAILURE not in tags:
            self._client.delete_tag(run.info.run_id, _FAILURE)
        return bool(params or metrics or new_tags or outdated)

    def _send_files(self, run: Any, files: Mapping[str, bytes]) -> bool:
        """Send files, unless a tag says that they have been sent."""
        listed = sorted((path, hashlib.sha256(data).hexdigest()) for path, data in files.items())
        content = hashlib.sha256(repr(listed).encode()).hexdigest()
        sent = run.data.tags.get(_FILES, "").split()
        if not files or content in sent:
            return False
        with tempfile.TemporaryDirectory() as folder:
            for path, data in files.items():
                target = Path(folder) / path
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
            self._client.log_artifacts(run.info.run_id, folder)
        self._client.set_tag(run.info.run_id, _FILES, " ".join([*sent, content]))
        return True


def _open_experiment(store: Path, uri: str | None) -> tuple[Any, str]:
    """Return a client, and the ID of puddle's experiment."""
    client = open_client(store, uri)
    found = experiment_id(client)
    if found is None:
        location = None if uri else artifacts_uri(store)
        kind = {"mlflow.experimentKind": "custom_model_development"}  # MLflow's pages show runs rather than traces
        found = client.create_experiment(EXPERIMENT, artifact_location=location, tags=kind)
    return client, found


def _flat(params: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in params.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
