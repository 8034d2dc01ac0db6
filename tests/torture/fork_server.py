"""A server that forks drivers, so that each can die, run out of disk or lose power within milliseconds.

Run as a script (the fixture ``fork_server`` does), it reads one JSON command per line on stdin, forks a child that
executes it, and answers with one line of JSON: what the child recorded, and how it ended. A command for several studies
forks one child per study, all at once. The children are real drivers: they plan, read, verify and commit a whole study
through pipeline.workflow.driver. Only the science is looked up: every work item was computed once, when its study was
first requested, and its bytes stay the same. The server runs no threads, so forking it is safe.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import json
import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import crash_consistency_disk
import yaml

from pipeline.cluster import Cluster, serial_cluster
from pipeline.commands.damage import find_damage, verify
from pipeline.commands.garbage import find_garbage, remove_garbage
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.stages import STAGES
from pipeline.stages.report import PAGE
from pipeline.store import disk
from pipeline.store.encoding import digest
from pipeline.store.store import Store
from pipeline.tracking.mirror import Tracker
from pipeline.workflow.driver import drive
from pipeline.workflow.progress import Work
from pipeline.workflow.stage import AnyStage

TINY = {
    "name": "tiny",
    "throws": {"n_throws": 2, "n_steps": 20},
    "network": {"hidden_layers": 1, "width": 4},
    "training": {"n_iterations": 10, "batch_size": 16},
    "ensemble": {"n_members": 2},
    "grid": {"depths": [1.0], "environments": ["dry_land"], "single_member_depths": [], "n_trials": 1},
    "rollout": {"n_settle": 5, "n_measure": 20},
    "evolution": {"n_generations": 4, "afpo": {"population_size": 4}},
    "transfer": {"n_generations": 2, "adapted_environments": ["dry_land"]},
    "assess": {"n_designs": 8},
    "work": {"throws_per_item": 2, "generations_per_item": 2, "engine": "reference"},
}
"""A study of real work items, as cheap as possible."""

FULL = TINY | {
    "grid": {"depths": [1.0], "environments": ["dry_land"], "single_member_depths": [1.0], "n_trials": 1},
    "ensemble": {"n_members": 1},
}
"""A study that also trains a network."""

LONGER = TINY | {"name": "longer", "evolution": {"n_generations": 8, "afpo": {"population_size": 4}}}
"""A study that shares work with the first."""

STUDIES = {"tiny": TINY, "full": FULL, "longer": LONGER}

N_REPORT_FILES = {"small": 2, "large": None}
"""Number of report files that are committed. A report has dozens, which are all alike to the store."""


class QuietTerminal:
    """A terminal and a tracker that only record what they are sent: neither is under test."""

    def __init__(self, said: list[str]) -> None:
        self.said = said

    def say(self, line: str) -> None:
        self.said.append(line)

    def stage(self, name: str, **counts: Any) -> QuietTerminal:
        return self

    def __enter__(self) -> QuietTerminal:
        return self

    def __exit__(self, *error: object) -> None: ...

    def advance(self, work: Work) -> None: ...

    def mirror(self, *runs: Any) -> None: ...

    def stop(self, study: Any, status: str) -> None: ...


def run_study(
    settings: Settings,
    store: Store,
    terminal: QuietTerminal,
    *,
    stages: Sequence[AnyStage] = STAGES,
    open_cluster: Callable[[], AbstractContextManager[Cluster]] = serial_cluster,
    tracker: Tracker | None = None,
) -> None:
    """Drive the study in a store, as `puddle study --workers 0` does."""
    drive(
        settings,
        stages,
        stages=STAGES,
        store=store,
        open_cluster=open_cluster,
        tracker=tracker or terminal,
        progress=terminal,
        how_to_run=lambda name: f"puddle {name}",
    )


class ClusterProxy:
    """A cluster that forwards every call; subclasses replace :meth:`submit`."""

    def __init__(self, inner: Cluster) -> None:
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def submissions_of(root: Path) -> Path:
    """Return the file in which :func:`logged` records submissions: beside the store."""
    return root.with_suffix(".submitted")


@contextlib.contextmanager
def logged(cluster: AbstractContextManager[Cluster], root: Path) -> Iterator[Cluster]:
    """Log each work item that a driver submits to a cluster: its key, and whether it was already committed."""
    with cluster as inner, submissions_of(root).open("a") as log:

        class Logged(ClusterProxy):
            def submit(
                self, function: Any, compute: Any, compute_batch: Any, jobs: Any, *rest: Any, **more: Any
            ) -> Any:
                for job in jobs:
                    committed = any(root.glob(f"items/*/{job.key[:2]}/{job.key}/manifest.json"))
                    print(job.key, "committed" if committed else "missing", file=log, flush=True)
                return inner.submit(function, compute, compute_batch, jobs, *rest, **more)

        yield Logged(inner)


class ResultCache:
    """The results of work items that were computed once, and a cluster that looks them up."""

    def __init__(self, n_report_files: int | None) -> None:
        self._n_report_files = n_report_files
        self._files: dict[str, Any] = {}

    @contextlib.contextmanager
    def cluster(self, computed: list[str]) -> Iterator[Cluster]:
        """Open a cluster of this process; it appends the key of every work item that it is asked for."""
        cache = self

        class LookedUp(ClusterProxy):
            def submit(self, function: Any, *args: Any, **more: Any) -> Any:
                return self._inner.submit(functools.partial(cache.look_up, computed, function), *args, **more)

        with serial_cluster() as serial:
            yield LookedUp(serial)

    def look_up(self, computed: list[str], compute: Any, stage: Any, stage_batch: Any, jobs: Any, *rest: Any) -> Any:
        """Return what ``compute`` returns for some jobs: their files, and the seconds that they took."""
        computed.extend(job.key for job in jobs)
        if any(job.key not in self._files for job in jobs):
            for job, files in zip(jobs, compute(stage, stage_batch, jobs, *rest)[0], strict=True):
                names = sorted(files, key=lambda name: name != PAGE)[: self._n_report_files] if PAGE in files else files
                self._files[job.key] = {name: files[name] for name in names}
        return [self._files[job.key] for job in jobs], 1.0


class RecordingStore(Store):
    """A store that records the keys of the items committed to it."""

    committed: list[str]

    def commit(self, stage: str, key: str, *rest: Any, **record: Any) -> Any:
        manifest = super().commit(stage, key, *rest, **record)
        self.committed.append(key)
        return manifest


def tree(root: Path) -> dict[str, str]:
    """Return the SHA-256 of every file in a store except its locks, which are empty."""
    return {
        str(path.relative_to(root)): digest(path.read_bytes())
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.suffix != ".lock"
    }


# -- one child -------------------------------------------------------------------------------------------------------


def child(command: dict[str, Any], settings: Settings, answers: list[dict[str, Any]], cache: ResultCache) -> None:
    """Execute a command; record as it happens what happens in each store."""
    for root in map(Path, command["roots"]):
        answers.append({"computed": [], "committed": [], "said": []})
        crash_consistency_disk.arm(command.get("fault"), root.parent)
        if "survey" in command:
            survey = crash_consistency_disk.survey(root.parent, answers[-1]["committed"], **command["survey"])
        if command.get("discard"):
            verify(Store.open(root, create=False), None, discard=True, progress=QuietTerminal([]))
        if command.get("collect"):
            collect_garbage(Store.open(root, create=False))
        if command.get("drive", True):
            drive_study(
                settings, root, answers[-1], cache, last=command.get("last"), mlflow=command.get("mlflow", False)
            )
        inspect(root, answers[-1], whole=command.get("inspect", True))
        if "survey" in command:
            answers[-1]["disks"] = survey.described
            for number, image in enumerate(survey.disks):
                crash_consistency_disk.write_image(image, Path(command["into"]) / str(number))


def collect_garbage(store: Store) -> None:
    """Do what `puddle gc --remove` does."""
    with store.lock_all():
        remove_garbage(store, find_garbage(store))


def drive_study(
    settings: Settings,
    root: Path,
    answer: dict[str, Any],
    cache: ResultCache,
    *,
    last: str | None = None,
    mlflow: bool = False,
) -> None:
    """Do what `puddle study` does; record what was computed and committed, and the error if there was one.

    Args:
        settings: settings of the study.
        root: folder of the store.
        answer: receives the record.
        cache: results of the work items.
        last: name of the last stage to run; all of them if None.
        mlflow: whether to mirror the study to MLflow.
    """
    names = [stage.name for stage in STAGES]
    terminal = QuietTerminal(answer["said"])
    try:
        store = RecordingStore.open(root, create=True)
        store.committed = answer["committed"]
        run_study(
            settings,
            store,
            terminal,
            stages=STAGES[: 1 + names.index(last)] if last else STAGES,
            open_cluster=lambda: cache.cluster(answer["computed"]),
            tracker=Tracker(root, None, say=terminal.say) if mlflow else None,
        )
    except PuddleError as error:
        answer["error"] = str(error)


def inspect(root: Path, answer: dict[str, Any], *, whole: bool) -> None:
    """Record the files of a store and, if it is to be inspected as a whole, what `puddle verify` finds."""
    answer["effects"] = list(crash_consistency_disk.effects())
    crash_consistency_disk.stop_survey()
    answer["tree"] = tree(root)
    is_store = whole and (root / "store.json").exists()  # the disk may have been too small even for that
    answer["wrong"] = [str(error) for error in find_damage(Store.open(root, create=False))] if is_store else []


def fork(command: dict[str, Any], settings: Settings, cache: ResultCache) -> tuple[int, int]:
    """Fork a child; return its process id and the pipe that its record comes through."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        gc.disable()
        answers: list[dict[str, Any]] = []

        def end(code: int, **more: Any) -> None:
            with os.fdopen(writing, "w") as pipe:
                json.dump({"answers": answers, **more}, pipe)
            os._exit(code)

        crash_consistency_disk.at_death(functools.partial(end, crash_consistency_disk.DEAD))
        try:
            child(command, settings, answers, cache)
        except BaseException:
            end(1, traceback=traceback.format_exc())
        end(0)
    os.close(writing)
    return pid, reading


