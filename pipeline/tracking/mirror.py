"""The MLflow mirror of a store. Only this package imports mlflow.

Every run carries puddle's own keys as tags and is found by them, and only what is missing or different is sent. So
mirroring twice changes nothing, a mirror that fell behind catches up, and one that was deleted is rebuilt by running
the same command again. If MLflow fails, the study goes on: one warning, and the next call sends what is pending.
MLflow takes two seconds to import, so it is imported with the first stage to mirror.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Literal

from pipeline.locks import wait_for_lock
from pipeline.tracking.database import EXPERIMENT, artifacts_uri, experiment_id, explained, open_client
from pipeline.tracking.mlflow_writer import Experiment
from pipeline.tracking.run import Run

_SECONDS_TO_WAIT, _SECONDS_WHEN_WARNED = 60.0, 2.0  # for another driver of the store that writes to its database [s]
_SECONDS_AT_THE_END = 2.0  # as above, where the user waits for a study to stop [s]


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
        self._pending: dict[tuple[str, str], tuple[Run, Run, dict[str, Run]]] = {}
        self._experiment: Experiment | None = None

    def mirror(self, study: Run, stage: Run, trials: Sequence[Run] = ()) -> None:
        """Bring a stage of a study and some of its trials up to date in MLflow. Errors of MLflow become one warning.

        Args:
            study: the study's run.
            stage: the stage's run, a child of the study's.
            trials: runs of the stage's trials, children of the stage's; those left out stay as they are.
        """
        *_, pending = self._pending.get((study.key, stage.key), ({},))
        self._pending[study.key, stage.key] = study, stage, pending | {trial.key: trial for trial in trials}
        try:
            with self._database(_SECONDS_WHEN_WARNED if self._warned else _SECONDS_TO_WAIT):
                if self._experiment is None:
                    self._experiment = _open_experiment(self._store, self._uri)
                for key, (of_study, of_stage, of_trials) in list(self._pending.items()):
                    self._experiment.mirror(of_study, of_stage, list(of_trials.values()))
                    del self._pending[key]
        except Exception as error:
            self._experiment = None  # what MLflow holds is asked again
            if not self._warned:
                self._warned = True
                self._say(f"{explained(error, self._store, self._uri)}. The study continues without MLflow.")

    def stop(self, study: Run, status: Literal["KILLED", "FAILED"]) -> None:
        """Mark the runs of a study that have not ended. Errors of MLflow are ignored: the study is about to end.

        Args:
            study: the study's run.
            status: KILLED by a signal, or FAILED.
        """
        if self._experiment is None:  # nothing was mirrored, or MLflow fails
            return
        with contextlib.suppress(Exception), self._database(_SECONDS_AT_THE_END):
            self._experiment.stop(study.key, status)

    @contextlib.contextmanager
    def _database(self, seconds: float) -> Iterator[None]:
        """Keep other drivers of the store out of its database: creating it twice at once fails, and writing may."""
        if self._uri is not None:
            yield
            return
        path = self._store / "mlflow.lock"
        with path.open("w") as lock:  # released when the file is closed, however this process ends
            wait_for_lock(lock.fileno(), path, seconds=seconds)
            yield


def _open_experiment(store: Path, uri: str | None) -> Experiment:
    client = open_client(store, uri)
    found = experiment_id(client)
    if found is None:
        location = None if uri else artifacts_uri(store)
        kind = {"mlflow.experimentKind": "custom_model_development"}  # MLflow's pages show runs rather than traces
        found = client.create_experiment(EXPERIMENT, artifact_location=location, tags=kind)
    return Experiment(client, found)
