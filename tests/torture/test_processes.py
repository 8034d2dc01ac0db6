"""Drivers as processes of their own: how they end, and whether they admit a second driver.

The processes of a driver are found by a mark in their environment, which children inherit even if their parent is gone.
"""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import os
import pty
import re
import secrets
import signal
import socket
import sqlite3
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

from pipeline.cluster.session import sweep
from pipeline.store.store import Store

ROOT = Path(__file__).parents[2]

TINY = """
name: tiny
throws: {n_throws: 6, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 20, batch_size: 64}
ensemble: {n_members: 2}
grid: {depths: [1.0], single_member_depths: [], n_trials: 1}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 4, afpo: {population_size: 4}}
transfer: {n_generations: 2}
assess: {n_designs: 8}
work: {throws_per_item: 2, generations_per_item: 2, engine: reference}
"""

ENDLESS = ("--set", "evolution.n_generations=1000000", "--set", "grid.environments=[dry_land]")
"""Options for a study that needs no networks, evolves at once and does not end by itself."""
WITHOUT_MLFLOW = ("--tracking-uri", "http://127.0.0.1:1")
"""Options for a driver that finds no MLflow server, and so need not import MLflow: three core-seconds."""


@dataclass
class Driver:
    """A `puddle` process with a mark in its environment."""

    process: subprocess.Popen
    mark: str
    log: Path
    terminal: int | None = None

    def family(self) -> list[psutil.Process]:
        """Find every process that this driver started, and the driver itself."""
        found = []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if process.environ().get("PUDDLE_MARK") == self.mark and process.status() != psutil.STATUS_ZOMBIE:
                    found.append(process)
        return found

    def said(self) -> str:
        return self.log.read_text(errors="replace")


@contextlib.contextmanager
def driver(
    folder: Path, *words: str, command: str = "study", store: str = "store", terminal: bool = False
) -> Iterator[Driver]:
    """Start a study or a single stage; kill whatever is left of it at the end."""
    folder.mkdir(exist_ok=True)
    settings, log, mark = folder / "tiny.yaml", folder / f"{secrets.token_hex(4)}.log", secrets.token_hex(16)
    settings.write_text(TINY)
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("RAY_", "PUDDLE_"))}
    environment |= {"PUDDLE_MARK": mark, "PYTHONPATH": str(ROOT), "TERM": "xterm"}
    puddle = [sys.executable, "-m", "pipeline", command, "--settings", str(settings), "--store", str(folder / store)]
    ours, theirs = pty.openpty() if terminal else (None, None)

    def prepare() -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)  # the process that runs the tests may ignore them
        os.setsid()
        if theirs is not None:
            fcntl.ioctl(theirs, termios.TIOCSCTTY, 0)

    with log.open("wb") as sink:
        out = theirs if terminal else sink
        process = subprocess.Popen([*puddle, *words], stdout=out, stderr=out, env=environment, preexec_fn=prepare)
    if theirs is not None:
        os.close(theirs)
    one = Driver(process, mark, log, ours)
    try:
        yield one
    finally:
        for left in one.family():
            with contextlib.suppress(psutil.NoSuchProcess):
                left.kill()
        process.wait()
        if ours is not None:
            with contextlib.suppress(OSError):
                os.close(ours)


def here(seconds: float) -> float:
    """Scale a time limit by the present load of this machine [s]."""
    return seconds * max(1.0, os.getloadavg()[0] / os.cpu_count())


def wait_until_gone(one: Driver, at_most: float) -> None:
    """Wait until no process of the driver is left."""
    end = time.monotonic() + at_most
    while left := one.family():
        assert time.monotonic() < end, f"after {at_most:.1f} s still there: {left}"
        one.process.poll()
        time.sleep(0.05)


SESSION = re.compile(r"/tmp/puddle-\w+")


def words_of(process: psutil.Process) -> list[str]:
    with contextlib.suppress(psutil.Error):
        return process.cmdline()
    return []