def outcome(pid: int, reading: int) -> dict[str, Any]:
    """Wait until a child ends; return its record and its exit code."""
    with os.fdopen(reading) as pipe:
        said = pipe.read()
    _, status = os.waitpid(pid, 0)
    return {**json.loads(said), "status": os.waitstatus_to_exitcode(status)}


def main(size: str) -> None:
    """Serve commands until stdin ends; compute a study before its first command."""
    cache = ResultCache(N_REPORT_FILES[size])

    @functools.cache
    def ready(name: str) -> Settings:
        settings = parse(Settings, yaml.safe_dump(STUDIES[name]), name=name)
        with tempfile.TemporaryDirectory() as folder:
            store = Store.open(Path(folder) / "store", create=True)
            run_study(settings, store, QuietTerminal([]), open_cluster=lambda: cache.cluster([]))
        gc.freeze()
        return settings

    crash_consistency_disk.watch(disk)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever else prints, prints elsewhere
    for line in sys.stdin:
        command = json.loads(line)
        studies = [ready(name) for name in command.get("studies", [command.get("study", "tiny")])]
        children = [fork(command, settings, cache) for settings in studies]
        ended = [outcome(*one) for one in children]
        print(json.dumps(ended if "studies" in command else ended[0]), file=answers, flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
