"""kill -9 at random moments: the driver, a worker, the raylet, the GCS. The study ends in the same bytes.

Real processes: `puddle study` with Ray, killed again and again on the same store, until every kill was made and the
study is done. No item that was committed is ever computed again: its manifest is never written twice.
"""

import contextlib
import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
import yaml

ROOT = Path(__file__).parents[2]
VICTIMS = ("worker", "driver", "raylet", "gcs_server")
PATIENCE = 180.0
"""Seconds that a driver has to notice that its cluster is dead, on a machine that has much else to do."""


@pytest.fixture(scope="module")
def undisturbed(nursery, tmp_path_factory):
    """Digests of the study's files, the page apart: it says which code made it, and when."""
    (answer,) = nursery.finish([tmp_path_factory.mktemp("undisturbed") / "store"], study="full")
    return results(answer["tree"])


def results(tree: dict[str, str]) -> dict[str, str]:
    return {
        path: sha256 for path, sha256 in tree.items()
        if path.startswith("items/") and not path.startswith("items/report") and not path.endswith("manifest.json")
    }  # fmt: skip


def start(store: Path, settings: Path, *words: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline", "study", "--settings", settings, "--store", store, *words],
        cwd=ROOT, env={**os.environ, "OMP_NUM_THREADS": "1"}, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip


def find(driver: subprocess.Popen, victim: str) -> psutil.Process | None:
    """Find a process of the driver's to kill."""
    with contextlib.suppress(psutil.Error):
        process = psutil.Process(driver.pid)
        if victim == "driver":
            return process
        for child in process.children(recursive=True):
            with contextlib.suppress(psutil.Error):
                words = child.cmdline()
                name = "worker" if words and words[0].startswith("ray::") else child.name()
                if name == victim:
                    return child
    return None


def manifests(store: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in store.glob("items/*/*/*/manifest.json")}


@pytest.mark.timeout(1800)  # Ray starts once for every kill: a minute in all, more where much else goes on
def test_kill_9_at_random_moments(torture, nursery, undisturbed, tmp_path):
    settings = tmp_path / "full.yaml"
    settings.write_text(yaml.safe_dump(nursery.ask(settings="full")["settings"]))
    n_of, n_stores, store, kept = dict.fromkeys(VICTIMS, 0), 0, None, {}

    def finish() -> None:
        """Let the study come to its end, and compare."""
        (answer,) = nursery.finish([store], study="full")
        assert results(answer["tree"]) == undisturbed
        now = manifests(store)
        assert {path: now[path] for path in kept} == kept

    for attempt, rng in enumerate(torture.attempts(4, 500)):
        if store is None or len(kept) >= 16:  # little is left to be killed at
            if store is not None:
                finish()
            n_stores += 1
            store, kept = tmp_path / f"store{n_stores}", {}
        victim = VICTIMS[attempt % 4]
        driver = start(store, settings, "--workers", "2")
        try:
            deadline = time.monotonic() + PATIENCE
            while (prey := find(driver, victim)) is None and driver.poll() is None and time.monotonic() < deadline:
                time.sleep(0.02)
            time.sleep(float(rng.exponential(1.5)) + (2.0 if victim == "driver" else 0.0))
            if prey is not None:
                with contextlib.suppress(psutil.NoSuchProcess):
                    prey.kill()
                    n_of[victim] += 1
            _, said = driver.communicate(timeout=PATIENCE)
            assert "Traceback" not in said, said
            assert driver.returncode in ((-9,) if victim == "driver" and prey else (0, 1, 2)), said
            now = manifests(store)
            assert {path: now[path] for path in kept} == kept
            kept = now
        finally:
            driver.kill()
            driver.wait()
    finish()
    killed = ", ".join(f"{number} {victim}" for victim, number in n_of.items())
    torture.note(f"killed {killed}; {n_stores} studies ended in the same bytes, no item written twice")
