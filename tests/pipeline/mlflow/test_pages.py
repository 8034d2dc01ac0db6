"""MLflow's runs while a study runs, and its pages in a real browser."""

import contextlib
import itertools
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from browser import Browser
from database_template import own_databases
from mlflow.tracking import MlflowClient
from small_study import ON_DRY_LAND, Terminal

from pipeline.cluster import Cluster, serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.mlflow.database import database_uri
from pipeline.mlflow.mirror import Tracker
from pipeline.mlflow.run import Run
from pipeline.mlflow.server import show_ui
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow import study_mirror
from pipeline.workflow.driver import drive

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def only_our_server(monkeypatch) -> Iterator[None]:
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    with own_databases():  # the tests ask for the runs while it is made
        yield


def wait_for(condition, what: str, seconds: float = 120.0):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, what
        time.sleep(0.1)
    return found


def trials(store: Store) -> list:
    mlflow = MlflowClient(database_uri(store.root))
    found = mlflow.get_experiment_by_name("puddle")
    return found and mlflow.search_runs([found.experiment_id], "tags.`puddle.kind` = 'trial'")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def answers(address: str) -> bool:
    with contextlib.suppress(OSError):
        return urllib.request.urlopen(address, timeout=1).status == 200
    return False


@contextlib.contextmanager
def pages(store: Path) -> Iterator[tuple[subprocess.Popen, str]]:
    """Run `puddle ui`; yield its process and the address that it prints of the server, which is up."""
    command = [sys.executable, "-m", "pipeline", "ui", "--store", str(store), "--port", str(free_port())]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    server = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, start_new_session=True
    )
    try:
        assert server.stdout is not None
        address = next(line for line in server.stdout if line.startswith("MLflow: ")).split()[1]
        wait_for(lambda: answers(f"{address.partition('#')[0]}health"), "the server never answered")
        yield server, address
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(server.pid, signal.SIGKILL)
        server.wait()


def test_a_live_trial_grows_segment_by_segment(store: Store, monkeypatch):
    """The cluster holds the second segment of the only trial back until MLflow has the first."""
    monkeypatch.setattr(study_mirror, "SECONDS_BETWEEN_UPDATES", 0.2)
    terminal, n_asked = Terminal(), itertools.count()

    def n_points() -> int:
        mlflow = MlflowClient(database_uri(store.root))
        return sum(len(mlflow.get_metric_history(one.info.run_id, "best_fitness")) for one in trials(store) or ())

    @contextlib.contextmanager
    def waiting_cluster() -> Iterator[Cluster]:
        with serial_cluster() as cluster:
            next_done = cluster.next_done

            def next_when_mirrored(timeout: float | None = None):
                if next(n_asked) == 1:
                    wait_for(lambda: n_points() == 2, "MLflow never had the first segment")
                    assert trials(store)[0].info.status == "RUNNING"
                return next_done(timeout)

            cluster.next_done = next_when_mirrored
            yield cluster

    drive(
        parse(Settings, ON_DRY_LAND, name="tiny"),
        STAGES[:3],
        stages=STAGES,
        store=store,
        open_cluster=waiting_cluster,
        tracker=Tracker(store.root, say=terminal.say),
        progress=terminal,
    )
    assert trials(store)[0].info.status == "FINISHED" and n_points() == 4
    assert not any("MLflow" in line for line in terminal.said)


def test_the_list_of_studies_has_presets_and_headline_figures(store: Store, browser: Browser):
    tracker = Tracker(store.root, say=pytest.fail)
    for name in ("first", "second"):
        headline = {"share.dry_land": 0.26, "m.residual_slush": 6.4, "accuracy.slope.mean": 0.5}
        study = Run(name, name, tags={"preset": "smoke"}, metrics=headline, status="FINISHED")
        tracker.mirror(study, Run("evolve", "evolve", status="FINISHED"))
    with pages(store.root) as (server, address):
        browser.visit(address, width=1600)
        for words in ("first", "second", "smoke", "share.dry_land", "0.26", "m.residual_slush"):
            browser.until(f"document.body.innerText.includes({words!r})")
        text = browser.evaluate("document.body.innerText")
        assert "evolve" not in text and "accuracy.slope" not in text
        own = psutil.Process(server.pid)
        family = own.children(recursive=True)
        listening = [c.laddr for one in (own, *family) for c in one.net_connections() if c.status == "LISTEN"]
        assert {address.ip for address in listening} == {"127.0.0.1"}
        server.send_signal(signal.SIGTERM)
        server.wait(timeout=15)
        assert not psutil.wait_procs(family, timeout=10)[1]


def test_the_ui_says_what_it_lacks(tmp_path):
    with pytest.raises(PuddleError, match=r"expected mlflow\.db"):
        show_ui(tmp_path, 5000)
    uri = f"http://127.0.0.1:{free_port()}"
    with pytest.raises(PuddleError, match=f"{uri} does not answer"):
        show_ui(tmp_path, 5000, uri=uri)
    (tmp_path / "mlflow.db").touch()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(PuddleError, match=r"port \d+ is not available.*--port"):
            show_ui(tmp_path, taken.getsockname()[1])
