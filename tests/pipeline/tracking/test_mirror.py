"""The mirror in a real MLflow database: complete, never double, and never in the study's way."""

import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from mlflow.tracking import MlflowClient

from pipeline.errors import PuddleError
from pipeline.tracking.mirror import EXPERIMENT, Run, Tracker, database_uri, serve_ui

STUDY = Run("smoke", "5" * 64, params={"evolution": {"n_generations": 1500}}, tags={"preset": "smoke"})
STAGE = Run(
    "evolve",
    "e" * 64,
    metrics={"best": 9.5, "undefined": math.nan},
    inputs={"train": "a" * 64},
    outputs={"history": "b" * 64},
    artifacts={"figures/fitness.svg": b"<svg/>"},
    status="FINISHED",
)
CURVE = np.linspace(0, 1, 1500)
TRIALS = [
    Run(f"trial {k}", str(k), params={"trial": k}, curves={"fitness": CURVE + k, "deviation": CURVE}, status="FINISHED")
    for k in range(2)
]


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
    """All that MLflow holds, times apart."""
    mlflow = client(store)
    return {
        run.info.run_id: (
            run.info.status,
            run.data.params,
            run.data.tags,
            {
                name: [(m.step, m.value) for m in mlflow.get_metric_history(run.info.run_id, name)]
                for name in run.data.metrics
            },
            [(one.dataset.name, one.dataset.digest) for one in run.inputs.dataset_inputs],
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
    assert stage.data.tags["puddle.output.history"] == "b" * 64
    (read,) = stage.inputs.dataset_inputs
    assert (read.dataset.name, read.dataset.digest) == ("train", "a" * 36)
    assert json.loads(read.dataset.source) == {"sha256": "a" * 64}
    history = client(tmp_path).get_metric_history(trial.info.run_id, "fitness")
    assert [point.value for point in sorted(history, key=lambda point: point.step)] == list(CURVE + 1)
    assert [point.step for point in sorted(history, key=lambda point: point.step)] == list(range(1500))
    artifacts = tmp_path / "mlartifacts" / stage.info.run_id / "artifacts"
    assert (artifacts / "figures" / "fitness.svg").read_bytes() == b"<svg/>"
    lineage = json.loads((artifacts / "lineage.json").read_text())
    assert lineage == {"inputs": {"train": "a" * 64}, "outputs": {"history": "b" * 64}}


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
    half = [replace(trial, curves={"fitness": trial.curves["fitness"][:700]}, status=None) for trial in TRIALS]
    tracker.mirror(STUDY, replace(STAGE, metrics={"best": 3.0}, inputs={}, status="FAILED"), half)
    before = runs(store)
    tracker.mirror(replace(STUDY, status="FINISHED"), STAGE, TRIALS)
    after = runs(store)
    assert said == []
    assert {slot: run.info.run_id for slot, run in before.items()} == {s: run.info.run_id for s, run in after.items()}
    assert before["stage", "evolve"].info.status == "FAILED"
    assert {run.info.status for run in after.values()} == {"FINISHED"}
    assert after["stage", "evolve"].data.metrics == {"best": 9.5}
    assert len(after["stage", "evolve"].inputs.dataset_inputs) == 1
    history = client(store).get_metric_history(after["trial", "trial 0"].info.run_id, "fitness")
    assert sorted(point.step for point in history) == list(range(1500))


def test_another_key_is_another_run(store, said):
    tracker = Tracker(store, say=said.append)
    tracker.mirror(STUDY, STAGE)
    tracker.mirror(replace(STUDY, key="6" * 64, params={"evolution": {"n_generations": 9}}), STAGE)
    mlflow = client(store)
    found = mlflow.search_runs([mlflow.get_experiment_by_name(EXPERIMENT).experiment_id])
    assert len(found) == 4  # two studies of one name, each with its own stage
    assert said == []


def test_only_finite_values_are_sent(store, said):
    trial = Run("trial 0", "0", curves={"fitness": [1.0, math.nan, -math.inf, 4.0], "nothing": [math.nan]})
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


def test_a_server_that_is_away_costs_seconds(tmp_path, said, monkeypatch):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://127.0.0.1:{probe.getsockname()[1]}")
    begin = time.monotonic()
    Tracker(tmp_path, say=said.append).mirror(STUDY, STAGE, TRIALS)
    assert time.monotonic() - begin < 120  # MLflow itself takes minutes
    assert len(said) == 1 and os.environ["MLFLOW_TRACKING_URI"] in said[0]
    assert not (tmp_path / "mlflow.db").exists()


def test_a_store_that_cannot_be_written_does_not_stop_the_study(tmp_path, said):
    Tracker(tmp_path / "gone", say=said.append).mirror(STUDY, STAGE)
    assert len(said) == 1 and "FileNotFoundError" in said[0]


def test_two_drivers_at_once_make_one_database(tmp_path):
    """Whose interpreters have nothing in common; eight that are forks of one are in tests/torture."""
    script = """
import sys
from pathlib import Path
from pipeline.tracking.mirror import Run, Tracker
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


def test_the_ui_serves_on_loopback_and_stops_with_its_children(store, said):
    Tracker(store, say=said.append).mirror(STUDY, STAGE)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    script = "import sys; from pathlib import Path; from pipeline.tracking.mirror import serve_ui; "
    script += "serve_ui(Path(sys.argv[1]), int(sys.argv[2]))"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    server = subprocess.Popen(
        [sys.executable, "-c", script, str(store), str(port)],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    family = [psutil.Process(server.pid)]
    try:
        deadline = time.monotonic() + 60
        while True:
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/health", timeout=5) as answer:
                    assert answer.status == 200
                break
            except OSError:
                assert server.poll() is None and time.monotonic() < deadline
                time.sleep(0.2)
        family += family[0].children(recursive=True)
        listening = [one.laddr for child in family for one in child.net_connections() if one.status == "LISTEN"]
        assert {address.ip for address in listening} == {"127.0.0.1"}
        server.send_signal(signal.SIGTERM)
        server.wait(timeout=15)
        _, left = psutil.wait_procs(family[1:], timeout=10)
        assert not left
    finally:
        for child in family:
            if child.is_running():
                child.kill()
        server.wait()


def test_the_ui_says_what_it_lacks(tmp_path):
    with pytest.raises(PuddleError, match=r"expected mlflow\.db"):
        serve_ui(tmp_path, 5000)
    (tmp_path / "mlflow.db").touch()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(PuddleError, match=r"port \d+ is not available.*--port"):
            serve_ui(tmp_path, taken.getsockname()[1])
