"""MLflow on a server of its own, started as docker/compose.yaml starts it, with SQLite in PostgreSQL's place."""

import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
import yaml
from command_line import call
from small_study import ON_DRY_LAND

from pipeline.store.store import Store

pytestmark = pytest.mark.slow

COMPOSE = Path(__file__).parents[3] / "docker" / "compose.yaml"


def answer(port: int, host: str) -> int:
    request = urllib.request.Request(f"http://127.0.0.1:{port}/api/2.0/mlflow/experiments/search?max_results=1")
    request.add_header("Host", host)
    try:
        return urllib.request.urlopen(request, timeout=5).status
    except urllib.error.HTTPError as error:
        return error.code
    except OSError:
        return 0


@pytest.fixture
def server(tmp_path):
    """A server with the options of the compose file; its port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    service = yaml.safe_load(COMPOSE.read_text())["services"]["mlflow"]
    line = re.sub(r'"(postgresql.*?)"', f"sqlite:///{tmp_path}/server.db", service["command"][2].removeprefix("exec "))
    line = line.replace("0.0.0.0", "127.0.0.1").replace("/artifacts", f"{tmp_path}/artifacts")
    line = re.sub(r"(--port |127\.0\.0\.1:)5000", rf"\g<1>{port}", line)
    log = (tmp_path / "server.log").open("w")
    process = subprocess.Popen(
        [sys.executable, "-m", *shlex.split(line)],
        env=os.environ | service["environment"],
        stdout=log,
        stderr=log,
        start_new_session=True,
    )
    try:
        end = time.monotonic() + 120
        while answer(port, f"127.0.0.1:{port}") != 200:
            assert process.poll() is None and time.monotonic() < end, (tmp_path / "server.log").read_text()
            time.sleep(0.2)
        yield port
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(30)


def test_a_study_on_a_server_is_found_there(server, tmp_path, monkeypatch, capsys):
    """By MLflow's own variable, as in the containers; whoever asks by another name is refused."""
    from mlflow.tracking import MlflowClient

    assert answer(server, "mlflow:5000") == 200  # what the driver's container calls it
    assert answer(server, "elsewhere.example") == 403
    (tmp_path / "tiny.yaml").write_text(ON_DRY_LAND)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://127.0.0.1:{server}")
    options = ["--settings", str(tmp_path / "tiny.yaml"), "--store", str(tmp_path / "store"), "--workers", "0"]
    assert call("evolve", *options) == 0
    assert "MLflow" not in capsys.readouterr().err
    client = MlflowClient(f"http://127.0.0.1:{server}")
    experiment = client.get_experiment_by_name("puddle")
    runs = client.search_runs([experiment.experiment_id])
    assert {run.info.run_name for run in runs} == {"tiny", "evolve", "dry_land/1m/trial-0"}
    (trial,) = (run for run in runs if run.data.tags["puddle.kind"] == "trial")
    assert "champion.json" in [file.path for file in client.list_artifacts(trial.info.run_id)]
    assert not (Store.open(tmp_path / "store", create=False).root / "mlflow.db").exists()
