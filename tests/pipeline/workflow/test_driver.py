"""The driver: damage during a run, a name that had other settings, and MLflow in the background."""

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
TO_TRANSFER = STAGES[:5]


def run(
    store: Store, stages: Sequence[AnyStage] = TO_TRANSFER, *overrides: str, terminal: Terminal | None = None, **options
) -> dict[str, Results]:
    terminal = terminal or Terminal()
    return drive(
        parse(
            Settings, ON_DRY_LAND, name="tiny", overrides=("grid.n_trials=2", "evolution.n_generations=2", *overrides)
        ),
        stages,
        stages=STAGES,
        store=store,
        open_cluster=serial_cluster,
        tracker=terminal,
        progress=terminal,
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


def test_other_settings_of_a_name_replace_its_record_and_say_so(store: Store) -> None:
    run(store)
    before, terminal = store.read_study("tiny"), Terminal()
    run(store, TO_TRANSFER, "seed=2", terminal=terminal)
    assert "tiny is on record with different settings (seed: 1 → 2)" in terminal.said[0]
    assert store.read_study("tiny").settings["seed"] == 2
    run(store)
    assert store.read_study("tiny") == before


@pytest.mark.parametrize("source", ["preset tiny", "/studies/tiny.yaml"])
def test_a_study_has_the_tag_of_its_settings(store: Store, source) -> None:
    tags = set[str]()

    class Recorder(Terminal):
        def mirror(self, study, *runs) -> None:
            tags.add(study.tags["preset"])

    run(store, TO_EVOLVE[:1], terminal=Recorder(), source=source)
    assert tags == {"tiny"}
