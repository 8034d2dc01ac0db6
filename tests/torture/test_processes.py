"""Drivers as processes of their own: how they end, and whether they disturb one another."""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import os
import pty
import re
import signal
import sqlite3
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from marked_processes import Marked, started
from small_study import ON_REFERENCE, TINY

from pipeline.store.store import Store

ROOT = Path(__file__).parents[2]

ENDLESS = ("--set", "evolution.n_generations=1000000", "--set", "grid.environments=[dry_land]")
"""Options for a study that needs no networks, evolves at once and does not end by itself."""
WITHOUT_MLFLOW = ("--tracking-uri", "http://127.0.0.1:1")
"""Options for a driver that finds no MLflow server, and so need not import MLflow: three core-seconds."""


@contextlib.contextmanager
def driver(folder: Path, *words: str, command: str = "study", terminal: int | None = None) -> Iterator[Marked]:
    """Start a study or a single stage on two workers, or on a terminal of its own."""
    folder.mkdir(exist_ok=True)
    name = f"{command}-{len(list(folder.iterdir()))}"
    (settings := folder / f"{name}.yaml").write_text(TINY)
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("RAY_", "PUDDLE_"))}
    environment |= {"PYTHONPATH": str(ROOT), "TERM": "xterm"}
    changes = [word for change in (*ON_REFERENCE, "grid.single_member_depths=[]") for word in ("--set", change)]
    puddle = [sys.executable, "-m", "pipeline", command, "--settings", settings, "--store", folder / "store", *changes]

    def prepare() -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)  # the process that runs the tests may ignore them
        if terminal is not None:
            fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)

    log = folder / f"{name}.log"
    with started([*puddle, *words], log, environment, terminal=terminal, preexec_fn=prepare) as one:
        yield one


def here(seconds: float) -> float:
    """Scale a time limit by the present load of this machine [s]."""
    return seconds * max(1.0, os.getloadavg()[0] / os.cpu_count())


SESSION = re.compile(r"/tmp/puddle-\w+")


def words_of(process: psutil.Process) -> list[str]:
    with contextlib.suppress(psutil.Error):
        return process.cmdline()
    return []


def check_connections(one: Marked, expected: set[str]) -> None:
    """Check that both ends of all connections are on the loopback, and that the expected processes have some."""
    seen: set[str] = set()
    for process in one.family():
        with contextlib.suppress(psutil.Error):
            for found in process.net_connections("inet"):
                seen.add(process.name())
                for end in filter(None, (found.laddr, found.raddr)):
                    address = ipaddress.ip_address(end.ip)
                    assert (getattr(address, "ipv4_mapped", None) or address).is_loopback, process.cmdline()
    assert expected <= seen


@pytest.mark.parametrize("way", ["SIGINT", "SIGTERM", "closed terminal", "SIGKILL"])
def test_no_process_outlives_its_study(way: str, torture, tmp_path: Path):
    """All processes end within 5 s, or a minute after a kill -9: at work, and at any moment while Ray starts.
    Until then they listen on the loopback alone and connect to no other host.

    `make test` tries SIGINT and SIGKILL alone, at
    work, of drivers that mirror nothing to MLflow.
    """
    if not torture.large and way in ("SIGTERM", "closed terminal"):
        pytest.skip("with --torture: the handler is that of SIGINT")
    options = () if torture.large else WITHOUT_MLFLOW
    for number, rng in enumerate(torture.attempts(1, 40)):
        folder = tmp_path / str(number)
        ours, theirs = pty.openpty() if way == "closed terminal" else (None, None)
        with driver(folder, *ENDLESS, *options, "--workers", "1", terminal=theirs) as one:
            if number == 0:
                one.wait_for(lambda folder=folder: list(folder.glob("store/items/evolve/*/*/manifest.json")))
            time.sleep(rng.uniform(0.0, 1.0 if number == 0 else 15.0))
            assert one.process.poll() is None, one.said()
            spoke = "starting the cluster" in one.said()
            folders = {found for process in one.family() for found in SESSION.findall(" ".join(words_of(process)))}
            assert folders or number > 0
            check_connections(one, {"gcs_server", "raylet"} if number == 0 else set())
            if way == "closed terminal":
                os.close(theirs)
                os.close(ours)
            else:
                one.process.send_signal(signal.Signals[way])
            one.wait_for(one.ended, here(60.0 if way == "SIGKILL" else 5.0))
            assert way == "SIGKILL" or not any(Path(folder).exists() for folder in folders)
            code = one.process.wait()
            if way in ("SIGINT", "SIGTERM") and spoke:
                assert code == 128 + signal.Signals[way], one.said()
                assert not re.search(r"Traceback|SIG\w+ received|\*\*\*", one.said()), one.said()
                assert "the same command" in one.said()  # how to continue
        if (folder / "store" / "store.json").exists():
            assert Store.open(folder / "store", create=False).verify() == []


def test_two_studies_at_once_on_one_store_and_one_database(torture, tmp_path: Path):
    if not torture.large:
        pytest.skip("only with --torture: two drivers import MLflow")
    land = ("--workers", "0", "--set", "grid.environments=[dry_land]")
    longer = ("--set", "name=longer", "--set", "evolution.n_generations=6")
    with driver(tmp_path, *land, command="evolve") as one, driver(tmp_path, *land, *longer, command="evolve") as other:
        for each in (one, other):
            assert each.process.wait(200.0) == 0, each.said()
    assert Store.open(tmp_path / "store", create=False).verify() == []
    assert sorted(mirrored(tmp_path / "store")) == ["longer", "tiny"]


def mirrored(root: Path) -> list[str]:
    """Name the studies in MLflow's database."""
    with contextlib.closing(sqlite3.connect(root / "mlflow.db")) as database:
        nested = "SELECT run_uuid FROM tags WHERE key = 'mlflow.parentRunId'"
        return [name for (name,) in database.execute(f"SELECT name FROM runs WHERE run_uuid NOT IN ({nested})")]
