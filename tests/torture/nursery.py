"""The nursery: a process that forks drivers, so that each can die, run out of disk or lose power in milliseconds.

Run as a script (the fixture ``nursery`` does), it reads one JSON command a line on stdin, forks a child that carries
it out, and answers with one JSON line: what the child said, and how it ended. A command for several studies is carried
out by a child for each, at once. The children are real drivers: they plan, read, verify and commit a whole study
through pipeline.workflow.driver. Only the science is looked up: every piece was computed once, when its study was first asked
for, and its bytes stay the same. It holds no threads, so that forking it is sound.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import json
import os
import resource
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import volatile
import yaml

import pipeline.workflow.dispatcher
from pipeline.cluster import Cluster, serial_cluster
from pipeline.commands.damage import find_damage, verify_lines
from pipeline.commands.garbage import find_garbage, remove_garbage
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.stages import STAGES
from pipeline.stages.report import PAGE
from pipeline.store import disk
from pipeline.store.encoding import digest
from pipeline.store.store import Store
from pipeline.tracking.mirror import Tracker, open_tracker
from pipeline.workflow.driver import drive
from pipeline.workflow.progress import Work
from pipeline.workflow.stage import Stage

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
"""A study of real pieces, as cheap as can be."""

FULL = TINY | {
    "grid": {"depths": [1.0], "environments": ["dry_land"], "single_member_depths": [1.0], "n_trials": 1},
    "ensemble": {"n_members": 1},
}
"""One that trains a network too."""

LONGER = TINY | {"name": "longer", "evolution": {"n_generations": 8, "afpo": {"population_size": 4}}}
"""One that shares work with the first."""

STUDIES = {"tiny": TINY, "full": FULL, "longer": LONGER}

N_OF_PAGE = {"small": 3, "large": None}
"""Files kept of the report: it has dozens, which are all alike to the store."""


class Quiet:
    """A terminal and a tracker that keep what they are told: neither is what is put to the test."""

    def __init__(self, said: list[str]) -> None:
        self.said = said

    def say(self, line: str) -> None:
        self.said.append(line)

    def stage(self, name: str, **counts: Any) -> Quiet:
        return self

    def __enter__(self) -> Quiet:
        return self

    def __exit__(self, *error: object) -> None: ...

    def advance(self, work: Work) -> None: ...

    def mirror(self, *runs: Any) -> None: ...


def run_study(
    settings: Settings,
    root: Path,
    terminal: Quiet,
    *,
    stages: Sequence[Stage] = STAGES,
    open_cluster: Callable[[], AbstractContextManager[Cluster]] = serial_cluster,
    tracker: Tracker | None = None,
) -> None:
    """Drive the study in a store, as `puddle study --workers 0` does."""
    drive(
        settings,
        stages,
        store=Store.open(root, create=True),
        open_cluster=open_cluster,
        tracker=tracker or terminal,
        progress=terminal,
        how_to_run=lambda name: f"puddle {name}",
    )


def submitted_to(root: Path) -> Path:
    """Return where :func:`noted` writes: beside the store."""
    return root.with_suffix(".submitted")


@contextlib.contextmanager
def noted(cluster: AbstractContextManager[Cluster], root: Path) -> Iterator[Cluster]:
    """Write down each piece that a driver submits to a cluster: its key, and whether the store held it by then."""
    with cluster as inner, submitted_to(root).open("a") as log:

        class Noted:
            def __getattr__(self, name: str) -> Any:
                return getattr(inner, name)

            def submit(self, function: Any, compute: Any, abreast: Any, jobs: Any, *rest: Any, **execution: Any) -> Any:
                for job in jobs:
                    held = any(root.glob(f"items/*/{job.key[:2]}/{job.key}/manifest.json"))
                    print(job.key, "held" if held else "missing", file=log, flush=True)
                return inner.submit(function, compute, abreast, jobs, *rest, **execution)

        yield Noted()


def tree(root: Path) -> dict[str, str]:
    """Give the SHA-256 of every file in a store but its locks, which hold nothing."""
    return {
        str(path.relative_to(root)): digest(path.read_bytes())
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.suffix != ".lock"
    }


# -- one child -------------------------------------------------------------------------------------------------------


def child(command: dict[str, Any], settings: Settings, answers: list[dict[str, Any]]) -> None:
    """Carry out a command, noting of each store what happened as it happens."""
    if "file_bytes" in command:
        resource.setrlimit(resource.RLIMIT_FSIZE, (command["file_bytes"],) * 2)
    if "without" in command:
        fsync, of_folders = disk.fsync, command["without"] == "fsync of folders"
        disk.fsync = lambda path: None if path.is_dir() == of_folders else fsync(path)
    for root in map(Path, command["roots"]):
        answers.append({"computed": [], "committed": [], "said": []})
        volatile.arm(command.get("fault"), root.parent)
        if "survey" in command:
            survey = volatile.survey(root.parent, answers[-1]["committed"], **command["survey"])
        if command.get("discard"):
            verify_lines(Store.open(root, create=False), discard=True, progress=Quiet([]), how_to_run=str)
        if command.get("collect"):
            collect_garbage(Store.open(root, create=False))
        if command.get("drive", True):
            study(settings, root, answers[-1], mlflow=command.get("mlflow", False))
        look_at(root, answers[-1], whole=command.get("look", True))
        if "survey" in command:
            answers[-1]["disks"] = survey.told
            for number, image in enumerate(survey.disks):
                volatile.lay_out(image, Path(command["into"]) / str(number))
        if command.get("fault", {}).get("at") == "end":
            volatile.strike()


def collect_garbage(store: Store) -> None:
    """Be a `puddle gc --remove`."""
    with store.lock_all():
        remove_garbage(store, find_garbage(store))


def study(settings: Settings, root: Path, answer: dict[str, Any], *, mlflow: bool = False) -> None:
    """Be a driver."""

    def looked_up(compute: Any, compute_batch: Any, jobs: Any, *rest: Any) -> Any:
        answer["computed"].extend(job.key for job in jobs)
        return look_up(compute, compute_batch, jobs, *rest)

    def noted(store: Store, stage: str, key: str, *rest: Any, **record: Any) -> Any:
        manifest = commit(store, stage, key, *rest, **record)
        answer["committed"].append(key)
        return manifest

    look_up, commit = pipeline.workflow.dispatcher.compute_items, Store.commit
    pipeline.workflow.dispatcher.compute_items, Store.commit = looked_up, noted
    terminal = Quiet(answer["said"])
    try:
        run_study(settings, root, terminal, tracker=open_tracker(root, None, say=terminal.say) if mlflow else None)
    except PuddleError as error:
        answer["error"] = str(error)
    finally:
        pipeline.workflow.dispatcher.compute_items, Store.commit = look_up, commit


def look_at(root: Path, answer: dict[str, Any], *, whole: bool) -> None:
    """Look at a store: at all of it, or at its files alone."""
    answer["effects"] = list(volatile.effects())
    volatile.rest()
    answer["tree"] = tree(root)
    is_store = whole and (root / "store.json").exists()  # or there was no room even for that
    answer["wrong"] = [str(error) for error in find_damage(Store.open(root, create=False))] if is_store else []


def fork(command: dict[str, Any], settings: Settings) -> tuple[int, int]:
    """Fork a child; return its process and the pipe through which it tells what it has noted."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        gc.disable()
        answers: list[dict[str, Any]] = []

        def end(code: int, **more: Any) -> None:
            with os.fdopen(writing, "w") as pipe:
                json.dump({"answers": answers, **more}, pipe)
            os._exit(code)

        volatile.at_death(functools.partial(end, volatile.DEAD))
        try:
            child(command, settings, answers)
        except BaseException:
            end(1, traceback=traceback.format_exc())
        end(0)
    os.close(writing)
    return pid, reading


