"""A study on a cluster that loses a machine half-way and gains another: the same bytes, and every core kept busy.

The machines are Ray nodes on this one, each with folders of its own. They and the driver, `puddle study --address`, run
the words of docker/compose.yaml, with this machine's names and ports in them. Busy means that a task of ours was
assigned: Ray's own timeline says when each began and ended, and where.

Two bounds hold for each core while evolution has a piece for it, 85 % both. One for half of its tasks or more, always:
a task's share of the time from its begin to the next one's. The other for all of a core's time together, in `make
torture` alone: until Ray notices that a machine is gone, some seconds, the pieces that it had wait, which is much of a
short study and little of a long one; and `make test` has other tests beside it, whose the cores are, too.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import secrets
import signal
import socket
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import psutil
import pytest
from containers import SMALL_MEMORY, environment_of, words_of

from pipeline.commands.status import digest_lines
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.store.store import Store

ROOT = Path(__file__).parents[2]

STUDY = """
name: two-machines
throws: {n_throws: 4, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 10, batch_size: 16}
ensemble: {n_members: 1}
grid: {depths: [1.0], environments: [dry_land], single_member_depths: [1.0], n_trials: 2}
rollout: {n_settle: 5, n_measure: 300}
evolution: {n_generations: N_GENERATIONS, afpo: {population_size: 8}}
transfer: {n_generations: 2, adapted_environments: [dry_land]}
assess: {n_designs: 8}
work: {throws_per_item: 2, generations_per_item: 10, engine: reference}
"""
"""Every stage; evolution in pieces of about a core-second, which last beyond the start of a machine."""

LOST = "127.0.0.2"
"""Address of the machine that is killed."""
ADDED = "127.0.0.3"
"""Address of the machine that comes later."""

PLAIN_PYTHON = {"NUMBA_DISABLE_JIT": "1"}
"""In the environment of every process that computes. Each machine has the sources in a folder of its own, where its
kernels would all be compiled anew: longer than they work for. The networks' sums round otherwise without the compiler,
so that the study in one process does without it too."""

SERIALLY = """
import sys
from pathlib import Path
from small_study import run
from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store
settings = parse(Settings, sys.stdin.read(), name="two")
with serial_cluster() as cluster:
    run(settings, Store.open(Path(sys.argv[1]), create=True), cluster, STAGES[:-1])
"""
"""The study in one process, but for its page."""

SUBMISSION = """
import json, sys
from pathlib import Path
import ray
address, file = sys.argv[1], Path(sys.argv[2])
ray.init(address=address, log_to_driver=False)
ray.get(ray.remote(num_cpus=0)(Path.touch).remote(file))
file.with_suffix(".timeline").write_text(json.dumps(ray.timeline()))
"""
"""A task that leaves a file; and, where that was let in, what the cluster did when."""


class Task(NamedTuple):
    """A piece of evolution, as the cluster saw it."""

    begin: float
    """[s]."""
    end: float
    machine: str
    """Its address."""
    trial: str


@pytest.mark.timeout(1200)  # what it waits for has bounds of its own
def test_a_machine_leaves_half_way_and_another_comes(torture, short_folder, tmp_path):
    text = STUDY.replace("N_GENERATIONS", "480" if torture.large else "80")
    settings = parse(Settings, text, name="two")
    expected = serially(text, settings, tmp_path / "expected")
    n_pieces = sum(line.endswith("population.safetensors") and "  evolve/" in line for line in expected)
    for number, rng in enumerate(torture.attempts(1, 5)):
        # A machine takes its time to come, and is to find work that lasts.
        lost_after = rng.uniform(0.2, 0.3) if torture.large else rng.uniform(0.3, 0.45)
        half_way = int(lost_after * n_pieces)
        folder = short_folder / str(number)
        folder.mkdir()
        (folder / "two.yaml").write_text(text)
        tasks = on_machines_that_change(folder, half_way)
        found = list(digest_lines(settings, Store.open(folder / "store", create=False)))
        assert [line for line in found if "  report/" not in line] == expected
        assert any("  report/" in line for line in found)  # which says when it was made, and so differs
        assert ADDED in {task.machine for task in tasks}
        of_machines = while_there_is_plenty(tasks)
        n_tasks = {own[0].machine: len(own) for own in of_machines}
        torture.note("pieces, by machine: " + ", ".join(f"{machine} {number}" for machine, number in n_tasks.items()))
        if torture.large:  # a short study may leave the machines that go and come hardly any
            assert n_tasks.keys() >= {LOST, ADDED} and len(n_tasks) == 3, n_tasks
            assert min(n_tasks.values()) >= 8, n_tasks
        of_machines = [own for own in of_machines if len(own) > 1]
        assert of_machines, n_tasks
        usual, busy = [usual_share_busy(own) for own in of_machines], [share_busy(own) for own in of_machines]
        torture.note("share of the time with a task of ours: " + ", ".join(f"{share:.0%}" for share in busy))
        assert min(usual) >= 0.85
        if torture.large:
            assert min(busy) >= 0.85


def serially(text: str, settings: Settings, folder: Path) -> list[str]:
    """Run the study in one process, but for its page; give its digests."""
    paths = os.pathsep.join([str(ROOT), str(ROOT / "tests" / "shared")])
    environment = {**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1", **PLAIN_PYTHON}
    words = [sys.executable, "-c", SERIALLY, str(folder)]
    ran = subprocess.run(words, env=environment, input=text, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return list(digest_lines(settings, Store.open(folder, create=False)))


def on_machines_that_change(folder: Path, half_way: int) -> list[Task]:
    """Run the study on two machines; once so many pieces of evolution are kept, kill one and start another."""
    (folder / "token").write_text(secrets.token_hex(32))
    (folder / "token").chmod(0o600)
    here, port = socket.gethostbyname(socket.gethostname()), free_port()
    address = f"{here}:{port}"
    tools = ("RAY_", "PUDDLE_", "MLFLOW_")
    without_token = {name: value for name, value in os.environ.items() if not name.startswith(tools)}
    without_token |= {"PYTHONPATH": str(ROOT), "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    without_token |= PLAIN_PYTHON
    token = {"RAY_AUTH_TOKEN_PATH": str(folder / "token")}
    head = words_of("head", {"--port=6379": f"--port={port}", **SMALL_MEMORY})
    worker = words_of("worker", {"head:6379": address, **SMALL_MEMORY})
    of_nodes = {**without_token, **environment_of("worker", token)}

    def enough() -> bool:
        kept = len(list((folder / "store").glob("items/evolve/*/*/manifest.json")))
        return kept >= half_way and evolves(second)

    with contextlib.ExitStack() as stack:

        def start(name: str, words: list[str], environment: dict[str, str]) -> subprocess.Popen:
            return stack.enter_context(started(folder, name, words, environment))

        def machine(name: str, ip: str, words: list[str]) -> subprocess.Popen:
            own = [f"--temp-dir={folder / name}", f"--node-ip-address={ip}", "--num-cpus=1"]
            return start(name, [*words, *own], of_nodes)

        first = machine("a", here, head)
        wait_for(lambda: answers(here, port), first, folder / "a.log")
        # By addresses of their own, as machines have them: the driver is to work with the node beside it.
        second = machine("b", LOST, worker)
        stranger = start("stranger", submission(address, folder / "intruded"), without_token)
        wait_for(lambda: "Ray runtime started" in (folder / "b.log").read_text(), second, folder / "b.log")
        beside = f"ray start --temp-dir={folder / 'd'} --node-ip-address=127.0.0.4"
        study = words_of("driver", {"ray start": beside, "head:6379": address, **SMALL_MEMORY})
        study[-1] += f" --settings {folder / 'two.yaml'}"  # which go before the preset
        of_driver = environment_of("driver", {**token, "PUDDLE_STORE": str(folder / "store"), "PRESET": "smoke"})
        del of_driver["MLFLOW_TRACKING_URI"]  # tests/pipeline/tracking/test_server.py has the server
        driver = start("driver", study, {**without_token, **of_driver})
        wait_for(enough, driver, folder / "driver.log", 480)
        os.killpg(second.pid, signal.SIGKILL)
        machine("c", ADDED, worker)
        assert driver.wait(480) == 0, (folder / "driver.log").read_text()
        # The same submission, with the token and without: it may have tried for as long as the study took.
        friend = start("friend", submission(address, folder / "let-in"), of_nodes)
        assert friend.wait(120) == 0 and (folder / "let-in").exists(), (folder / "friend.log").read_text()
        stranger.kill()
        assert stranger.wait() != 0 and not (folder / "intruded").exists()
        assert "authenticat" in (folder / "stranger.log").read_text().lower()
    return tasks_of(json.loads((folder / "let-in.timeline").read_text()))


def evolves(machine: subprocess.Popen) -> bool:
    """Tell whether a machine has a piece of evolution. What it tells Ray's timeline of it may be lost with it."""
    with contextlib.suppress(psutil.Error):
        processes = psutil.Process(machine.pid).children(recursive=True)
        return any(process.name().startswith("ray::evolve") for process in processes)
    return False


