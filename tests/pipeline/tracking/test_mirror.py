"""The mirror in a real MLflow database: complete, never double, and never in the study's way."""

import contextlib
import getpass
import math
import os
import shutil
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mlflow.tracking import MlflowClient

from pipeline.errors import PuddleError
from pipeline.tracking.database import EXPERIMENT, database_uri
from pipeline.tracking.mirror import Tracker
from pipeline.tracking.run import CurvePart, CurvePoints, Run
from pipeline.tracking.server import show_ui

STUDY = Run("smoke", "5" * 64, params={"evolution": {"n_generations": 1500}}, tags={"preset": "smoke"})
STAGE = Run(
    "evolve",
    "e" * 64,
    metrics={"best": 9.5, "undefined": math.nan},
    artifacts={"figures/fitness.svg": b"<svg/>"},
    status="FINISHED",
)
CURVE = np.linspace(0, 1, 1500)


def part(digest: str, first: int, **curves: Sequence[float]) -> CurvePart:
    """Return part of a run's curves, as a segment adds it: a generation per second, from ``first`` on."""
    n_points = len(next(iter(curves.values())))
    points = CurvePoints(range(first, first + n_points), curves)
    return CurvePart(digest, lambda: points, 1e9 + first, 1e9 + first + n_points)


def parts(k: int) -> list[CurvePart]:
    bounds = [(0, 700), (700, 1500)]
    return [part(f"{k}-{a}", a, fitness=CURVE[a:b] + k, deviation=CURVE[a:b]) for a, b in bounds]


TRIALS = [Run(f"trial {k}", str(k), params={"trial": k}, curves=parts(k), status="FINISHED") for k in range(2)]


