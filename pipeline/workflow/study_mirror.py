"""A study as runs in MLflow: the study, its stages below it, and their trials below them, live and when all is done."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.store.encoding import canonical_json, digest, encode_json
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.tracking.run import CurvePart, CurvePoints, Run
from pipeline.workflow.background import Background
from pipeline.workflow.graph import ChainProgress
from pipeline.workflow.identity import ChainId, TrialId
from pipeline.workflow.record import preset_of
from pipeline.workflow.stage import AnyStage, Summary, TrialSummary, Upstream

if TYPE_CHECKING:
    from pipeline.tracking.mirror import Tracker

SECONDS_BETWEEN_UPDATES = 15.0  # so that a segment is in MLflow within 30 s of its commit
_POINTS_OF_A_CURVE = 100  # a point costs a fifth of a millisecond, and a page of MLflow shows 320 of them at most
_FOLDERS = {
    **dict.fromkeys((".svg", ".png", ".pdf"), "figures"),
    **dict.fromkeys((".mp4", ".gif"), "films"),
    **dict.fromkeys((".csv", ".parquet"), "tables"),
    ".html": "page",
}
"""Folders of a study's artifacts, by suffix; other files lie beside the folders."""


class StudyMirror:
    """Mirrors one study in the background, so that MLflow costs the study no time."""

    def __init__(
        self,
        settings: Settings,
        stages: Sequence[AnyStage],
        store: Store,
        tracker: Tracker,
        background: Background,
        *,
        source: str,
    ) -> None:
        """Prepare.

        Args:
            settings: the study's settings.
            stages: all its stages, in order.
            store: where its results are committed.
            tracker: sends runs to MLflow.
            background: runs calls on a thread.
            source: where the settings come from: "preset laptop", or the path of a file.
        """
        self._settings, self._stages, self._store = settings, stages, store
        self._tracker, self._background = tracker, background
        self._chosen = settings.model_dump(mode="json")
        self._key = digest(canonical_json(self._chosen))
        preset = preset_of(source) or Path(source).stem
        self._tags = {"preset": preset} if preset else {}

    @contextlib.contextmanager
    def live(self, stage: AnyStage, chains: Sequence[ChainProgress]) -> Iterator[None]:
        """Mirror a stage's chains as they grow, while the block computes them.

        Args:
            stage: the stage.
            chains: its chains, which the block advances.
        """
        n_mirrored = dict.fromkeys((progress.chain.identity for progress in chains), 0)
        run = Run(stage.name, stage.name)

        def update() -> None:
            grown = []
            for progress in chains if stage.curves else ():
                chain, parts = progress.chain, tuple(progress.manifests)
                if len(parts) > n_mirrored[chain.identity]:
                    with contextlib.suppress(PuddleError):  # damaged: the driver finds out when it needs the file
                        summary = None
                        if len(parts) == chain.n_items and stage.summarise_trial:
                            summary = stage.summarise_trial(self._store, chain.identity, parts)
                        grown.append(self._trial(stage, chain.identity, parts, chain.n_items, summary))
                        n_mirrored[chain.identity] = len(parts)
            self._tracker.mirror(self._study(), run, grown)

        with self._background.repeat(update, every=SECONDS_BETWEEN_UPDATES):
            yield

    def finish(self, stage: AnyStage, upstream: Upstream, summary: Summary) -> None:
        """Mirror a stage that has ended.

        Args:
            stage: the stage.
            upstream: its results, and those of the stages before it.
            summary: its results in short.
        """
        results = upstream[stage.name]
        artifacts = {_path(name): content for name, content in summary.artifacts.items()}
        study = self._study()
        if summary.of_study:
            study = replace(study, metrics=summary.metrics)
        if stage is self._stages[-1]:
            study = replace(study, status="FINISHED")
        run = Run(
            stage.name,
            stage.name,
            metrics={**summary.metrics, "core_seconds": results.seconds, "n_failed": len(results.failed)},
            artifacts={} if summary.of_study else artifacts,
            attachments={
                **({("study", self._key): artifacts} if summary.of_study else {}),
                **{
                    ("trial", f"{trial.stage}/{trial.label}"): {_path(name): film for name, film in films.items()}
                    for trial, films in summary.films.items()
                },
            },
            status="FAILED" if results.failed else "FINISHED",
        )
        trials = []
        for one in summary.trials:
            parts = results.done[one.chain]
            trials.append(self._trial(stage, one.chain, parts, len(parts), one))
        if stage.curves:
            trials += [
                replace(self._trial(stage, chain, (), 1), tags={"failure": str(why)}, status="FAILED")
                for chain, why in results.failed.items()
            ]
        self._background.do(partial(self._tracker.mirror, study, run, trials))

    def _study(self) -> Run:
        return Run(
            name=self._settings.name,
            key=self._key,
            params=self._chosen,
            tags=self._tags,
            artifacts={"settings.json": encode_json(self._chosen)},
        )

    def _trial(
        self,
        stage: AnyStage,
        chain: ChainId,
        parts: Sequence[Manifest],
        n_items: int,
        summary: TrialSummary | None = None,
    ) -> Run:
        """Describe a chain of some items as far as it is done; with a summary if it is complete."""
        assert stage.curves is not None
        params: dict[str, str | int | float] = {}
        if isinstance(chain, TrialId):
            params = {"environment": chain.environment, "depth": chain.depth, "trial": chain.index}
        n_points = -(-_POINTS_OF_A_CURVE // n_items)
        return Run(
            name=chain.label,
            key=chain.label,
            params=params,
            metrics=summary.metrics if summary else {},
            curves=[
                CurvePart(part.digest, partial(_thinned, partial(stage.curves, self._store, part), n_points))
                for part in parts
            ],
            tags={name: f"{value:g}" if name == "depth" else str(value) for name, value in params.items()},
            artifacts=summary.artifacts if summary else {},
            status="FINISHED" if summary else None,
        )


def _thinned(read: Callable[[], CurvePoints], n_points: int) -> CurvePoints:
    """Read at most ``n_points`` points: the last one of each stretch of equal length."""
    points = read()
    every = -(-len(points.steps) // n_points) or 1
    chosen = slice((len(points.steps) - 1) % every, None, every)
    return CurvePoints(points.steps[chosen], {name: list(curve)[chosen] for name, curve in points.values.items()})


def _path(name: str) -> str:
    """Return where an artifact lies: in the folder of its kind."""
    folder = _FOLDERS.get(PurePosixPath(name).suffix)
    return f"{folder}/{name}" if folder else name