def submission(address: str, file: Path) -> list[str]:
    return [sys.executable, "-c", SUBMISSION, address, str(file)]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def answers(host: str, port: int) -> bool:
    with contextlib.suppress(OSError):
        socket.create_connection((host, port), 1).close()
        return True
    return False


@contextlib.contextmanager
def started(folder: Path, name: str, words: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen]:
    """Start a machine's process, and leave none of it: what it started is known by its environment."""
    mark = secrets.token_hex(16)
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(
            words, env={**environment, "PUDDLE_MARK": mark}, cwd=folder, stdout=log, stderr=log, start_new_session=True
        )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(15)
        for left in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if left.environ().get("PUDDLE_MARK") == mark:
                    left.kill()
        process.wait()


def wait_for(found: Callable[[], bool], process: subprocess.Popen, log: Path, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not found():
        assert process.poll() is None and time.monotonic() < end, log.read_text(errors="replace")
        time.sleep(0.1)


def tasks_of(timeline: list[dict]) -> list[Task]:
    """Find the pieces of evolution in Ray's timeline, in order."""
    return sorted(
        Task(event["ts"] / 1e6, (event["ts"] + event["dur"]) / 1e6, event["pid"], match[1])
        for event in timeline
        if (match := re.fullmatch(r"task::evolve (.+)/segment-\d+", event["cat"])) is not None
    )


def while_there_is_plenty(tasks: list[Task]) -> list[list[Task]]:
    """Give each machine's tasks that began while three trials were open, more than the two cores that there are.

    A trial's pieces follow one another: with fewer trials a core waits for the other's result.
    """
    last = {task.trial: task.end for task in tasks}
    until = sorted(last.values())[-3]
    of_machine: dict[str, list[Task]] = defaultdict(list)
    for task in tasks:
        if task.begin < until:
            of_machine[task.machine].append(task)
    return list(of_machine.values())


def share_busy(own: list[Task]) -> float:
    """Tell which share of the time a machine's one core had a task, from the first to the last."""
    return sum(task.end - task.begin for task in own) / (own[-1].end - own[0].begin)


def usual_share_busy(own: list[Task]) -> float:
    """Give the median, over a machine's tasks but the last, of a task's share of the time to the next one's begin."""
    pairs = itertools.pairwise(own)
    return statistics.median((task.end - task.begin) / (following.begin - task.begin) for task, following in pairs)
