"""A study as runs in MLflow: the study, its stages below it, and their trials below them, live and when all is done."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.mlflow.run import CurvePart, CurvePoints, Run
from pipeline.store.encoding import canonical_json, digest
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.graph import ChainProgress
from pipeline.workflow.identity import ChainId, TrialId
from pipeline.workflow.record import preset_of
from pipeline.workflow.stage import AnyStage, Failure, Results, StoredFiles, Summary

if TYPE_CHECKING:
    from pipeline.mlflow.mirror import Tracker

SECONDS_BETWEEN_UPDATES = 15.0  # so that a segment is in MLflow within 30 s of its commit
SECONDS_OF_SILENCE = 2.0  # time that the end may wait before it tells the user what for [s]
_POINTS_OF_A_CURVE = 100  # a point costs a fifth of a millisecond, and a page of MLflow shows 320 of them at most
_FOLDERS = {
    **dict.fromkeys((".svg", ".png", ".pdf"), "figures/"),
    **dict.fromkeys((".mp4", ".gif"), "films/"),
    **dict.fromkeys((".csv", ".parquet"), "tables/"),
    ".html": "page/",
}
"""Folders of a study's artifacts, by suffix; other files lie beside the folders."""


class StudyMirror:
    """Mirrors one study on a thread of its own, so that MLflow costs the study no time."""

    def __init__(self, settings: Settings, store: Store, tracker: Tracker, *, source: str) -> None:
        """Start the thread, which waits for work; ``source`` tells where the settings come from, as in the record."""
        self._store, self._tracker = store, tracker
        chosen = settings.model_dump(mode="json")
        preset = preset_of(source) or Path(source).stem
        tags = {"preset": preset} if preset else {}
        page = f"[Its page]({{artifacts}}/page/index.html), also {store.export_path(settings.name) / 'index.html'}."
        note = f"Robots evolved for {settings.target_label}, selected for {settings.selected_for}. {page}"
        self._study = Run(settings.name, digest(canonical_json(chosen)), params=chosen, tags=tags, note=note)
        self._work: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._update: Callable[[], object] = lambda: None  # of the stage that is being computed
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while True:
            try:
                work = self._work.get(timeout=SECONDS_BETWEEN_UPDATES)
            except queue.Empty:
                work = self._update
            if work is None:
                return
            work()

    def close(self, say: Callable[[str], None]) -> None:
        """Wait until everything is sent; show the user a line if that takes long."""
        self._work.put(None)
        self._thread.join(SECONDS_OF_SILENCE)
        if self._thread.is_alive():
            say("bringing the record of runs and curves up to date")
            self._thread.join()

    def start(self, stage: AnyStage, chains: Sequence[ChainProgress]) -> None:
        """Mirror a stage's chains, which its driver advances, from now on until it ends."""
        self._update = partial(self._mirror_trials, stage, chains, {})
        self._work.put(self._update)

    def _mirror_trials(
        self, stage: AnyStage, chains: Sequence[ChainProgress], mirrored: dict[ChainId, tuple[int, Failure | None]]
    ) -> None:
        """Mirror the chains of a stage that is shown by chain, which have got further than they are mirrored."""
        trials = []
        for progress in chains if stage.summarise_trial else ():
            chain, reached = progress.chain.identity, (len(progress.manifests), progress.failed)
            if reached != mirrored.get(chain, (0, None)):
                with contextlib.suppress(PuddleError, OSError):  # the driver finds out when it needs the file
                    trials.append(self._trial(stage, progress, progress.manifests[: reached[0]]))
                    mirrored[chain] = reached
        self._tracker.mirror(self._study, Run(stage.name, stage.name), trials)

    def finish(self, stage: AnyStage, results: Results, summary: Summary, *, is_last: bool) -> None:
        """Mirror a stage that has ended, with its results in short; ``is_last`` if the study has ended too."""
        self._work.put(self._update)
        self._update = lambda: None
        study = replace(self._study, status="FINISHED" if is_last else None)
        run = Run(
            stage.name,
            stage.name,
            metrics={**summary.metrics, "core_seconds": results.seconds, "n_failed": len(results.failed)},
            artifacts=_in_folders(summary.artifacts),
            status="FAILED" if results.failed else "FINISHED",
        )
        if summary.of_study:
            study = replace(study, metrics=summary.metrics, artifacts=run.artifacts)
            run = replace(run, artifacts={})
        self._work.put(partial(self._tracker.mirror, study, run))
        for trial, films in summary.films.items():
            film = Run(trial.label, trial.label, artifacts=_in_folders(films))
            self._work.put(partial(self._tracker.mirror, study, Run(trial.stage, trial.stage), [film]))

    def _trial(self, stage: AnyStage, progress: ChainProgress, parts: Sequence[Manifest]) -> Run:
        """Describe a chain as far as it is done."""
        assert stage.summarise_trial is not None
        chain, n_items = progress.chain.identity, progress.chain.n_items
        params: dict[str, str | int | float] = {}
        if isinstance(chain, TrialId):
            params = {"environment": chain.environment, "depth": chain.depth, "trial": chain.index}
        tags = {name: f"{value:g}" if name == "depth" else str(value) for name, value in params.items()}
        n_points = -(-_POINTS_OF_A_CURVE // n_items)
        curves = [
            CurvePart(part.digest, partial(_thinned, partial(stage.curves, StoredFiles(self._store, part)), n_points))
            for part in parts
        ]
        run = Run(name=chain.label, key=chain.label, params=params, curves=curves, tags=tags)
        if progress.failed is not None:
            return replace(run, tags={**tags, "failure": str(progress.failed)}, status="FAILED")
        if len(parts) < n_items:
            return run
        summary = stage.summarise_trial(chain, [StoredFiles(self._store, part) for part in parts])
        return replace(run, metrics=summary.metrics, artifacts=summary.artifacts, status="FINISHED")


def _thinned(read: Callable[[], CurvePoints], n_points: int) -> CurvePoints:
    """Read at most ``n_points`` points: the last one of each stretch of equal length."""
    points = read()
    every = -(-len(points.steps) // n_points) or 1
    chosen = slice((len(points.steps) - 1) % every, None, every)
    return CurvePoints(points.steps[chosen], {name: list(curve)[chosen] for name, curve in points.values.items()})


def _in_folders(artifacts: Mapping[str, bytes]) -> dict[str, bytes]:
    return {_FOLDERS.get(PurePosixPath(name).suffix, "") + name: content for name, content in artifacts.items()}
