"""The mirror in a real MLflow database: complete, never double, and never in the study's way."""

import base64
import contextlib
import http.server
import math
import shutil
import socket
import sqlite3
import ssl
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from database_template import make_database, own_databases
from mlflow.tracking import MlflowClient

from pipeline.errors import PuddleError, without_password
from pipeline.mlflow.database import EXPERIMENT, check_reachable, database_uri, explained
from pipeline.mlflow.mirror import Tracker
from pipeline.mlflow.run import CurvePart, CurvePoints, Run
from pipeline.mlflow.server import show_ui
from pipeline.workflow.study_mirror import _thinned

pytestmark = pytest.mark.slow

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
    """Return part of a run's curves, as a segment adds it, from step ``first`` on."""
    n_points = len(next(iter(curves.values())))
    points = CurvePoints(range(first, first + n_points), curves)
    return CurvePart(digest, lambda: points)


def parts(k: int) -> list[CurvePart]:
    bounds = [(0, 700), (700, 1500)]
    return [part(f"{k}-{a}", a, fitness=CURVE[a:b] + k, deviation=CURVE[a:b]) for a, b in bounds]


TRIALS = [Run(f"trial {k}", str(k), params={"trial": k}, curves=parts(k), status="FINISHED") for k in range(2)]


@pytest.fixture(autouse=True)
def only_our_server(monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)


def quiet(store: Path) -> Tracker:
    """Return a tracker that has no reason to warn of anything."""
    return Tracker(store, say=pytest.fail)


@pytest.fixture
def store(tmp_path) -> Path:
    return tmp_path


def client(store: Path) -> MlflowClient:
    return MlflowClient(database_uri(store))


def runs(store: Path):
    mlflow = client(store)
    found = mlflow.search_runs([mlflow.get_experiment_by_name(EXPERIMENT).experiment_id])
    return {(run.data.tags["puddle.kind"], run.info.run_name): run for run in found}


def everything(store: Path):
    """All that MLflow holds, except files."""
    history, held = client(store).get_metric_history, {}
    for slot, run in runs(store).items():
        points = {name: list(map(dict, history(run.info.run_id, name))) for name in run.data.metrics}
        held[slot] = dict(run.info), run.data.to_dictionary(), points
    return held


def curve(store: Path, trial: str, name: str = "fitness") -> dict[int, float]:
    """Return the value of every step of a trial's curve."""
    history = client(store).get_metric_history(runs(store)["trial", trial].info.run_id, name)
    steps = {point.step: point.value for point in history}
    assert len(steps) == len(history)
    return steps


def test_a_study_its_stage_and_its_trials(tmp_path):
    with own_databases():
        quiet(tmp_path).mirror(STUDY, STAGE, TRIALS)
    found = runs(tmp_path)
    study, stage, trial = found["study", "smoke"], found["stage", "evolve"], found["trial", "trial 1"]
    assert len(found) == 4
    assert stage.data.tags["mlflow.parentRunId"] == study.info.run_id
    assert trial.data.tags["mlflow.parentRunId"] == stage.info.run_id
    assert (study.info.status, stage.info.status, trial.info.status) == ("RUNNING", "FINISHED", "FINISHED")
    assert study.data.params == {"evolution.n_generations": "1500"} and study.data.tags["preset"] == "smoke"
    assert (stage.data.tags["study"], stage.data.tags["study_digest"]) == ("smoke", STUDY.key)
    assert curve(tmp_path, "trial 1") == dict(enumerate(CURVE + 1))
    artifacts = tmp_path / "mlartifacts" / stage.info.run_id / "artifacts"
    assert (artifacts / "figures" / "fitness.svg").read_bytes() == b"<svg/>"


