"""Writes runs to MLflow: the difference between what its experiment holds and what it should hold."""

from __future__ import annotations

import hashlib
import json
import math
import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.tracking.run import CurvePart, Run

_MAX_METRICS, _MAX_PARAMS = 1000, 100  # per log_batch
_CURVES, _FILES = "puddle.curves", "puddle.files"
"""Tags that say what has been sent."""

_Slot = tuple[str, str]  # a run's kind and key


@dataclass
class _Sent:
    """What MLflow holds of a run."""

    id: str
    started: int  # [ms since 1970]
    status: str = "RUNNING"
    params: set[str] = field(default_factory=set)
    tags: dict[str, str] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)
    n_parts: int = 0  # of its curves, that this process has sent


@dataclass
class Experiment:
    """An experiment, and what it is known to hold; another process may add studies but not change the same one."""

    client: Any
    id: str
    _studies: dict[str, dict[_Slot, _Sent]] = field(default_factory=dict)

    def mirror(self, study: Run, stage: Run, trials: Sequence[Run]) -> None:
        """Send what MLflow lacks of a study, one of its stages, and some of that stage's trials.

        Args:
            study: the study's run.
            stage: the stage's run, a child of the study's.
            trials: runs of the stage's trials, children of the stage's.
        """
        if study.key not in self._studies:
            self._studies[study.key] = self._runs(study.key)
        sent = self._studies[study.key]
        shared = {**study.tags, "study": study.name, "study_digest": study.key}
        parent = self._update(study, ("study", study.key), shared, sent)
        shared |= {"mlflow.parentRunId": parent.id, "stage": stage.name}
        child = self._update(stage, ("stage", stage.key), shared, sent)
        shared["mlflow.parentRunId"] = child.id
        for trial in trials:
            self._update(trial, ("trial", f"{stage.key}/{trial.key}"), shared, sent)
        for slot, files in stage.attachments.items():
            if slot in sent:
                self._send_files(sent[slot], files, f"{_FILES}.{stage.name}")

    def _runs(self, study_key: str) -> dict[_Slot, _Sent]:
        """Find a study's runs, by kind and key."""
        runs: dict[_Slot, _Sent] = {}
        page = None
        while page is None or page.token:
            token = page.token if page else None
            page = self.client.search_runs([self.id], f"tags.study_digest = '{study_key}'", page_token=token)
            for run in page:
                info, data = run.info, run.data
                sent = _Sent(info.run_id, info.start_time, info.status, set(data.params), data.tags, data.metrics)
                runs[data.tags["puddle.kind"], data.tags["puddle.key"]] = sent
        return runs

    def _update(self, wanted: Run, slot: _Slot, shared: Mapping[str, str], existing: dict[_Slot, _Sent]) -> _Sent:
        """Send what MLflow lacks of a run, its status last; return what it then holds."""
        run = existing.get(slot)
        if run is None:
            tags = {**shared, "puddle.kind": slot[0], "puddle.key": slot[1], "mlflow.user": os.environ.get("USER", "")}
            made = self.client.create_run(self.id, run_name=wanted.name, tags=tags)
            run = existing[slot] = _Sent(made.info.run_id, made.info.start_time, tags=tags)
        self._send_values(run, wanted, {**shared, **wanted.tags})
        self._send_files(run, wanted.artifacts, _FILES)
        if wanted.status is not None and run.status != wanted.status:
            self.client.set_terminated(run.id, wanted.status)
            run.status = wanted.status
        return run

    def _send_values(self, run: _Sent, wanted: Run, tags: dict[str, str]) -> None:
        from mlflow.entities import Metric, Param, RunTag

        params = [(name, str(value)) for name, value in _flat(wanted.params) if name not in run.params]
        values = {name: float(value) for name, value in wanted.metrics.items() if math.isfinite(value)}
        changed = {name: value for name, value in values.items() if run.metrics.get(name) != value}
        now = round(1000 * time.time())
        metrics = [Metric(name, value, now, 0) for name, value in changed.items()]
        curves = _digest([part.digest for part in wanted.curves])
        if wanted.curves and run.tags.get(_CURVES) != curves:
            tags[_CURVES] = curves
            for part in wanted.curves[run.n_parts :]:
                metrics += _points(part, run.started)
        new_tags = {name: value for name, value in tags.items() if run.tags.get(name) != value}
        for start in range(0, len(metrics), _MAX_METRICS):
            self.client.log_batch(run.id, metrics=metrics[start : start + _MAX_METRICS])
        for start in range(0, len(params), _MAX_PARAMS):
            self.client.log_batch(run.id, params=[Param(*one) for one in params[start : start + _MAX_PARAMS]])
        if new_tags:  # last: after a failure, points are sent twice rather than never
            self.client.log_batch(run.id, tags=[RunTag(*tag) for tag in new_tags.items()])
        run.params |= {name for name, _ in params}
        run.tags |= new_tags
        run.metrics |= changed
        run.n_parts = max(run.n_parts, len(wanted.curves))

    def _send_files(self, run: _Sent, files: Mapping[str, bytes], tag: str) -> None:
        """Send files, unless a tag says that they have been sent."""
        digest = _digest({path: hashlib.sha256(content).hexdigest() for path, content in files.items()})
        if not files or run.tags.get(tag) == digest:
            return
        with tempfile.TemporaryDirectory() as folder:
            for path, content in files.items():
                target = Path(folder) / path
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
            self.client.log_artifacts(run.id, folder)
        self.client.set_tag(run.id, tag, digest)
        run.tags[tag] = digest


def _points(part: CurvePart, timestamp: int) -> list[Any]:
    """Return the finite points of a part. MLflow stores a point that is sent again with the same time once."""
    from mlflow.entities import Metric

    points = part.read()
    return [
        Metric(name, float(y), timestamp, int(step))
        for name, curve in points.values.items()
        for step, y in zip(points.steps, curve, strict=True)
        if math.isfinite(y)
    ]


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _flat(params: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in params.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