@pytest.mark.parametrize("way", ["SIGINT", "SIGTERM", "closed terminal", "SIGKILL"])
def test_no_process_outlives_its_study(way: str, torture, tmp_path: Path):
    """All processes end within 5 s, or a minute after a kill -9: at work, and at any moment while Ray starts.

    The folder of a killed driver's Ray is removed by the next start. `make test` tries SIGINT and SIGKILL alone, at
    work. The killed driver mirrors nothing to MLflow.
    """
    if not torture.large and way in ("SIGTERM", "closed terminal"):
        pytest.skip("with --torture: the handler is that of SIGINT")
    options = WITHOUT_MLFLOW if way == "SIGKILL" and not torture.large else ()
    for number, rng in enumerate(torture.attempts(1, 40)):
        folder = tmp_path / str(number)
        with driver(folder, *ENDLESS, *options, "--workers", "1", terminal=way == "closed terminal") as one:
            if number == 0:
                wait_for(lambda folder=folder: list(folder.glob("store/items/evolve/*/*/manifest.json")))
            time.sleep(rng.uniform(0.0, 1.0 if number == 0 else 15.0))
            assert one.process.poll() is None, one.said()
            spoke = "starting the cluster" in one.said()
            folders = {found for process in one.family() for found in SESSION.findall(" ".join(words_of(process)))}
            assert folders or number > 0
            if way == "closed terminal":
                os.close(one.terminal)
            else:
                one.process.send_signal(signal.Signals[way])
            wait_until_gone(one, here(60.0 if way == "SIGKILL" else 5.0))
            sweep()
            assert not any(Path(folder).exists() for folder in folders)
            code = one.process.wait()
            if way in ("SIGINT", "SIGTERM") and spoke:
                assert code == 128 + signal.Signals[way], one.said()
                assert not re.search(r"Traceback|SIG\w+ received|\*\*\*", one.said()), one.said()
                assert RESUMABLE in one.said()
        if (folder / "store" / "store.json").exists():
            assert Store.open(folder / "store", create=False).verify() == []


RESUMABLE = "the same command"
"""Part of the message after a signal, which says how to continue."""

PATIENCE = 200.0
"""Longest wait for a driver [s]: its first work item may have to compile kernels on a busy machine."""


def wait_for(find):
    end = time.monotonic() + PATIENCE
    while not (found := find()):
        assert time.monotonic() < end
        time.sleep(0.1)
    return found


def test_a_second_driver_is_refused_and_the_first_is_named(tmp_path: Path):
    with driver(tmp_path, *ENDLESS, *WITHOUT_MLFLOW, "--workers", "0") as first:
        wait_for(lambda: list(tmp_path.glob("store/items/evolve/*/*/manifest.json")))
        first.process.send_signal(signal.SIGSTOP)  # it need not work while the second one starts
        with driver(tmp_path, *ENDLESS, *WITHOUT_MLFLOW, "--workers", "0") as second:
            assert second.process.wait(60) == 2
            said = second.said()
        assert f"study tiny is driven by process {first.process.pid} on {socket.gethostname()} since 20" in said
        assert "Wait until it ends, or stop it" in said


def test_two_studies_at_once_on_one_store_and_one_database(tmp_path: Path):
    land = ("--workers", "0", "--set", "grid.environments=[dry_land]")
    longer = ("--set", "name=longer", "--set", "evolution.n_generations=6")
    with driver(tmp_path, *land, command="evolve") as one, driver(tmp_path, *land, *longer, command="evolve") as other:
        for each in (one, other):
            assert each.process.wait(PATIENCE) == 0, each.said()
    assert Store.open(tmp_path / "store", create=False).verify() == []
    assert sorted(mirrored(tmp_path / "store")) == ["longer", "tiny"]


def mirrored(root: Path) -> list[str]:
    """Name the studies in MLflow's database."""
    with contextlib.closing(sqlite3.connect(root / "mlflow.db")) as database:
        nested = "SELECT run_uuid FROM tags WHERE key = 'mlflow.parentRunId'"
        return [name for (name,) in database.execute(f"SELECT name FROM runs WHERE run_uuid NOT IN ({nested})")]


def test_a_run_listens_on_the_loopback_alone_and_connects_to_no_other_host(tmp_path: Path):
    seen: set[str] = set()
    with driver(tmp_path, *WITHOUT_MLFLOW, "--workers", "1", command="collect") as one:
        while one.process.poll() is None:
            for process in one.family():
                with contextlib.suppress(psutil.Error):
                    for found in process.net_connections("inet"):
                        seen.add(process.name())
                        for end in filter(None, (found.laddr, found.raddr)):
                            address = ipaddress.ip_address(end.ip)
                            assert (getattr(address, "ipv4_mapped", None) or address).is_loopback, process.cmdline()
            time.sleep(0.2)
        assert one.process.returncode == 0, one.said()
    assert {"gcs_server", "raylet"} <= seen