@pytest.mark.parametrize("name", ["a#b größe", "50%20 %3F", "what?", "x@y:z"])
def test_a_store_of_an_odd_name_keeps_its_mirror_inside(name, tmp_path):
    store = tmp_path / name
    store.mkdir()
    quiet(store).mirror(STUDY, STAGE)
    found = runs(store)
    assert set(found) == {("study", "smoke"), ("stage", "evolve")}
    artifacts = store / "mlartifacts" / found["stage", "evolve"].info.run_id / "artifacts"
    assert (store / "mlflow.db").is_file() and (artifacts / "figures" / "fitness.svg").is_file()
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_relative_database_is_that_of_the_folder_in_which_the_study_began(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tracker = Tracker(tmp_path, "sqlite:///runs.db", say=pytest.fail)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    tracker.mirror(STUDY, STAGE)
    assert (tmp_path / "runs.db").is_file() and not list((tmp_path / "elsewhere").glob("*.db"))


def test_mirrored_twice_is_mirrored_once(store):
    quiet(store).mirror(STUDY, STAGE, TRIALS)
    once = everything(store)
    tracker = quiet(store)
    for _ in range(2):
        tracker.mirror(STUDY, STAGE, TRIALS)
    assert everything(store) == once


def test_what_changed_is_brought_up_to_date_in_place(store):
    tracker = quiet(store)
    half = [replace(trial, curves=trial.curves[:1], status=None) for trial in TRIALS]
    tracker.mirror(STUDY, replace(STAGE, metrics={"best": 3.0}, status="FAILED"), half)
    before = runs(store)
    tracker.mirror(replace(STUDY, status="FINISHED"), STAGE, TRIALS)
    after = runs(store)
    assert {slot: run.info.run_id for slot, run in before.items()} == {s: run.info.run_id for s, run in after.items()}
    assert before["stage", "evolve"].info.status == "FAILED"
    assert {run.info.status for run in after.values()} == {"FINISHED"}
    assert after["stage", "evolve"].data.metrics == {"best": 9.5}  # what is not finite is not sent
    assert sorted(curve(store, "trial 0")) == list(range(1500))


def test_a_trial_that_is_tried_again_has_not_failed(store):
    tracker, trial = quiet(store), TRIALS[0]
    for status, tags in (("FAILED", {"failure": "its worker died"}), ("FINISHED", {})):
        tracker.mirror(STUDY, STAGE, [replace(trial, status=status, tags=tags)])
        run = runs(store)["trial", trial.name]
        assert (run.info.status, run.data.tags.get("failure")) == (status, tags.get("failure"))


def test_only_finite_values_are_sent(store):
    curves = {"fitness": [1.0, math.nan, -math.inf, 4.0], "nothing": [math.nan] * 4}
    quiet(store).mirror(STUDY, STAGE, [Run("trial 0", "0", curves=[part("a", 0, **curves)])])
    assert curve(store, "trial 0") == {0: 1.0, 3: 4.0}
    assert "nothing" not in runs(store)["trial", "trial 0"].data.metrics


def test_an_interrupted_mirror_is_completed_without_doubles(store):
    """A death between two batches of one curve leaves half of it; the next driver sends the rest."""
    tracker, n_batches = quiet(store), iter(range(3))
    tracker.mirror(STUDY, STAGE)

    class DyingClient(MlflowClient):
        def log_batch(self, *args, **kwargs):
            if next(n_batches) == 2:
                raise KeyboardInterrupt
            return super().log_batch(*args, **kwargs)

    tracker._client = DyingClient(database_uri(store))
    with pytest.raises(KeyboardInterrupt):
        tracker.mirror(STUDY, STAGE, TRIALS)
    assert 0 < len(curve(store, "trial 0")) <= 1500 and runs(store)["trial", "trial 0"].info.status == "RUNNING"
    quiet(store).mirror(STUDY, STAGE, TRIALS)
    for trial in ("trial 0", "trial 1"):
        assert len(curve(store, trial)) == len(curve(store, trial, "deviation")) == 1500


def test_a_failing_mlflow_is_said_once_and_used_once_it_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # of a database that is not the store's, MLflow keeps the artifacts here
    folder, said = tmp_path / "elsewhere", []
    folder.touch()  # a file where a folder is needed
    tracker = Tracker(tmp_path, f"sqlite:///{folder}/mlflow.db", say=said.append)
    tracker.mirror(STUDY, replace(STAGE, name="collect", key="c"))
    tracker.mirror(STUDY, STAGE, TRIALS)
    folder.unlink()
    folder.mkdir()
    tracker.mirror(STUDY, replace(STAGE, name="transfer", key="t"))
    assert len(said) == 1 and str(folder) in said[0] and "The study continues" in said[0]
    assert {name for _, name in runs(folder)} == {"smoke", "transfer"}


@pytest.mark.parametrize("listening", [False, True])
def test_an_unreachable_server_is_noticed_within_seconds_and_once(tmp_path, monkeypatch, listening):
    """Nothing listens on the port, or a server that never answers."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        if listening:
            server.listen()
        address, said = f"127.0.0.1:{server.getsockname()[1]}", []
        monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://{address}")
        tracker = Tracker(tmp_path, say=said.append)
        for _ in range(2):
            begin = time.monotonic()
            tracker.mirror(STUDY, STAGE, TRIALS)
            assert time.monotonic() - begin < 5  # MLflow itself takes minutes
    assert len(said) == 1 and address in said[0] and "does not answer" in said[0]
    assert not (tmp_path / "mlflow.db").exists()


def test_a_database_that_cannot_be_opened_is_noticed_within_seconds(tmp_path):
    said: list[str] = []
    begin = time.monotonic()
    Tracker(tmp_path, f"sqlite:///{tmp_path}", say=said.append).mirror(STUDY, STAGE)  # a folder
    assert time.monotonic() - begin < 20  # MLflow itself tries for 100
    assert len(said) == 1 and "unable to open database file" in said[0]


@pytest.mark.parametrize("n", [1, 100, 101, 250])
def test_a_thinned_curve_ends_where_the_whole_one_does(n):
    points = _thinned(lambda: CurvePoints(range(n), {"fitness": [float(k) for k in range(n)]}), 100)
    assert points.steps[-1] == points.values["fitness"][-1] == n - 1 and len(points.steps) <= 100


def test_only_the_new_parts_of_a_growing_curve_are_read(store):
    def refuse() -> CurvePoints:
        raise AssertionError("read again")

    trial, tracker = TRIALS[0], quiet(store)
    first, second = trial.curves
    tracker.mirror(STUDY, STAGE, [replace(trial, curves=[first])])
    tracker.mirror(STUDY, STAGE, [replace(trial, curves=[replace(first, read=refuse), second])])
    both = replace(trial, curves=[replace(first, read=refuse), replace(second, read=refuse)])
    quiet(store).mirror(STUDY, STAGE, [both])  # another driver knows from MLflow what was sent
    assert curve(store, "trial 0") == dict(enumerate(CURVE))


def test_files_are_added_to_a_run_and_sent_once(store, monkeypatch):
    film = Run("trial 0", "0", artifacts={"films/swim.mp4": b"film"})
    for _ in range(2):
        tracker = quiet(store)
        tracker.mirror(STUDY, STAGE, [replace(TRIALS[0], artifacts={"champion.json": b"{}"})])
        tracker.mirror(STUDY, STAGE, [film])
        monkeypatch.setattr(MlflowClient, "log_artifacts", lambda *_: pytest.fail("sent again"))
    trial = store / "mlartifacts" / runs(store)["trial", "trial 0"].info.run_id / "artifacts"
    assert (trial / "films/swim.mp4").read_bytes() == b"film" and (trial / "champion.json").read_bytes() == b"{}"


def test_a_deleted_experiment_is_restored(store):
    quiet(store).mirror(STUDY, STAGE)
    mlflow = client(store)
    mlflow.delete_experiment(mlflow.get_experiment_by_name(EXPERIMENT).experiment_id)
    quiet(store).mirror(STUDY, STAGE, TRIALS)
    assert len(runs(store)) == 4


def test_the_artifacts_of_a_moved_store_move_with_it(store, tmp_path_factory):
    quiet(store).mirror(STUDY, STAGE)
    moved = tmp_path_factory.mktemp("moved") / "store"
    shutil.move(store, moved)
    quiet(moved).mirror(STUDY, STAGE, [replace(TRIALS[0], artifacts={"champion.json": b"{}"})])
    found = {name: run.info.run_id for (_, name), run in runs(moved).items()}
    assert (moved / "mlartifacts" / found["trial 0"] / "artifacts" / "champion.json").read_bytes() == b"{}"
    assert [one.path for one in client(moved).list_artifacts(found["evolve"])] == ["figures"]
    assert not store.exists()


def test_a_folder_of_files_in_the_environment_is_one_sentence_with_what_to_do(store, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", str(store / "mlruns"))
    said: list[str] = []
    Tracker(store, say=said.append).mirror(STUDY, STAGE)
    assert said[0].startswith(str(store / "mlruns")) and "; unset MLFLOW_TRACKING_URI, and" in said[0]


@pytest.fixture(scope="module")
def sound_database(tmp_path_factory) -> Path:
    return make_database(tmp_path_factory.mktemp("sound"))


def of_version(database: Path, version: str) -> None:
    with contextlib.closing(sqlite3.connect(database)) as connection:
        connection.execute("UPDATE alembic_version SET version_num = ?", (version,))
        connection.commit()


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda database: of_version(database, "451aebb31d03"), "it was made by another version of MLflow"),
        (lambda database: of_version(database, "of a newer one"), "it was made by another version of MLflow"),
        (lambda database: database.write_bytes(b"no database at all" * 100), "not a database"),
    ],
)
def test_a_database_that_mlflow_cannot_use_is_one_sentence(store, sound_database, spoil, reason):
    shutil.copy(sound_database, store)  # MLflow looks at the version once for each path
    spoil(store / "mlflow.db")
    said: list[str] = []
    tracker = Tracker(store, say=said.append)
    tracker.mirror(STUDY, STAGE)
    tracker.mirror(STUDY, STAGE, TRIALS)
    with pytest.raises(PuddleError) as refused:
        show_ui(store, 5000)
    assert len(said) == 1
    for told in (*said, str(refused.value)):
        assert told.startswith(f"{store / 'mlflow.db'}: ") and reason in told and len(told.splitlines()) == 1


@pytest.fixture
def secure_server(tmp_path) -> Iterator[tuple[str, Path, list[str | None]]]:
    """A server with a certificate that it signed itself: its host, the certificate, and the passwords it was given."""
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    made = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost"]
    made += ["-addext", "subjectAltName=DNS:localhost", "-keyout", str(key), "-out", str(certificate)]
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate")
    subprocess.run(made, check=True, capture_output=True)
    passwords: list[str | None] = []

    class Server(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            passwords.append(self.headers["Authorization"])
            self.send_response(200 if self.path == "/health" else 403)
            self.end_headers()

        def log_message(self, *arguments: object) -> None: ...

    with http.server.HTTPServer(("127.0.0.1", 0), Server) as server:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate, key)
        server.socket = context.wrap_socket(server.socket, server_side=True)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"localhost:{server.server_port}", certificate, passwords
        server.shutdown()


def test_a_server_is_asked_as_mlflow_asks_and_no_password_is_shown(secure_server, store, monkeypatch):
    host, certificate, passwords = secure_server
    uri, said = f"https://mary:se:cr@t@{host}", list[str]()
    with pytest.raises(PuddleError, match=f"^https://{host} does not answer .*self-signed certificate"):
        check_reachable(uri)
    monkeypatch.setenv("MLFLOW_TRACKING_SERVER_CERT_PATH", str(certificate))
    check_reachable(uri.replace("cr@t", "cr%40t"))
    assert passwords == [f"Basic {base64.b64encode(b'mary:se:cr@t').decode()}"]
    Tracker(store, uri.replace("cr@t", "cr%40t"), say=said.append).mirror(STUDY, STAGE)
    assert len(said) == 1 and f"https://{host}: MLflow cannot use it" in said[0] and "403" in said[0]
    assert "se:cr" not in said[0] and "mary" not in said[0]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("postgresql://ann:secret@host/runs", "postgresql://host/runs"),
        ("puddle ui --tracking-uri=http://ann:a/b@host:5000", "puddle ui --tracking-uri=http://host:5000"),
        ("sqlite:////home/a@b/runs.db", "sqlite:////home/a@b/runs.db"),
    ],
)
def test_no_password_of_a_uri_is_shown(text, shown):
    assert without_password(text) == shown


@pytest.mark.parametrize(
    "error",
    [
        RuntimeError("Could not determine home directory."),
        ImportError("libarrow.so: failed to map segment from shared object"),
        MemoryError(),
        sqlite3.OperationalError("attempt to write a readonly database"),
    ],
)
def test_a_sound_database_is_not_to_be_deleted(error, store):
    said = explained(error, store, None)
    assert str(error).rstrip(".") in said and "delete" not in said and len(said.splitlines()) == 1
