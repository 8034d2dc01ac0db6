"""A study on a cluster that loses a machine half-way and gains another: the same bytes, and every core kept busy.

The machines are Ray nodes on this one, each started as on a real cluster, with folders of its own. Busy means that a
task of ours was assigned: the tasks write down themselves when they began and ended, and where.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.cluster import serial_cluster
from pipeline.configuration import parse
from pipeline.settings import Settings
from pipeline.stages import STAGES
from pipeline.store import Store
from pipeline.study import follow, results_of, run_stage

ROOT = Path(__file__).parents[2]

EVOLUTION = """
name: two-machines
grid: {depths: [1.0], environments: [dry_land], single_member_depths: [], n_trials: 4}
rollout: {n_settle: 5, n_measure: 300}
evolution: {n_generations: 60, afpo: {population_size: 8}}
work: {generations_per_item: 20, engine: reference}
"""
"""A dozen pieces of about a core-second."""

DRIVER = """
import dataclasses, json, sys, time
import ray
from pipeline.cluster import ray_cluster
from pipeline.configuration import parse
from pipeline.settings import Settings
from pipeline.stages import STAGES
from pipeline.store import Store
from pipeline.study import follow, results_of, run_stage

text, overrides, address, store, log = json.loads(sys.argv[1])
ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])

def noted(compute):
    def note(job, inputs):
        begin = time.time()
        files = compute(job, inputs)
        with open(log, "a") as file:
            print(ray.get_runtime_context().get_node_id(), begin, time.time(), file=file)
        return files
    return note

class Bar:
    def advance(self, work): ...

settings = parse(Settings, text, name="two", overrides=tuple(overrides))
stage = dataclasses.replace(STAGES[2], compute=noted(STAGES[2].compute))
store = Store.open(__import__("pathlib").Path(store), create=True)
walks = follow(stage, settings, store, {}, say=print)
with ray_cluster(address) as cluster:
    while cluster.n_cores < 2:
        time.sleep(0.1)
    run_stage(settings, stage, walks, {}, store=store, cluster=cluster, bar=Bar(), say=print)
done = results_of(stage, walks)
print(json.dumps({label: [m.digest for m in chain] for label, chain in done.done.items()}))
"""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def machine(folder: Path, environment: dict[str, str], *where: str) -> Iterator[subprocess.Popen]:
    """Start a Ray node of one core, with the commands of docker/compose.yaml; stop it."""
    ray = shutil.which("ray", path=str(Path(sys.executable).parent))
    words = [ray, "start", "--block", "--disable-usage-stats", "--num-cpus=1", f"--temp-dir={folder}", *where]
    with (folder.parent / f"{folder.name}.log").open("wb") as log:
        node = subprocess.Popen(
            [*words, "--object-store-memory=100000000"], env=environment, stdout=log, stderr=log, start_new_session=True
        )
    try:
        yield node
    finally:
        stop(node, signal.SIGTERM)


def stop(node: subprocess.Popen, number: int) -> None:
    if node.poll() is None:
        node.send_signal(number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            node.wait(15)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(node.pid, signal.SIGKILL)
    node.wait()


def wait_for(found, node: subprocess.Popen, log: Path, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not found():
        assert node.poll() is None and time.monotonic() < end, log.read_text(errors="replace")
        time.sleep(0.1)


@pytest.fixture
def short_folder() -> Iterator[Path]:
    """A folder whose path leaves room for those of Ray's sockets."""
    folder = Path(tempfile.mkdtemp(prefix="two-", dir="/tmp"))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


def serially(settings: Settings, folder: Path) -> dict[str, list[str]]:
    class Bar:
        def advance(self, work: float) -> None: ...

    store = Store.open(folder, create=True)
    walks = follow(STAGES[2], settings, store, {}, say=print)
    with serial_cluster() as cluster:
        run_stage(settings, STAGES[2], walks, {}, store=store, cluster=cluster, bar=Bar(), say=print)
    found = results_of(STAGES[2], walks)
    return {label: [manifest.digest for manifest in chain] for label, chain in found.done.items()}


def test_a_machine_leaves_half_way_and_another_comes(torture, short_folder, tmp_path):
    overrides = ["grid.n_trials=8", "evolution.n_generations=120"] if torture.large else []
    settings = parse(Settings, EVOLUTION, name="two", overrides=tuple(overrides))
    expected = serially(settings, tmp_path / "expected")
    n_pieces = sum(len(chain) for chain in expected.values())
    for number, rng in enumerate(torture.attempts(1, 5)):
        half_way = int(rng.uniform(0.3, 0.6) * n_pieces)
        (short_folder / str(number)).mkdir()
        found, busy = on_machines_that_change(short_folder / str(number), overrides, half_way)
        assert found == expected
        torture.note("share of the time with a task of ours: " + ", ".join(f"{share:.0%}" for share in busy))
        assert len(busy) in (2, 3)  # the third may come too late for work
        if "PYTEST_XDIST_WORKER" not in os.environ:  # beside other tests the cores are theirs, too
            assert min(busy) >= 0.85


def on_machines_that_change(folder: Path, overrides: list[str], half_way: int) -> tuple[dict, list[float]]:
    """Evolve on two machines; once so many pieces are kept, kill one and start another."""
    (folder / "token").write_text(secrets.token_hex(32))
    (folder / "token").chmod(0o600)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    environment |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(folder / "token")}
    environment["PYTHONPATH"] = str(ROOT)
    port, log, store = free_port(), folder / "tasks.log", folder / "store"
    here = socket.gethostbyname(socket.gethostname())
    head = (f"--port={port}", "--head", "--include-dashboard=false")

    def enough() -> bool:
        kept = len(list(store.glob("items/evolve/*/*/manifest.json")))
        return kept >= half_way and len(share_busy(log)) == 2

    with contextlib.ExitStack() as stack:
        first = stack.enter_context(machine(folder / "a", environment, f"--node-ip-address={here}", *head))
        wait_for(lambda: answers(here, port), first, folder / "a.log")
        # By addresses of their own, as machines have them: the driver is to work with the node beside it.
        join = f"--address={here}:{port}"
        second = stack.enter_context(machine(folder / "b", environment, join, "--node-ip-address=127.0.0.2"))
        told = json.dumps([EVOLUTION, overrides, f"{here}:{port}", str(store), str(log)])
        script = folder / "driver.py"
        script.write_text(DRIVER)
        with (folder / "said").open("w") as said, (folder / "warned").open("w") as warned:
            command = [sys.executable, str(script), told]
            driver = subprocess.Popen(command, env=environment, stdout=said, stderr=warned)
        stack.callback(driver.kill)
        wait_for(enough, driver, folder / "warned", 280)
        os.killpg(second.pid, signal.SIGKILL)
        stack.enter_context(machine(folder / "c", environment, join, "--node-ip-address=127.0.0.3"))
        assert driver.wait(280) == 0, (folder / "warned").read_text()
    return json.loads((folder / "said").read_text().splitlines()[-1]), share_busy(log)


def answers(host: str, port: int) -> bool:
    with contextlib.suppress(OSError):
        socket.create_connection((host, port), 1).close()
        return True
    return False


def share_busy(log: Path) -> list[float]:
    """Tell of each machine's one core which share of the time it had a task, from its first to its last."""
    tasks: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for line in log.read_text().splitlines():
        node, begin, end = line.split()
        tasks[node].append((float(begin), float(end)))
    return [
        sum(end - begin for begin, end in own) / (max(end for _, end in own) - min(begin for begin, _ in own))
        for own in tasks.values()
    ]
