"""The MLflow mirror of a store. Only this package imports mlflow.

Every run carries puddle's own keys as tags and is found by them, and only what is missing or different is sent. So
mirroring twice changes nothing, and a mirror that fell behind or was deleted is rebuilt by running the same command
again. If MLflow fails, the study goes on, with one warning. MLflow takes two seconds to import, so it is imported with
the first stage to mirror.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from pipeline.tracking.database import EXPERIMENT, artifacts_uri, experiment_id, explained, open_client
from pipeline.tracking.mlflow_writer import Experiment
from pipeline.tracking.run import Run


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
