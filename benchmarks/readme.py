"""Make the README's performance section from a run of `make bench`: `python -m benchmarks.readme [bench.json]`."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results.json"
"""The run that the README shows."""
BEGIN, END = "<!-- from benchmarks/results.json: python -m benchmarks.readme -->", "<!-- end -->"


def section(results: dict[str, Any]) -> str:
    """Give the table of a run in Markdown."""
    machine = results["machine"]
    lines = [
        f"One core of: {machine['cpu']}, {machine['lanes']} lanes, Python {machine['python']}.",
        "Medians of repeated rounds; a ratio compares what ran in the same round.",
        "",
        "| what | median | spread | unit | promised |",
        "|---|--:|--:|---|---|",
    ]
    for figure in results["figures"]:
        bound = f"{'≥' if figure['at_least'] else '≤'} {figure['promise']} {'✓' if figure['kept'] else '✗'}"
        promise = "" if figure["promise"] is None else bound
        low, high = min(figure["rounds"]), max(figure["rounds"])
        median, spread = f"{figure['median']:.3g}", f"{low:.3g} to {high:.3g}"
        lines.append(f"| {figure['name']} | {median} | {spread} | {figure['unit']} | {promise} |")
    return "\n".join(lines)


def with_section(readme: str, results: dict[str, Any]) -> str:
    """Replace what is between the README's markers."""
    before, rest = readme.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{section(results)}\n{END}{after}"


def main() -> None:
    """Take up a run, and write its table into the README."""
    if len(sys.argv) > 1:
        shutil.copyfile(sys.argv[1], RESULTS)
    readme = ROOT / "README.md"
    readme.write_text(with_section(readme.read_text(), json.loads(RESULTS.read_text())))


if __name__ == "__main__":
    main()