def outcome(pid: int, reading: int) -> dict[str, Any]:
    """Wait for a child's end, and return what it had noted."""
    with os.fdopen(reading) as pipe:
        said = pipe.read()
    _, status = os.waitpid(pid, 0)
    return {**json.loads(said), "status": os.waitstatus_to_exitcode(status)}


def main(size: str) -> None:
    """Compute the study, say so, and serve commands until stdin ends."""
    compute, cache = pipeline.workflow.dispatcher.compute_items, {}

    def keeping(execution: Any, how_abreast: Any, jobs: Any, *rest: Any) -> Any:
        if any(job.key not in cache for job in jobs):
            for job, files in zip(jobs, compute(execution, how_abreast, jobs, *rest)[0], strict=True):
                kept = sorted(files, key=lambda name: name != PAGE)[: N_OF_PAGE[size]] if PAGE in files else files
                cache[job.key] = {name: files[name] for name in kept}
        return [cache[job.key] for job in jobs], 1.0

    @functools.cache
    def ready(name: str) -> Settings:
        settings = parse(Settings, yaml.safe_dump(STUDIES[name]), name=name)
        with tempfile.TemporaryDirectory() as folder:
            run_study(settings, Path(folder) / "store", Quiet([]))
        gc.freeze()
        return settings

    pipeline.workflow.dispatcher.compute_items = keeping
    volatile.watch(disk)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever else prints, prints elsewhere
    for line in sys.stdin:
        command = json.loads(line)
        if command.get("mlflow"):
            pass
        studies = [ready(name) for name in command.get("studies", [command.get("study", "tiny")])]
        children = [fork(command, settings) for settings in studies]
        told = [outcome(*one) for one in children]
        print(json.dumps(told if "studies" in command else told[0]), file=answers, flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
