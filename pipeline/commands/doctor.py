"""puddle doctor: checks that find in a second what would stop a study after hours."""

import contextlib
import importlib.metadata
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal

import psutil
import typer

from pipeline.cluster.process import number_of_cores
from pipeline.commands.options import StudyOptions, Workers, with_options
from pipeline.commands.terminal import INCOMPLETE, to_stdout
from pipeline.commands.time_model import forecast_stages
from pipeline.config.settings import Settings
from pipeline.store.store import Store

Verdict = Literal["ok", "warn", "fail"]

_CONSTRAINTS = Path(str(files("pipeline") / "constraints.txt"))  # package versions that were tested together

_BYTES_PER_WORKER = 450e6
"""Memory of a worker: 300 MB with torch and the engine loaded (measured), and space to work in."""
_BYTES_OF_DRIVER = 1e9  # memory of the driver and of Ray's own processes
_SPARE_BYTES = 1e9  # disk space beside the results: MLflow's database, reports, other users


@with_options
def doctor(options: StudyOptions, workers: Workers = None) -> None:
    """Check a machine before a long study."""
    checks = []
    for check in examine(options.settings(), options.store, n_workers=workers):
        checks.append(check)
        to_stdout(f"{check.verdict:<5} {check.what}: {check.found}")
        if check.verdict != "ok":
            to_stdout(f"      {check.advice}")
    if any(check.verdict == "fail" for check in checks):
        raise typer.Exit(INCOMPLETE)


@dataclass(frozen=True)
class Check:
    """The result of one check."""

    verdict: Verdict
    what: str
    found: str
    advice: str  # where the verdict is not ok


def examine(settings: Settings, store: Path, *, n_workers: int | None) -> Iterator[Check]:
    """Check this machine for a study; ``n_workers`` of None are all cores, of 0 this process alone."""
    n_workers = number_of_cores() if n_workers is None else n_workers
    yield _versions()
    yield _processor(n_workers)
    yield _memory(n_workers)
    yield _disk(settings, store)
    yield from _gpu(settings)


def _versions() -> Check:
    wanted = dict(re.findall(r"^([\w.-]+)==([\w.!-]+)", _CONSTRAINTS.read_text(), flags=re.M))
    other = []
    for name, version in wanted.items():
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):  # of an extra
            found = importlib.metadata.version(name).partition("+")[0]
            other += [f"{name} {found} (tested: {version})"] if found != version else []
    advice = "Untested versions may change results in their last bits. make clean setup installs the tested ones."
    found = ", ".join(other) or f"{len(wanted)} packages as in {_CONSTRAINTS.name}"
    return Check("warn" if other else "ok", "versions", found, advice)


def _processor(n_workers: int) -> Check:
    from llvmlite.binding import get_host_cpu_features  # installed with numba

    features, n_cores = get_host_cpu_features(), number_of_cores()
    found = f"{n_cores} cores; load {os.getloadavg()[0]:.1f}"
    if n_workers > n_cores:
        advice = f"{n_workers} workers share {n_cores} cores: use --workers {n_cores}."
        return Check("warn", "processor", found, advice)
    exact = features.get("avx2") and features.get("fma")
    advice = "Without AVX2 and FMA the last bits may differ from those of other machines: use one kind for a study."
    return Check("ok" if exact else "warn", "processor", found, advice)


def _memory(n_workers: int) -> Check:
    free, needed = psutil.virtual_memory().available, _BYTES_OF_DRIVER + n_workers * _BYTES_PER_WORKER
    found = f"{free / 1e9:.1f} GB free, {needed / 1e9:.1f} GB needed by {n_workers} workers and the driver"
    fitting = max(0, int((free - _BYTES_OF_DRIVER) / _BYTES_PER_WORKER))
    advice = f"Free some memory, or use fewer workers: --workers {fitting}."
    return Check("ok" if free >= needed else "fail", "memory", found, advice)


def _disk(settings: Settings, store: Path) -> Check:
    """Compare the space that is free with what the rest of the study needs."""
    root = store.expanduser().resolve()
    folder = next(path for path in (root, *root.parents) if path.exists())
    opened = Store.open(folder, create=False) if (folder / "store.json").exists() else None
    left = sum(stage.n_bytes for stage in forecast_stages(settings, opened))
    needed, free = _SPARE_BYTES + left if left else 0.0, shutil.disk_usage(folder).free
    if not os.access(folder, os.W_OK):
        return Check("fail", "disk", f"no permission to write to {folder}", "Put the store elsewhere: --store.")
    needs = f"at most {needed / 1e9:.1f} GB needed for the rest of study {settings.name}"
    found = f"{free / 1e9:.1f} GB free at {folder}, {needs if left else f'study {settings.name} is done'}"
    advice = "Free some space (`puddle gc`), or put the store elsewhere: --store."
    return Check("ok" if free >= needed else "fail", "disk", found, advice)


def _gpu(settings: Settings) -> Iterator[Check]:
    """Look for a CUDA device, if the study is to use one."""
    trained = any(learner.training.device == "cuda" for learner in settings.ensembles.values())
    if not trained and settings.work.networks == "local":
        return
    from tasks.residual.torch_descent import n_cuda_devices, no_device  # imports torch

    missing = no_device()
    verdict: Verdict = "ok" if not missing else "fail" if trained else "warn"
    advice = "Without one: training.device=cpu trains (other) networks, and work.networks=local is faster than gpu."
    yield Check(verdict, "GPU", missing or f"{n_cuda_devices()} for torch", advice)
