"""A study on a cluster that loses a machine half-way and gains another: the same bytes.

The machines are Ray nodes on this one, each with its own folders. They and the driver, `puddle study --address`, run
the commands of docker/compose.yaml, with this machine's names and ports. This takes minutes, and is part of `make
torture` alone; in each `make test`, tests/pipeline/cluster/test_cluster.py loses a machine during calls.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import socket
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from containers import SMALL_MEMORY, environment_of, words_of
from marked_processes import Marked, started
from small_study import digests, run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow.graph import survey

ROOT = Path(__file__).parents[2]

STUDY = """
name: two-machines
throws: {n_throws: 4, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 10, batch_size: 16}
ensemble: {n_members: 1}
grid: {depths: [1.0], environments: [dry_land], single_member_depths: [1.0], n_trials: 2}
rollout: {n_settle: 5, n_measure: 300}
evolution: {n_generations: 480, afpo: {population_size: 8}}
transfer: {n_generations: 2, adapted_environments: [dry_land]}
assess: {n_designs: 8}
work: {throws_per_item: 2, generations_per_item: 10, engine: reference}
"""
"""A study of every stage; a work item of evolution takes about a core-second."""

LOST, ADDED = "127.0.0.2", "127.0.0.3"  # addresses of the machine that is killed, and of the one that is added


@pytest.mark.timeout(1200)  # every wait has its own limit
def test_a_cluster_loses_a_machine_half_way_and_gains_another(torture, short_folder, tmp_path):
    if not torture.large:
        pytest.skip("only with --torture: it takes minutes")
    settings = parse(Settings, STUDY, name="two")
    with serial_cluster() as serial:
        expected = digests(run(settings, Store.open(tmp_path / "expected", create=True), serial, STAGES[:-1]))
    n_items = sum(len(items) for chain, items in expected.items() if chain.startswith("evolve/"))
    for number, rng in enumerate(torture.attempts(1, 5)):
        half_way = int(rng.uniform(0.2, 0.3) * n_items)
        folder = short_folder / str(number)
        folder.mkdir()
        (folder / "two.yaml").write_text(STUDY)
        on_machines_that_change(folder, half_way)
        found = digests(survey(settings, STAGES, Store.open(folder / "store", create=False)).upstream)
        assert {chain: items for chain, items in found.items() if not chain.startswith("report/")} == expected
        assert len(found) > len(expected)  # the report contains the time, and so differs


def on_machines_that_change(folder: Path, half_way: int) -> None:
    """Run the study on two machines; kill one half-way, and start another.

    Args:
        folder: receives the store and the logs.
        half_way: number of committed work items of evolution after which a machine is killed.
    """
    (folder / "token").write_text(secrets.token_hex(32))
    (folder / "token").chmod(0o600)
    here, port = socket.gethostbyname(socket.gethostname()), free_port()
    address = f"{here}:{port}"
    tools = ("RAY_", "PUDDLE_", "MLFLOW_")
    without_token = {name: value for name, value in os.environ.items() if not name.startswith(tools)}
    without_token |= {"PYTHONPATH": str(ROOT), "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    token = {"RAY_AUTH_TOKEN_PATH": str(folder / "token")}
    head = words_of("head", {"--port=6379": f"--port={port}", **SMALL_MEMORY})
    worker = words_of("worker", {"head:6379": address, **SMALL_MEMORY})
    of_nodes = {**without_token, **environment_of("worker", token)}

    def enough() -> bool:
        n_committed = len(list((folder / "store").glob("items/evolve/*/*/manifest.json")))
        return n_committed >= half_way and evolves(second.process)

    with contextlib.ExitStack() as stack:

        def start(name: str, words: list[str], environment: dict[str, str]) -> Marked:
            return stack.enter_context(started(words, folder / f"{name}.log", environment, cwd=folder))

        def machine(name: str, ip: str, words: list[str]) -> Marked:
            own = [f"--temp-dir={folder / name}", f"--node-ip-address={ip}", "--num-cpus=1"]
            return start(name, [*words, *own], of_nodes)

        first = machine("a", here, head)
        first.wait_for(lambda: answers(here, port))
        # Each has its own address, as machines do: the driver connects to the node beside it.
        second = machine("b", LOST, worker)
        second.wait_for(lambda: "Ray runtime started" in second.said())
        beside = f"ray start --temp-dir={folder / 'd'} --node-ip-address=127.0.0.4"
        own_settings = {'--preset "${PRESET}"': f"--settings {folder / 'two.yaml'}"}
        study = words_of("driver", {"ray start": beside, "head:6379": address, **own_settings, **SMALL_MEMORY})
        of_driver = environment_of("driver", {**token, "PUDDLE_STORE": str(folder / "store"), "PRESET": "smoke"})
        del of_driver["MLFLOW_TRACKING_URI"]  # tests/pipeline/mlflow/test_server.py tests the server
        driver = start("driver", study, {**without_token, **of_driver})
        driver.wait_for(enough, 480)
        os.killpg(second.process.pid, signal.SIGKILL)
        machine("c", ADDED, worker)
        assert driver.process.wait(480) == 0, driver.said()


def evolves(machine: subprocess.Popen) -> bool:
    """Return whether a machine computes a work item of evolution; its own report of it may be lost with it."""
    with contextlib.suppress(psutil.Error):
        processes = psutil.Process(machine.pid).children(recursive=True)
        return any(process.name().startswith("ray::evolve") for process in processes)
    return False


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def answers(host: str, port: int) -> bool:
    with contextlib.suppress(OSError):
        socket.create_connection((host, port), 1).close()
        return True
    return False
