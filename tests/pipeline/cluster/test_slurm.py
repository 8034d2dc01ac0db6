"""docker/slurm.sbatch, run on this machine: real Ray, and stand-ins for Slurm's programs."""

import contextlib
import os
import re
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from containers import DOCKER, SMALL_MEMORY
from marked_processes import Marked, started
from small_study import ON_DRY_LAND

from pipeline.store.store import Store

ROOT = Path(__file__).parents[3]
SCRIPT = DOCKER / "slurm.sbatch"
HERE = socket.gethostbyname(socket.gethostname())

SRUN = f"""#!{sys.executable}
import os, pathlib, signal, subprocess, sys
options, words = [], sys.argv[1:]
while words[0].startswith("--"):
    options.append(words.pop(0))
with open("srun.log", "a") as log:
    print(*options, file=log)
(n_nodes,) = (int(option.partition("=")[2]) for option in options if option.startswith("--nodes="))
environment = dict(os.environ, SLURM_CPUS_ON_NODE="1")
tasks = [subprocess.Popen(words, env=environment, start_new_session=True) for _ in range(n_nodes)]
def forward(number, frame):
    for task in tasks:
        os.killpg(task.pid, number)
signal.signal(signal.SIGTERM, forward)
sys.exit(max(task.wait() for task in tasks))
"""
"""Runs a command as often as there are nodes, here, and forwards signals to it, as srun does."""

SCONTROL = """#!/bin/sh
test "$1 $2 $3" = "show hostnames node[1-2]" && printf '%s\\n' FIRST other
"""

RAY = """#!/bin/sh
test "$1" = health-check && { grep -q -e --head ray.log; exit; }
test -e broken && exit 1
echo "$RAY_AUTH_TOKEN" >> tokens.log
echo "$@" >> ray.log
trap 'echo ended >> ray.log; exit 0' TERM
while :; do sleep 0.05; done
"""

PUDDLE = """#!/bin/sh
until test "$(grep -c -e --block ray.log)" = "$SLURM_JOB_NUM_NODES"; do sleep 0.05; done
echo "$@" >> puddle.log
trap 'echo stopped >> puddle.log; exit 143' TERM
case "$*" in *waits*) while :; do sleep 0.05; done;; esac
exit 1
"""


@pytest.fixture
def place(tmp_path) -> Path:
    """A folder with stand-ins for Slurm's programs."""
    (tmp_path / "bin").mkdir()
    write(tmp_path, srun=SRUN, scontrol=SCONTROL.replace("FIRST", HERE))
    return tmp_path


def write(place: Path, **programs: str) -> None:
    for name, text in programs.items():
        (place / "bin" / name).write_text(text)
        (place / "bin" / name).chmod(0o755)


@contextlib.contextmanager
def submitted(place: Path, *words: str, number: int, script: Path = SCRIPT, n_nodes: int = 2) -> Iterator[Marked]:
    """Run the script as Slurm would; kill what is left of it at the end."""
    ours = {name: value for name, value in os.environ.items() if not name.startswith(("RAY_", "PUDDLE_", "MLFLOW_"))}
    ours |= {
        "PATH": os.pathsep.join([str(place / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]]),
        "PYTHONPATH": str(ROOT),
        "MLFLOW_TRACKING_URI": "http://127.0.0.1:1",  # no server: a study without MLflow takes four core-seconds less
        "SLURM_SUBMIT_DIR": str(place),
        "SLURM_JOB_ID": str(number),
        "SLURM_JOB_NODELIST": "node[1-2]",
        "SLURM_JOB_NUM_NODES": str(n_nodes),
    }
    with started(["bash", script, *words], place / "job.log", ours) as job:
        yield job


@pytest.mark.timeout(600)
def test_a_job_runs_a_study_on_its_nodes_and_leaves_nothing(torture, place):
    """The one test with real Ray: it takes as long as two Ray nodes and a driver need to start, half a minute.

    The study ends with evolution: that the script runs a whole one is seen with the stand-in for `puddle` below.
    """
    if not torture.large:
        pytest.skip("only with --torture: two nodes and a driver start")
    write(place, puddle=f'#!/bin/sh\nexec {sys.executable} -m pipeline "$@"\n')  # this checkout's
    (place / "tiny.yaml").write_text(ON_DRY_LAND)
    ((option, small),) = SMALL_MEMORY.items()
    number = int.from_bytes(os.urandom(3))
    script = place / "slurm.sbatch"
    script.write_text(SCRIPT.read_text().replace(option, small).replace("puddle study", "puddle evolve"))
    assert small in script.read_text() and "puddle evolve" in script.read_text()
    with submitted(place, "--settings", "tiny.yaml", "--store", "store", number=number, script=script) as job:
        job.wait_for(job.ended, 500)
        assert job.process.returncode == 0, job.said()
        assert job.said().count("Ray runtime started") == 2, job.said()
    assert not Path(f"/tmp/puddle-{number}").exists()
    first, other = (place / "srun.log").read_text().splitlines()
    assert "--nodes=1 " in first and "--nodelist=" in first and "--nodes=1 " in other and "--exclude=" in other
    store = Store.open(place / "store", create=False)
    assert any(stage == "evolve" for stage, _ in store.items())


@pytest.mark.parametrize("n_nodes", [1, 2])
def test_the_exit_code_is_that_of_the_study_and_the_steps_end(n_nodes, place):
    write(place, ray=RAY, puddle=PUDDLE)
    with submitted(place, "--preset", "paper", number=7, n_nodes=n_nodes) as job:
        job.wait_for(job.ended)
        assert job.process.returncode == 1, job.said()
    assert (place / "puddle.log").read_text() == f"study --preset paper --address {HERE}:20007\n"
    assert len((place / "srun.log").read_text().splitlines()) == n_nodes
    lines = (place / "ray.log").read_text().splitlines()
    assert sorted(lines)[:n_nodes] == ["ended"] * n_nodes and len(lines) == 2 * n_nodes
    assert any("--head --port=20007" in line for line in lines)
    assert any(f"--address={HERE}:20007" in line for line in lines) == (n_nodes == 2)
    (token,) = set((place / "tokens.log").read_text().split())  # of this job alone
    assert re.fullmatch("[0-9a-f]{64}", token) and token not in job.said()
    assert all("--temp-dir=/tmp/puddle-7 --num-cpus=1" in line for line in lines if line != "ended")


def test_the_signal_before_the_time_limit_stops_the_driver_first(place):
    write(place, ray=RAY, puddle=PUDDLE)
    with submitted(place, "waits", number=9) as job:
        job.wait_for((place / "puddle.log").exists)
        job.process.send_signal(signal.SIGTERM)
        job.wait_for(job.ended)
        assert job.process.returncode == 143
    assert (place / "puddle.log").read_text().endswith("stopped\n")
    assert (place / "ray.log").read_text().endswith("ended\nended\n")


def test_a_head_that_does_not_start_ends_the_job_with_a_message(place):
    write(place, ray=RAY, puddle=PUDDLE)
    (place / "broken").touch()
    with submitted(place, number=10) as job:
        job.wait_for(job.ended)
        assert job.process.returncode == 2
    assert "Ray's head did not start on" in job.said()
    assert not (place / "puddle.log").exists()
