"""`make bench`: measure the engines and the networks on one core, print a table, write bench.json.

Every figure is the median of several rounds. A round measures all peers once, one after the other, so that a ratio
compares what ran at the same time on the same machine.
"""

from __future__ import annotations

import os

os.environ.update({"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"})

import json
import platform
import subprocess
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks import engines, evolution, networks
from benchmarks.measure import Benchmark

OUT = Path("bench.json")


def machine() -> dict[str, str | int | None]:
    """Describe this machine."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        cpu = platform.processor()
    said = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "lanes": engines.WIDEST,
        "commit": said.stdout.strip() or None,
    }


def main() -> None:
    """Measure, print a table and write the results."""
    console = Console(width=118)
    figures: list[Benchmark] = []
    for measure in (
        engines.steps,
        engines.bodies,
        engines.packing,
        evolution.own_work,
        engines.two_processes,
        networks.inference,
        networks.wetted,
        networks.training,
    ):
        console.print(f"[dim]{measure.__doc__}[/dim]")
        figures += measure()
    table = Table(title=f"One core of {machine()['cpu']}")
    for heading in ("what", "median", "spread", "unit", "bound"):
        table.add_column(heading, justify="left" if heading in ("what", "unit") else "right")
    for figure in figures:
        low, high = min(figure.rounds), max(figure.rounds)
        bound = "" if figure.bound is None else f"{figure.bound_text} {'✓' if figure.met else '✗'}"
        table.add_row(figure.name, f"{figure.median:.3g}", f"{low:.3g} to {high:.3g}", figure.unit, bound)
    console.print(table)
    OUT.write_text(json.dumps({"machine": machine(), "figures": [figure.as_dict() for figure in figures]}, indent=1))
    console.print(f"written to {OUT}")


if __name__ == "__main__":
    main()
