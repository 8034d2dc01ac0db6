"""Studies whose work items are computed once and then looked up, so that a real driver ends one within milliseconds."""

from __future__ import annotations

import contextlib
import functools
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from small_study import ON_DRY_LAND, Terminal

from pipeline.cluster import Cluster, serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.stages.report import PAGE
from pipeline.store.encoding import digest
from pipeline.store.store import Store
from pipeline.workflow.driver import drive
from pipeline.workflow.stage import AnyStage

N_REPORT_FILES = 2  # that are committed; a report has dozens, which are all alike to the store


def run_study(
    settings: Settings,
    store: Store,
    *,
    stages: Sequence[AnyStage] = STAGES,
    open_cluster: Callable[[], AbstractContextManager[Cluster]] = serial_cluster,
) -> None:
    """Drive the study in a store, as `puddle study --workers 0` does."""
    drive(
        settings, stages, stages=STAGES, store=store, open_cluster=open_cluster, tracker=Terminal(), progress=Terminal()
    )


def tree(root: Path) -> dict[str, str]:
    """Return the SHA-256 of every file in a store except its locks, which are empty."""
    return {
        str(path.relative_to(root)): digest(path.read_bytes())
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.suffix != ".lock"
    }


@dataclass
class Record:
    """The keys of the items that a driver computed and committed; it grows while the driver runs."""

    computed: list[str] = field(default_factory=list)
    committed: list[str] = field(default_factory=list)


class QuickStudy:
    """A study, and the results of its work items."""

    def __init__(self) -> None:
        self._settings = parse(Settings, ON_DRY_LAND, name="tiny")
        self._files: dict[str, Any] = {}
        with tempfile.TemporaryDirectory() as folder:
            self.drive(Path(folder) / "store")

    def drive(self, root: Path, *, last: str | None = None, record: Record | None = None) -> Record:
        """Drive the study in a store, up to the stage that is named ``last``."""
        record = Record() if record is None else record

        class RecordingStore(Store):
            def commit(self, *rest: Any, **more: Any) -> Any:
                manifest = super().commit(*rest, **more)
                record.committed.append(manifest.key)
                return manifest

        n_stages = 1 + [stage.name for stage in STAGES].index(last or STAGES[-1].name)
        run_study(
            self._settings,
            RecordingStore.open(root, create=True),
            stages=STAGES[:n_stages],
            open_cluster=lambda: self._cluster(record),
        )
        return record

    @contextlib.contextmanager
    def _cluster(self, record: Record) -> Iterator[Cluster]:
        with serial_cluster() as serial:
            submit = serial.submit
            serial.submit = lambda function, *args, **more: submit(
                functools.partial(self._look_up, record, function), *args, **more
            )
            yield serial

    def _look_up(self, record: Record, compute: Any, stage: Any, stage_batch: Any, jobs: Any, *rest: Any) -> Any:
        """Return what ``compute`` returns for some jobs: their files, and the seconds that they took."""
        record.computed.extend(job.key for job in jobs)
        if any(job.key not in self._files for job in jobs):
            for job, files in zip(jobs, compute(stage, stage_batch, jobs, *rest)[0], strict=True):
                names = sorted(files, key=lambda name: name != PAGE)[:N_REPORT_FILES] if PAGE in files else files
                self._files[job.key] = {name: files[name] for name in names}
        return [self._files[job.key] for job in jobs], 1.0
