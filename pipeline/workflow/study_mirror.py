"""A study as runs in MLflow: the study, its stages below it, and their trials below them, live and when all is done."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Literal

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
from pipeline.workflow.stage import AnyStage, Results, Summary, TrialSummary, Upstream

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
        self._points: dict[str, Mapping[ChainId, int]] = {}

    @contextlib.contextmanager
    def live(self, stage: AnyStage, chains: Sequence[ChainProgress]) -> Iterator[None]:
        """Mirror a stage's chains as they grow, while the block computes them.

        Args:
            stage: the stage.
            chains: its chains, which the block advances.
        """
        n_mirrored = dict.fromkeys((progress.chain.identity for progress in chains), 0)
        begun, since = False, time.time()

        def update() -> None:
            nonlocal begun
            grown = []
            for progress in chains if begun and stage.curves else ():
                chain, parts = progress.chain, tuple(progress.manifests)
                if len(parts) > n_mirrored[chain.identity]:
                    with contextlib.suppress(PuddleError):  # damaged: the driver finds out when it needs the file
                        summary = None
                        if len(parts) == chain.n_items and stage.summarise_trial:
                            summary = stage.summarise_trial(self._store, chain.identity, parts)
                        grown.append(self._trial(stage, chain.identity, parts, summary))
                        n_mirrored[chain.identity] = len(parts)
            if grown or not begun:
                begun = True
                run = Run(stage.name, stage.name, self._about(stage), started=since)
                self._tracker.mirror(replace(self._study(), started=since), run, grown)

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
        manifests = [manifest for done in results.done.values() for manifest in done]
        artifacts = {_path(name): content for name, content in summary.artifacts.items()}
        attachments = {
            ("trial", f"{trial.stage}/{trial.label}"): {_path(name): film for name, film in films.items()}
            for trial, films in summary.films.items()
        }
        if summary.of_study:
            attachments["study", self._key], artifacts = artifacts, {}
        read = (*stage.reads(self._settings), stage.name)
        lineage = {name: _digest_of(upstream[name]) for name in read}
        started, ended = self._times(manifests)
        run = Run(
            stage.name,
            stage.name,
            self._about(stage),
            metrics={**summary.metrics, "core_seconds": results.seconds, "n_failed": len(results.failed)},
            tags=_commit(manifests),
            artifacts={**artifacts, "lineage.json": encode_json(lineage)},
            attachments=attachments,
            started=started,
            ended=ended,
            status="FAILED" if results.failed else "FINISHED",
        )
        study = replace(self._study(), metrics=summary.metrics if summary.of_study else {}, started=started)
        if stage is self._stages[-1]:
            study = replace(study, tags={**study.tags, **run.tags}, ended=ended, status="FINISHED")
        trials = [self._trial(stage, one.chain, results.done[one.chain], one) for one in summary.trials]
        if stage.curves:
            trials += [
                replace(self._trial(stage, chain, ()), tags={"failure": str(why)}, status="FAILED")
                for chain, why in results.failed.items()
            ]
        self._background.do(partial(self._tracker.mirror, study, run, trials))

    def stop(self, error: BaseException) -> None:
        """Mark what an error or a signal leaves unfinished, so that MLflow does not show it as running."""
        status: Literal["KILLED", "FAILED"] = "FAILED" if isinstance(error, Exception) else "KILLED"
        self._background.do_last(partial(self._tracker.stop, self._study(), status))

    def _study(self) -> Run:
        trials, evolution = self._settings.grid.trials(), self._settings.evolution
        environments = ", ".join(dict.fromkeys(environment for environment, _, _ in trials))
        depths = ", ".join(f"{depth:g}" for depth in self._settings.grid.depths)
        return Run(
            name=self._settings.name,
            key=self._key,
            description=(
                f"{len(trials)} trials of {evolution.n_generations} generations of {evolution.afpo.population_size} "
                f"designs, in {environments}, at {depths} m."
            ),
            params=self._chosen,
            tags=self._tags,
            artifacts={"settings.json": encode_json(self._chosen)},
        )

    def _about(self, stage: AnyStage) -> str:
        number = 1 + [one.name for one in self._stages].index(stage.name)
        return f"Stage {number} of {len(self._stages)} of study {self._settings.name}."

    def _trial(
        self, stage: AnyStage, chain: ChainId, parts: Sequence[Manifest], summary: TrialSummary | None = None
    ) -> Run:
        """Describe a chain as far as it is done; with a summary if it is complete."""
        started, ended = self._times(parts)
        params: dict[str, str | int | float] = {}
        about = f"{chain.label} of stage {stage.name} of study {self._settings.name}."
        if isinstance(chain, TrialId):
            params = {"environment": chain.environment, "depth": chain.depth, "trial": chain.index}
            about = (
                f"Trial {chain.index} of {chain.environment} at {chain.depth:g} m: stage {stage.name} of study "
                f"{self._settings.name}."
            )
        return Run(
            name=chain.label,
            key=chain.label,
            description=about,
            params=params,
            metrics=summary.metrics if summary else {},
            curves=[self._part(stage, manifest, self._n_points(stage)[chain]) for manifest in parts],
            tags={name: f"{value:g}" if name == "depth" else str(value) for name, value in params.items()}
            | _commit(parts),
            artifacts=summary.artifacts if summary else {},
            started=started,
            ended=ended if summary else None,
            status="FINISHED" if summary else None,
        )

    def _n_points(self, stage: AnyStage) -> Mapping[ChainId, int]:
        """Return how many points an item of each chain may add to a curve."""
        if stage.name not in self._points:
            chains = stage.plan(self._settings)
            self._points[stage.name] = {one.identity: -(-_POINTS_OF_A_CURVE // one.n_items) for one in chains}
        return self._points[stage.name]

    def _part(self, stage: AnyStage, manifest: Manifest, n_points: int) -> CurvePart:
        assert stage.curves is not None
        started, ended = self._times([manifest])
        read = partial(_thinned, partial(stage.curves, self._store, manifest), n_points)
        return CurvePart(manifest.digest, read, started or 0.0, ended or 0.0)

    def _times(self, manifests: Sequence[Manifest]) -> tuple[float | None, float | None]:
        """Return when the first of some items was started and the last one committed [s since 1970]."""
        times = []
        for manifest in manifests:
            with contextlib.suppress(OSError):  # it may just have been discarded
                committed = self._store.manifest_path(manifest.stage, manifest.key).stat().st_mtime
                times.append((committed - float(manifest.record.get("seconds", 0.0)), committed))
        return min((started for started, _ in times), default=None), max((ended for _, ended in times), default=None)


def _thinned(read: Callable[[], CurvePoints], n_points: int) -> CurvePoints:
    """Read at most ``n_points`` points: the last one of each stretch of equal length."""
    points = read()
    every = -(-len(points.steps) // n_points) or 1
    chosen = slice((len(points.steps) - 1) % every, None, every)
    return CurvePoints(points.steps[chosen], {name: list(curve)[chosen] for name, curve in points.values.items()})


def _commit(manifests: Sequence[Manifest]) -> dict[str, str]:
    """Return the tag with the commit of the code that made the last of some items, if that is known."""
    commit = manifests[-1].environment.get("commit", "") if manifests else ""
    return {"mlflow.source.git.commit": commit} if commit[:40].isalnum() and len(commit) >= 40 else {}


def _path(name: str) -> str:
    """Return where an artifact lies: in the folder of its kind."""
    folder = _FOLDERS.get(PurePosixPath(name).suffix)
    return f"{folder}/{name}" if folder else name


def _digest_of(results: Results) -> str:
    return digest(canonical_json({chain.label: [m.digest for m in done] for chain, done in results.done.items()}))
