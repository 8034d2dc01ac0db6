"""Drivers as processes of their own: how they end, and whether they disturb one another."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import re
import signal
import sqlite3
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from command_line import WITHOUT_MLFLOW
from marked_processes import Marked, started
from small_study import ON_REFERENCE, TINY

from pipeline.store.store import Store

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]

ENDLESS = ("--set", "evolution.n_generations=1000000", "--set", "grid.environments=[dry_land]")
"""Options for a study that needs no networks, evolves at once and does not end by itself."""


@contextlib.contextmanager
def driver(folder: Path, *words: str) -> Iterator[Marked]:
    """Start a study."""
    folder.mkdir(exist_ok=True)
    (settings := folder / "study.yaml").write_text(TINY)
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("RAY_", "PUDDLE_"))}
    environment |= {"PYTHONPATH": str(ROOT), "TERM": "xterm"}
    changes = [word for change in (*ON_REFERENCE, "grid.single_member_depths=[]") for word in ("--set", change)]
    puddle = [sys.executable, "-m", "pipeline", "study", "--settings", settings, "--store", folder / "store", *changes]

    def prepare() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # the process that runs the tests may ignore it

    with started([*puddle, *words], folder / "study.log", environment, preexec_fn=prepare) as one:
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


@pytest.mark.parametrize("way", ["SIGINT", "SIGKILL"])
def test_no_process_outlives_its_study(way: str, torture, tmp_path: Path):
    """All processes end within 5 s, or a minute after a kill -9: at work, and at any moment while Ray starts.
    Until then they listen on the loopback alone and connect to no other host.

    `make test` stops drivers at work that mirror nothing to MLflow.
    """
    options = () if torture.large else WITHOUT_MLFLOW
    for number, rng in enumerate(torture.attempts(1, 40)):
        folder = tmp_path / str(number)
        with driver(folder, *ENDLESS, *options, "--workers", "1") as one:
            if number == 0:
                one.wait_for(lambda folder=folder: list(folder.glob("store/items/evolve/*/*/manifest.json")))
            time.sleep(rng.uniform(0.0, 1.0 if number == 0 else 15.0))
            assert one.process.poll() is None, one.said()
            spoke = "starting the cluster" in one.said()
            folders = {found for process in one.family() for found in SESSION.findall(" ".join(words_of(process)))}
            assert folders or number > 0
            check_connections(one, {"gcs_server", "raylet"} if number == 0 else set())
            one.process.send_signal(signal.Signals[way])
            one.wait_for(one.ended, here(60.0 if way == "SIGKILL" else 5.0))
            code = one.process.wait()
            assert way == "SIGKILL" or not any(Path(folder).exists() for folder in folders), (code, one.said())
            if way == "SIGINT" and spoke:
                assert code == 130, one.said()
                assert not re.search(r"Traceback|SIG\w+ received|\*\*\*", one.said()), one.said()
                assert "the same command" in one.said()  # how to continue
        if (folder / "store" / "store.json").exists():
            assert Store.open(folder / "store", create=False).verify() == []


def test_two_studies_at_once_on_one_store_and_one_database(torture, tmp_path: Path):
    if not torture.large:
        pytest.skip("only with --torture: two drivers import MLflow")
    options = ("--workers", "0", "--set", "grid.environments=[dry_land]")
    with driver(tmp_path, *options) as one, driver(tmp_path, *options, "--set", "name=other") as other:
        for each in (one, other):
            assert each.process.wait(here(200.0)) == 0, each.said()
    store = Store.open(tmp_path / "store", create=False)
    assert store.verify() == [] and sorted(store.studies()) == ["other", "tiny"]
    with contextlib.closing(sqlite3.connect(store.root / "mlflow.db")) as database:
        assert {("other",), ("tiny",)} <= set(database.execute("SELECT name FROM runs"))
