"""Writes runs to MLflow: the difference between what its experiment holds and what it should hold."""

from __future__ import annotations

import getpass
import hashlib
import json
import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.tracking.run import CurvePart, Run

_MAX_METRICS = 800  # per log_batch, which takes 1,000 metrics, parameters and tags together
_MAX_PARAMS = 100  # per log_batch; tags too
_CURVES, _FILES, _DESCRIPTION = "puddle.curves", "puddle.files", "mlflow.note.content"
"""Tags. The first two say what has been sent."""

_Slot = tuple[str, str]  # a run's kind and key


@dataclass
class _Sent:
    """What MLflow holds of a run."""

    id: str
    status: str = "RUNNING"
    ended: int | None = None  # [ms since 1970]
    params: set[str] = field(default_factory=set)
    tags: dict[str, str] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)
    curves: str | None = None  # value of the tag for the parts that were sent; MLflow has it once the run has ended


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
                for tag, digest in self._send_files(sent[slot], files, f"{_FILES}.{stage.name}").items():
                    self.client.set_tag(sent[slot].id, tag, digest)
                    sent[slot].tags[tag] = digest

    def stop(self, study_key: str, status: str) -> None:
        """Give the runs of a study that have not ended another status, the study's own first."""
        runs = self._studies.get(study_key, {})
        for slot in sorted(runs, key=lambda slot: ("study", "stage", "trial").index(slot[0])):
            if runs[slot].status == "RUNNING":
                self.client.set_terminated(runs[slot].id, status)
                runs[slot].status = status

    def _runs(self, study_key: str) -> dict[_Slot, _Sent]:
        """Find a study's runs, by kind and key."""
        runs: dict[_Slot, _Sent] = {}
        page = None
        while page is None or page.token:
            token = page.token if page else None
            page = self.client.search_runs([self.id], f"tags.study_digest = '{study_key}'", page_token=token)
            for run in page:
                info, data = run.info, run.data
                runs[data.tags["puddle.kind"], data.tags["puddle.key"]] = _Sent(
                    info.run_id,
                    info.status,
                    info.end_time,
                    set(data.params),
                    dict(data.tags),
                    dict(data.metrics),
                    data.tags.get(_CURVES),
                )
        return runs

    def _update(self, wanted: Run, slot: _Slot, shared: Mapping[str, str], existing: dict[_Slot, _Sent]) -> _Sent:
        """Send what MLflow lacks of a run, its status last; return what it then holds."""
        tags = {**shared, **wanted.tags, "puddle.kind": slot[0], "puddle.key": slot[1]}
        if wanted.description:
            tags[_DESCRIPTION] = wanted.description
        run = existing.get(slot)
        if run is None:
            tags |= {"mlflow.user": _user(), "mlflow.source.name": "puddle", "mlflow.source.type": "LOCAL"}
            started = _milliseconds(time.time() if wanted.started is None else wanted.started)
            made = self.client.create_run(self.id, start_time=started, run_name=wanted.name, tags=tags)
            run = existing[slot] = _Sent(made.info.run_id, tags=tags)
        elif wanted.status is None and run.status in ("KILLED", "FAILED"):  # it is resumed
            self.client.update_run(run.id, status="RUNNING")
            run.status = "RUNNING"
        self._send_values(run, wanted, tags | self._send_files(run, wanted.artifacts, _FILES))
        ended = run.ended if wanted.ended is None else _milliseconds(wanted.ended)
        if wanted.status is not None and (run.status, run.ended) != (wanted.status, ended or run.ended):
            self.client.set_terminated(run.id, wanted.status, end_time=ended)
            run.status, run.ended = wanted.status, ended
        return run

    def _send_values(self, run: _Sent, wanted: Run, tags: Mapping[str, str]) -> None:
        from mlflow.entities import Metric, Param, RunTag

        params = {name: str(value) for name, value in _flat(wanted.params) if name not in run.params}
        new_tags = {name: value for name, value in tags.items() if run.tags.get(name) != value}
        now = _milliseconds(time.time())
        changed = {
            name: float(value)
            for name, value in wanted.metrics.items()
            if math.isfinite(value) and run.metrics.get(name) != value
        }
        metrics = [Metric(name, value, now, 0) for name, value in changed.items()]
        if wanted.curves:
            for part in wanted.curves[_n_sent(run.curves, wanted.curves) :]:
                metrics += _points(part)
            curves = _curves_tag(wanted.curves)
            if wanted.status is not None and run.tags.get(_CURVES) != curves:
                new_tags[_CURVES] = curves
        while len(metrics) > _MAX_METRICS:
            self.client.log_batch(run.id, metrics=metrics[:_MAX_METRICS])
            del metrics[:_MAX_METRICS]
        # MLflow writes a batch's tags after its points: after a failure, points are sent twice rather than never.
        for start in range(0, max(len(params), len(new_tags), len(metrics) and 1), _MAX_PARAMS):
            batch = slice(start, start + _MAX_PARAMS)
            self.client.log_batch(
                run.id,
                metrics=[] if start else metrics,
                params=[Param(*param) for param in list(params.items())[batch]],
                tags=[RunTag(*tag) for tag in list(new_tags.items())[batch]],
            )
        run.curves = _curves_tag(wanted.curves) if wanted.curves else run.curves
        run.params |= set(params)
        run.tags |= new_tags
        run.metrics |= changed

    def _send_files(self, run: _Sent, files: Mapping[str, bytes], tag: str) -> dict[str, str]:
        """Send files, unless a tag says that they have been sent; return the tag to set."""
        digest = _digest({path: hashlib.sha256(content).hexdigest() for path, content in files.items()})
        if not files or run.tags.get(tag) == digest:
            return {}
        with tempfile.TemporaryDirectory() as folder:
            for path, content in files.items():
                target = Path(folder) / path
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
            self.client.log_artifacts(run.id, folder)
        return {tag: digest}


def _n_sent(tag: str | None, curves: Sequence[CurvePart]) -> int:
    """Return how many parts of a run's curves a tag says were sent; 0 if they were others."""
    n_sent = (tag or "").partition(" ")[0]
    if n_sent.isdigit() and tag == _curves_tag(curves[: int(n_sent)]):
        return int(n_sent)
    return 0


def _curves_tag(curves: Sequence[CurvePart]) -> str:
    return f"{len(curves)} {_digest([part.digest for part in curves])}"


def _points(part: CurvePart) -> list[Any]:
    """Return the finite points of a part, timed evenly over it.

    Their times are part of their identity: MLflow stores a point that is sent again with the same one once.
    """
    from mlflow.entities import Metric

    points = part.read()
    n_steps, started = len(points.steps), _milliseconds(part.started)
    duration = _milliseconds(part.ended) - started
    return [
        Metric(name, float(y), started + (k + 1) * duration // n_steps, int(step))
        for name, curve in points.values.items()
        for k, (step, y) in enumerate(zip(points.steps, curve, strict=True))
        if math.isfinite(y)
    ]


def _milliseconds(seconds: float) -> int:
    return round(1000 * seconds)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a container's user may have no name
        return "unknown"


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _flat(params: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in params.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