@pytest.fixture(autouse=True)
def only_our_server(monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture(scope="module")
def empty_database(tmp_path_factory) -> Path:
    """A database that MLflow has created and that is unused: to make one is hundreds of statements."""
    folder = tmp_path_factory.mktemp("empty")
    client(folder).search_experiments()
    return folder / "mlflow.db"


@pytest.fixture
def store(tmp_path, empty_database) -> Path:
    """A store's folder, as far as the mirror knows one."""
    shutil.copy(empty_database, tmp_path)
    return tmp_path


def client(store: Path) -> MlflowClient:
    return MlflowClient(database_uri(store))


def runs(store: Path):
    mlflow = client(store)
    found = mlflow.search_runs([mlflow.get_experiment_by_name(EXPERIMENT).experiment_id])
    return {(run.data.tags["puddle.kind"], run.info.run_name): run for run in found}


def everything(store: Path):
    """All that MLflow holds."""
    mlflow = client(store)
    return {
        run.info.run_id: (
            (run.info.status, run.info.start_time, run.info.end_time),
            run.data.params,
            run.data.tags,
            {
                name: [(m.step, m.value, m.timestamp) for m in mlflow.get_metric_history(run.info.run_id, name)]
                for name in run.data.metrics
            },
            sorted(one.path for one in mlflow.list_artifacts(run.info.run_id)),
        )
        for run in runs(store).values()
    }


def test_a_study_its_stage_and_its_trials(tmp_path, said):
    Tracker(tmp_path, say=said.append).mirror(STUDY, STAGE, TRIALS)
    assert said == []
    found = runs(tmp_path)
    study, stage, trial = found["study", "smoke"], found["stage", "evolve"], found["trial", "trial 1"]
    assert len(found) == 4
    assert stage.data.tags["mlflow.parentRunId"] == study.info.run_id
    assert trial.data.tags["mlflow.parentRunId"] == stage.info.run_id
    assert (study.info.status, stage.info.status, trial.info.status) == ("RUNNING", "FINISHED", "FINISHED")
    assert study.data.params == {"evolution.n_generations": "1500"}
    assert study.data.tags["preset"] == "smoke"
    history = client(tmp_path).get_metric_history(trial.info.run_id, "fitness")
    assert [point.value for point in sorted(history, key=lambda point: point.step)] == list(CURVE + 1)
    assert [point.step for point in sorted(history, key=lambda point: point.step)] == list(range(1500))
    artifacts = tmp_path / "mlartifacts" / stage.info.run_id / "artifacts"
    assert (artifacts / "figures" / "fitness.svg").read_bytes() == b"<svg/>"


@pytest.mark.parametrize("name", ["what?", "a%3Fb", "q?x=1#y", os.fsdecode(b"st\xf6re")])
def test_a_store_whose_name_means_another_place_in_an_address_goes_without_a_mirror(tmp_path, said, name):
    """In a URI, what follows ? is no part of the path, and %3F is a ?."""
    store = tmp_path / name
    store.mkdir()
    Tracker(store, say=said.append).mirror(STUDY, STAGE)
    (line,) = said
    assert "expected a path that MLflow accepts unchanged" in line and "The study continues" in line
    assert [path.name for path in store.iterdir()] == ["mlflow.lock"] and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("name", ["a#b", "a b", "größe"])
def test_a_store_of_an_odd_name_keeps_its_mirror_inside(tmp_path, empty_database, said, name):
    store = tmp_path / name
    store.mkdir()
    shutil.copy(empty_database, store)
    Tracker(store, say=said.append).mirror(STUDY, STAGE)
    assert said == [] and set(runs(store)) == {("study", "smoke"), ("stage", "evolve")}
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_mirrored_twice_is_mirrored_once(store, said):
    Tracker(store, say=said.append).mirror(STUDY, STAGE, TRIALS)
    once = everything(store)
    for _ in range(2):
        tracker = Tracker(store, say=said.append)
        tracker.mirror(STUDY, STAGE, TRIALS)
        tracker.mirror(STUDY, STAGE, TRIALS)
    assert said == []
    assert everything(store) == once


def test_what_changed_is_brought_up_to_date_in_place(store, said):
    tracker = Tracker(store, say=said.append)
    half = [replace(trial, curves=trial.curves[:1], status=None) for trial in TRIALS]
    tracker.mirror(STUDY, replace(STAGE, metrics={"best": 3.0}, status="FAILED"), half)
    before = runs(store)
    tracker.mirror(replace(STUDY, status="FINISHED"), STAGE, TRIALS)
    after = runs(store)
    assert said == []
    assert {slot: run.info.run_id for slot, run in before.items()} == {s: run.info.run_id for s, run in after.items()}
    assert before["stage", "evolve"].info.status == "FAILED"
    assert {run.info.status for run in after.values()} == {"FINISHED"}
    assert after["stage", "evolve"].data.metrics == {"best": 9.5}
    history = client(store).get_metric_history(after["trial", "trial 0"].info.run_id, "fitness")
    assert sorted(point.step for point in history) == list(range(1500))


def test_only_finite_values_are_sent(store, said):
    curves = {"fitness": [1.0, math.nan, -math.inf, 4.0], "nothing": [math.nan] * 4}
    trial = Run("trial 0", "0", curves=[part("a", 0, **curves)])
    Tracker(store, say=said.append).mirror(STUDY, STAGE, [trial])
    found = runs(store)
    assert found["stage", "evolve"].data.metrics == {"best": 9.5}
    history = client(store).get_metric_history(found["trial", "trial 0"].info.run_id, "fitness")
    assert [(point.step, point.value) for point in history] == [(0, 1.0), (3, 4.0)]
    assert "nothing" not in found["trial", "trial 0"].data.metrics
    assert said == []


def test_an_interrupted_mirror_is_completed_without_doubles(store, said):
    """A death between two batches of one curve leaves half of it; the next driver sends the rest."""
    tracker = Tracker(store, say=said.append)
    tracker.mirror(STUDY, STAGE)
    log_batch = MlflowClient.log_batch
    n_batches = 0

    class DyingClient(MlflowClient):
        def log_batch(self, *args, **kwargs):
            nonlocal n_batches
            n_batches += 1
            if n_batches == 3:
                raise KeyboardInterrupt
            return log_batch(self, *args, **kwargs)

    tracker._experiment = replace(tracker._experiment, client=DyingClient(database_uri(store)))
    with pytest.raises(KeyboardInterrupt):
        tracker.mirror(STUDY, STAGE, TRIALS)
    sent = client(store).get_metric_history(runs(store)["trial", "trial 0"].info.run_id, "fitness")
    assert 0 < len(sent) <= 1500 and runs(store)["trial", "trial 0"].info.status == "RUNNING"
    Tracker(store, say=said.append).mirror(STUDY, STAGE, TRIALS)
    completed = everything(store)
    for run in completed.values():
        assert all(len(points) in (1, 1500) for points in run[3].values())
    assert sum(len(points) == 1500 for run in completed.values() for points in run[3].values()) == 4
    assert said == []


def test_a_failing_mlflow_is_said_once_and_caught_up_with(tmp_path, said, monkeypatch):
    monkeypatch.chdir(tmp_path)  # of a database that is not the store's, MLflow keeps the artifacts here
    folder = tmp_path / "elsewhere"
    folder.touch()  # a file where a folder is needed
    tracker = Tracker(tmp_path, f"sqlite:///{folder}/mlflow.db", say=said.append)
    tracker.mirror(STUDY, replace(STAGE, name="collect", key="c"))
    tracker.mirror(STUDY, STAGE, TRIALS)
    assert len(said) == 1
    assert str(folder) in said[0] and "The study continues" in said[0]
    folder.unlink()
    folder.mkdir()
    tracker.mirror(STUDY, replace(STAGE, name="transfer", key="t"))
    assert len(said) == 1
    assert set(runs(folder)) == {
        ("study", "smoke"),
        ("stage", "collect"),
        ("stage", "evolve"),
        ("stage", "transfer"),
        ("trial", "trial 0"),
        ("trial", "trial 1"),
    }


@contextlib.contextmanager
def silent_server() -> Iterator[int]:
    """Listen on a port, but never answer."""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        yield listening.getsockname()[1]


@contextlib.contextmanager
def no_server() -> Iterator[int]:
    """Return a port on which nothing listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        yield probe.getsockname()[1]


@pytest.mark.parametrize(
    ("server", "scheme"), [(no_server, "http"), (silent_server, "http"), (no_server, "postgresql+psycopg2")]
)
def test_an_unreachable_database_is_noticed_within_seconds_and_once(tmp_path, said, monkeypatch, server, scheme):
    with server() as port:
        uri = f"{scheme}://127.0.0.1:{port}"
        monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
        tracker = Tracker(tmp_path, say=said.append)
        for _ in range(2):
            begin = time.monotonic()
            tracker.mirror(STUDY, STAGE, TRIALS)
            assert time.monotonic() - begin < 5  # MLflow itself takes minutes
    assert len(said) == 1 and uri in said[0] and "does not answer" in said[0]
    assert not (tmp_path / "mlflow.db").exists()


def test_a_run_has_the_times_user_and_description_of_its_work(store, said):
    stage = replace(STAGE, description="Stage 3 of 7.", started=1.7e9, ended=1.7e9 + 60)
    Tracker(store, say=said.append).mirror(STUDY, stage, TRIALS)
    found = runs(store)["stage", "evolve"]
    assert (found.info.start_time, found.info.end_time) == (1_700_000_000_000, 1_700_000_060_000)
    assert found.info.user_id == getpass.getuser()
    assert found.data.tags["mlflow.note.content"] == "Stage 3 of 7."
    assert (found.data.tags["study"], found.data.tags["study_digest"]) == ("smoke", STUDY.key)
    history = client(store).get_metric_history(runs(store)["trial", "trial 0"].info.run_id, "fitness")
    by_step = {point.step: point.timestamp for point in history}
    assert (by_step[0], by_step[700], by_step[1499]) == (1_000_000_001_000, 1_000_000_701_000, 1_000_001_500_000)
    assert said == []


def test_only_the_new_parts_of_a_growing_curve_are_read(store, said):
    def refuse() -> CurvePoints:
        raise AssertionError("read again")

    trial = TRIALS[0]
    first, second = trial.curves
    Tracker(store, say=said.append).mirror(STUDY, STAGE, [replace(trial, curves=[first])])
    for _ in range(2):  # another driver knows from MLflow what was sent
        Tracker(store, say=said.append).mirror(
            STUDY, STAGE, [replace(trial, curves=[replace(first, read=refuse), second])]
        )
        second = replace(second, read=refuse)
    history = client(store).get_metric_history(runs(store)["trial", "trial 0"].info.run_id, "fitness")
    assert sorted((point.step, point.value) for point in history) == list(enumerate(CURVE))
    assert said == []


def test_a_stage_adds_files_to_other_runs(store, said):
    films = {("trial", "e" * 64 + "/0"): {"films/swim.mp4": b"film"}, ("trial", "gone"): {"films/swim.mp4": b""}}
    report = Run("report", "report", attachments={**films, ("study", STUDY.key): {"page/index.html": b"<html>"}})
    for _ in range(2):
        tracker = Tracker(store, say=said.append)
        tracker.mirror(STUDY, STAGE, TRIALS)
        tracker.mirror(STUDY, report)
    found, files = runs(store), store / "mlartifacts"
    trial, study = found["trial", "trial 0"].info.run_id, found["study", "smoke"].info.run_id
    assert (files / trial / "artifacts/films/swim.mp4").read_bytes() == b"film"
    assert (files / study / "artifacts/page/index.html").read_bytes() == b"<html>"
    assert said == []


def test_what_is_unfinished_is_stopped_and_runs_again_when_resumed(store, said):
    def statuses() -> dict[str, str]:
        return {name: run.info.status for (_, name), run in runs(store).items()}

    done, half = TRIALS[0], replace(TRIALS[1], curves=TRIALS[1].curves[:1], status=None)
    unfinished = replace(STAGE, status=None)
    Tracker(store, say=said.append).stop(STUDY, "KILLED")  # nothing was mirrored yet
    tracker = Tracker(store, say=said.append)
    tracker.mirror(STUDY, unfinished, [done, half])
    tracker.stop(STUDY, "KILLED")
    assert statuses() == {"smoke": "KILLED", "evolve": "KILLED", "trial 0": "FINISHED", "trial 1": "KILLED"}
    tracker = Tracker(store, say=said.append)
    tracker.mirror(STUDY, unfinished, [half])
    assert statuses() == {"smoke": "RUNNING", "evolve": "RUNNING", "trial 0": "FINISHED", "trial 1": "RUNNING"}
    tracker.stop(STUDY, "FAILED")
    assert statuses() == {"smoke": "FAILED", "evolve": "FAILED", "trial 0": "FINISHED", "trial 1": "FAILED"}
    Tracker(store, say=said.append).mirror(replace(STUDY, status="FINISHED"), STAGE, TRIALS)
    assert set(statuses().values()) == {"FINISHED"} and said == []


# -- what users' machines do to it -----------------------------------------------------------------------------------


def test_a_deleted_experiment_is_restored(store, said):
    Tracker(store, say=said.append).mirror(STUDY, STAGE)
    mlflow = client(store)
    mlflow.delete_experiment(mlflow.get_experiment_by_name(EXPERIMENT).experiment_id)
    Tracker(store, say=said.append).mirror(STUDY, STAGE, TRIALS)
    assert len(runs(store)) == 4 and said == []


def test_the_artifacts_of_a_moved_store_move_with_it(store, said, tmp_path_factory):
    Tracker(store, say=said.append).mirror(STUDY, STAGE)
    moved = tmp_path_factory.mktemp("moved") / "store"
    shutil.move(store, moved)
    Tracker(moved, say=said.append).mirror(STUDY, STAGE, [replace(TRIALS[0], artifacts={"champion.json": b"{}"})])
    found = {name: run.info.run_id for (_, name), run in runs(moved).items()}
    assert (moved / "mlartifacts" / found["trial 0"] / "artifacts" / "champion.json").read_bytes() == b"{}"
    assert [one.path for one in client(moved).list_artifacts(found["evolve"])] == ["figures"]
    assert said == [] and not store.exists()


def of_version(version: str) -> Callable[[Path], None]:
    def spoil(database: Path) -> None:
        with contextlib.closing(sqlite3.connect(database)) as connection:
            connection.execute("UPDATE alembic_version SET version_num = ?", (version,))
            connection.commit()

    return spoil


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (of_version("451aebb31d03"), "it was made by another version of MLflow"),
        (of_version("of a newer one"), "it was made by another version of MLflow"),
        (lambda database: database.write_bytes(b"no database at all" * 100), "not a database"),
    ],
)
def test_a_database_that_mlflow_cannot_use_is_one_sentence(store, said, spoil, reason):
    spoil(store / "mlflow.db")
    tracker = Tracker(store, say=said.append)
    tracker.mirror(STUDY, STAGE)
    tracker.mirror(STUDY, STAGE, TRIALS)
    with pytest.raises(PuddleError) as refused:
        show_ui(store, 5000)
    for told in (*said, str(refused.value)):
        assert told.startswith(f"{store / 'mlflow.db'}: MLflow cannot use it: ") and len(told.splitlines()) == 1
        assert reason in told and "delete it, and `puddle study` rebuilds it" in told
    assert len(said) == 1


def test_a_folder_of_files_as_the_tracking_uri(tmp_path, said, monkeypatch, capfd):
    """As notebooks and tutorials set it; MLflow may refuse it, and is then named in one line."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "./mlruns")
    tracker = Tracker(tmp_path, say=said.append)
    tracker.mirror(STUDY, STAGE)
    tracker.mirror(STUDY, STAGE, TRIALS)
    assert len(said) <= 1 and all(len(line.splitlines()) == 1 for line in said)
    assert capfd.readouterr().err == ""


def test_a_store_that_cannot_be_written_does_not_stop_the_study(tmp_path, said):
    Tracker(tmp_path / "gone", say=said.append).mirror(STUDY, STAGE)
    assert len(said) == 1 and "No such file" in said[0]


def test_two_drivers_at_once_make_one_database(tmp_path):
    """Whose interpreters have nothing in common; eight that are forks of one are in tests/torture."""
    script = """
import sys
from pathlib import Path
from pipeline.tracking.mirror import Tracker
from pipeline.tracking.run import Run
def say(line):
    sys.exit(line)
name = sys.argv[2]
Tracker(Path(sys.argv[1]), say=say).mirror(Run(name, name), Run("collect", "c", metrics={"seconds": 1.0}))
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    drivers = [
        subprocess.Popen(
            [sys.executable, "-c", script, str(tmp_path), f"study-{k}"],
            env=environment,
            stderr=subprocess.PIPE,
            text=True,
        )
        for k in range(2)
    ]
    errors = [driver.communicate(timeout=120)[1] for driver in drivers]
    assert [driver.returncode for driver in drivers] == [0] * 2, errors
    assert errors == [""] * 2  # nothing is logged to the terminal either
    assert {name for kind, name in runs(tmp_path) if kind == "study"} == {f"study-{k}" for k in range(2)}
