"""Make the tables of performance from a run of `make bench`: `python -m benchmarks.readme [bench.json]`.

The README has the figures that something was promised of, docs/performance.md all of them.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results.json"
"""The run that they show."""
PAGES = {ROOT / "README.md": True, ROOT / "docs" / "performance.md": False}
"""Pages that hold a table, and whether it is of the promised figures alone."""
BEGIN, END = "<!-- from benchmarks/results.json: python -m benchmarks.readme -->", "<!-- end -->"


def section(results: dict[str, Any], *, promised: bool) -> str:
    """Give the table of a run in Markdown: of all figures, or of those that something was promised of."""
    machine = results["machine"]
    where = f"{machine['cpu']}, {machine['lanes']} lanes, Python {machine['python']}, commit {machine['commit']}"
    lines = [
        f"One core of: {where}.",
        "Medians of repeated rounds; a ratio compares what ran in the same round.",
        "",
        "| what | median | spread | unit | promised |",
        "|---|--:|--:|---|---|",
    ]
    for figure in results["figures"]:
        if promised and figure["promise"] is None:
            continue
        bound = f"{'≥' if figure['at_least'] else '≤'} {figure['promise']} {'✓' if figure['kept'] else '✗'}"
        promise = "" if figure["promise"] is None else bound
        low, high = min(figure["rounds"]), max(figure["rounds"])
        median, spread = f"{figure['median']:.3g}", f"{low:.3g} to {high:.3g}"
        lines.append(f"| {figure['name']} | {median} | {spread} | {figure['unit']} | {promise} |")
    return "\n".join(lines)


def with_section(page: str, results: dict[str, Any], *, promised: bool) -> str:
    """Replace what is between a page's markers."""
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{section(results, promised=promised)}\n{END}{after}"


def main() -> None:
    """Take up a run, and write its tables."""
    if len(sys.argv) > 1:
        shutil.copyfile(sys.argv[1], RESULTS)
    results = json.loads(RESULTS.read_text())
    for page, promised in PAGES.items():
        page.write_text(with_section(page.read_text(), results, promised=promised))


if __name__ == "__main__":
    main()
