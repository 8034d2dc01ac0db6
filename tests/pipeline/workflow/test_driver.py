"""The driver: damage during a run, a name that had other settings, and MLflow in the background."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from small_study import ON_DRY_LAND, Terminal, digests, labelled

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow.driver import drive
from pipeline.workflow.stage import AnyStage, Results

TO_EVOLVE = STAGES[:3]
TO_TRANSFER = STAGES[:4]


def run(
    store: Store,
    stages: Sequence[AnyStage] = TO_TRANSFER,
    *overrides: str,
    terminal: Terminal | None = None,
    open_cluster=serial_cluster,
    **options,
) -> dict[str, Results]:
    terminal = terminal or Terminal()
    return drive(
        parse(
            Settings, ON_DRY_LAND, name="tiny", overrides=("grid.n_trials=2", "evolution.n_generations=2", *overrides)
        ),
        stages,
        stages=STAGES,
        store=store,
        open_cluster=open_cluster,
        tracker=terminal,
        progress=terminal,
        how_to_run=lambda name: f"puddle {name}",
        **options,
    )


def flip_a_bit(path: Path) -> None:
    """Damage a file as only its SHA-256 can tell."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def test_a_signal_ends_the_wait_for_mlflow_through_every_finally(tmp_path: Path) -> None:
    """The cluster's own signal handlers are gone by then, because it is closed."""
    script = """
import sys, time
from pathlib import Path
from small_study import Terminal
from test_driver import TO_EVOLVE, run
from pipeline.store.store import Store
class Slow(Terminal):
    def say(self, line):
        print(line, flush=True)
    def mirror(self, *runs):
        time.sleep(600)
try:
    run(Store.open(Path(sys.argv[1]), create=True), TO_EVOLVE, terminal=Slow())
finally:
    print("unwound", flush=True)
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    words = [sys.executable, "-c", script, str(tmp_path / "store")]
    with subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None
        for line in driver.stdout:
            if line == "bringing the record of runs and curves up to date\n":
                driver.send_signal(signal.SIGTERM)
                break
        assert driver.stdout.read() == "unwound\n"
    assert driver.returncode == 128 + signal.SIGTERM


def test_damage_found_during_other_work_is_mended(store: Store) -> None:
    """Trial 1's population is read when trial 0 has been submitted: no one waits for that call's outcome any more."""
    evolved = labelled(run(store, TO_EVOLVE)["evolve"].done)["dry_land/1m/trial-1"][-1]
    folder = store.root / "items" / "evolve" / evolved.key[:2] / evolved.key
    flip_a_bit(folder / "population.safetensors")
    terminal = Terminal()
    found = run(store, terminal=terminal)
    assert sum("expected SHA-256" in line for line in terminal.said) == 1
    undisturbed = Store.open(store.root.parent / "undisturbed", create=True)
    assert digests(found) == digests(run(undisturbed))
    assert store.verify() == []


@contextlib.contextmanager
def stopped_after(n_items: int, error: type[BaseException] = KeyboardInterrupt):
    """Open a cluster that raises an error after some items."""
    with serial_cluster() as cluster:
        next_done = cluster.next_done
        left = iter(range(n_items))

        def next_or_stop(timeout: float | None = None):
            if next(left, None) is None:
                raise error
            return next_done(timeout)

        cluster.next_done = next_or_stop
        yield cluster


def test_a_study_keeps_its_record_until_its_new_settings_have_a_result(store: Store) -> None:
    """`puddle gc` keeps what the record lists, so stopping in time, as the message advises, loses nothing."""
    run(store)
    before = store.read_study("tiny")
    longer = "transfer.n_generations=4"  # evolution is done: that alone is no result of the new settings
    terminal = Terminal()
    with pytest.raises(KeyboardInterrupt):
        run(store, TO_TRANSFER, longer, terminal=terminal, open_cluster=lambda: stopped_after(0))
    assert "To keep both reports, stop (Ctrl-C) before" in terminal.said[0]
    assert store.read_study("tiny") == before
    with pytest.raises(KeyboardInterrupt):
        run(store, TO_TRANSFER, longer, open_cluster=lambda: stopped_after(1))
    after = store.read_study("tiny")
    assert after.settings["transfer"]["n_generations"] == 4
    assert [item for item in after.items if item.stage == "evolve"] == [i for i in before.items if i.stage == "evolve"]


@pytest.mark.parametrize("source", ["preset tiny", "/studies/tiny.yaml"])
def test_a_study_has_the_tag_of_its_settings(store: Store, source) -> None:
    class Recorder(Terminal):
        def mirror(self, study, stage, trials) -> None:
            assert study.tags["preset"] == "tiny"

    run(store, TO_EVOLVE[:1], terminal=Recorder(), source=source)


def test_settings_with_nothing_to_compute_are_recorded_too(store: Store) -> None:
    run(store)
    before = store.read_study("tiny")
    run(store, TO_TRANSFER, "seed=2")
    assert store.read_study("tiny").settings["seed"] == 2
    run(store)
    assert store.read_study("tiny") == before
