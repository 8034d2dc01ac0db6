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
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.tracking.database import EXPERIMENT, artifacts_uri, experiment_id, explained, open_client
from pipeline.tracking.run import Run

_MAX_METRICS, _MAX_PARAMS = 1000, 100  # per log_batch
_LAST_PART, _FILES = "puddle.curves", "puddle.files"
"""Tags that say what has been sent: the last part of a run's curves, and digests of sets of files."""

_Slot = tuple[str, str]  # a run's kind and key


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
        self._experiment: Experiment | None = None

    def mirror(self, study: Run, stage: Run, trials: Sequence[Run] = ()) -> None:
        """Bring a stage of a study and some of its trials up to date in MLflow. Errors of MLflow become one warning.

        Args:
            study: the study's run.
            stage: the stage's run, a child of the study's.
            trials: runs of the stage's trials, children of the stage's; those left out stay as they are.
        """
        try:
            with self._database():
                if self._experiment is None:
                    self._experiment = _open_experiment(self._store, self._uri)
                self._experiment.mirror(study, stage, trials)
        except Exception as error:
            self._experiment = None  # what MLflow holds is asked again
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


def _open_experiment(store: Path, uri: str | None) -> Experiment:
    client = open_client(store, uri)
    found = experiment_id(client)
    if found is None:
        location = None if uri else artifacts_uri(store)
        kind = {"mlflow.experimentKind": "custom_model_development"}  # MLflow's pages show runs rather than traces
        found = client.create_experiment(EXPERIMENT, artifact_location=location, tags=kind)
    return Experiment(client, found)


@dataclass
class _Sent:
    """What MLflow holds of a run."""

    id: str
    started: int  # [ms since 1970]
    status: str = "RUNNING"
    params: set[str] = field(default_factory=set)
    tags: dict[str, str] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)


@dataclass
class Experiment:
    """An experiment, and what it is known to hold; another process may add studies but not change the same one."""

    client: Any
    id: str
    _studies: dict[str, dict[_Slot, _Sent]] = field(default_factory=dict)

    def mirror(self, study: Run, stage: Run, trials: Sequence[Run]) -> None:
        """Send what MLflow lacks, as :meth:`Tracker.mirror` describes."""
        if study.key not in self._studies:
            self._studies[study.key] = dict(self._runs(study.key))
        sent = self._studies[study.key]
        shared = {**study.tags, "study": study.name, "study_digest": study.key}
        parent = self._update(study, ("study", study.key), shared, sent)
        shared |= {"mlflow.parentRunId": parent.id, "stage": stage.name}
        child = self._update(stage, ("stage", stage.key), shared, sent)
        shared["mlflow.parentRunId"] = child.id
        for trial in trials:
            self._update(trial, ("trial", f"{stage.key}/{trial.key}"), shared, sent)

    def _runs(self, study_key: str) -> Iterator[tuple[_Slot, _Sent]]:
        """Find a study's runs, by kind and key."""
        page = None
        while page is None or page.token:
            token = page.token if page else None
            page = self.client.search_runs([self.id], f"tags.study_digest = '{study_key}'", page_token=token)
            for run in page:
                info, data = run.info, run.data
                sent = _Sent(info.run_id, info.start_time, info.status, set(data.params), data.tags, data.metrics)
                yield (data.tags["puddle.kind"], data.tags["puddle.key"]), sent

    def _update(self, wanted: Run, slot: _Slot, shared: Mapping[str, str], existing: dict[_Slot, _Sent]) -> _Sent:
        """Send what MLflow lacks of a run, its status last; return what it then holds."""
        run = existing.get(slot)
        if run is None:
            tags = {**shared, "puddle.kind": slot[0], "puddle.key": slot[1], "mlflow.user": os.environ.get("USER", "")}
            made = self.client.create_run(self.id, run_name=wanted.name, tags=tags)
            run = existing[slot] = _Sent(made.info.run_id, made.info.start_time, tags=tags)
        self._send_values(run, wanted, {**shared, **wanted.tags})
        self._send_files(run, wanted.artifacts)
        if wanted.status is not None and run.status != wanted.status:
            self.client.set_terminated(run.id, wanted.status)
            run.status = wanted.status
        return run

    def _send_values(self, run: _Sent, wanted: Run, tags: dict[str, str]) -> None:
        from mlflow.entities import Metric, Param, RunTag

        params = [Param(name, str(value)) for name, value in _flat(wanted.params) if name not in run.params]
        values = {name: float(value) for name, value in wanted.metrics.items() if math.isfinite(value)}
        changed = {name: value for name, value in values.items() if run.metrics.get(name) != value}
        now = round(1000 * time.time())
        metrics = [Metric(name, value, now, 0) for name, value in changed.items()]
        digests, last = [part.digest for part in wanted.curves], run.tags.get(_LAST_PART)
        for part in wanted.curves[digests.index(last) + 1 if last in digests else 0 :]:
            tags[_LAST_PART] = part.digest
            points = part.read()
            metrics += [  # MLflow stores a point that is sent again with the same time once
                Metric(name, float(y), run.started, int(step))
                for name, curve in points.values.items()
                for step, y in zip(points.steps, curve, strict=True)
                if math.isfinite(y)
            ]
        new_tags = {name: value for name, value in tags.items() if run.tags.get(name) != value}
        for start in range(0, len(metrics), _MAX_METRICS):
            self.client.log_batch(run.id, metrics=metrics[start : start + _MAX_METRICS])
        for start in range(0, len(params), _MAX_PARAMS):
            self.client.log_batch(run.id, params=params[start : start + _MAX_PARAMS])
        if new_tags:  # last: after a failure, points are sent twice rather than never
            self.client.log_batch(run.id, tags=[RunTag(*tag) for tag in new_tags.items()])
        run.params |= {param.key for param in params}
        run.tags |= new_tags
        run.metrics |= changed

    def _send_files(self, run: _Sent, files: Mapping[str, bytes]) -> None:
        """Send files, unless a tag says that they have been sent."""
        content = hashlib.sha256()
        for path, data in sorted(files.items()):
            content.update(f"{path} {hashlib.sha256(data).hexdigest()}\n".encode())
        sent = run.tags.get(_FILES, "").split()
        if not files or content.hexdigest() in sent:
            return
        with tempfile.TemporaryDirectory() as folder:
            for path, data in files.items():
                target = Path(folder) / path
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
            self.client.log_artifacts(run.id, folder)
        run.tags[_FILES] = " ".join([*sent, content.hexdigest()])
        self.client.set_tag(run.id, _FILES, run.tags[_FILES])


def _flat(params: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in params.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
