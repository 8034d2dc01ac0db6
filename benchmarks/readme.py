"""Write the table of docs/performance.md from a run of `make bench`: `python -m benchmarks.readme [bench.json]`."""

from __future__ import annotations

import json
import shutil
import sys
from typing import Any

from benchmarks.sentences import ROOT

MEASURED = ROOT / "benchmarks" / "results.json"
"""The recorded run that the page shows."""
PERFORMANCE_PAGE = ROOT / "docs" / "performance.md"
BEGIN, END = "<!-- from benchmarks/results.json: python -m benchmarks.readme -->", "<!-- end -->"


def section(results: dict[str, Any]) -> str:
    """Format the figures of a run as a Markdown table."""
    machine = results["machine"]
    where = f"{machine['cpu']}, {machine['lanes']} lanes, Python {machine['python']}, commit {machine['commit']}"
    lines = [
        f"One core of: {where}.",
        "Medians of repeated rounds; a ratio compares what ran in the same round.",
        "",
        "| what | median | spread | unit | bound |",
        "|---|--:|--:|---|---|",
    ]
    for figure in results["figures"]:
        words = f"{'≥' if figure['at_least'] else '≤'} {figure['bound']} {'✓' if figure['met'] else '✗'}"
        bound = "" if figure["bound"] is None else words
        low, high = min(figure["rounds"]), max(figure["rounds"])
        median, spread = f"{figure['median']:.3g}", f"{low:.3g} to {high:.3g}"
        lines.append(f"| {figure['name']} | {median} | {spread} | {figure['unit']} | {bound} |")
    return "\n".join(lines)


def with_section(page: str, results: dict[str, Any]) -> str:
    """Replace what stands between a page's markers by the table of a run."""
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{section(results)}\n{END}{after}"


def main() -> None:
    """Record a run, if one is given, and write the table."""
    if len(sys.argv) > 1:
        shutil.copyfile(sys.argv[1], MEASURED)
    PERFORMANCE_PAGE.write_text(with_section(PERFORMANCE_PAGE.read_text(), json.loads(MEASURED.read_text())))


if __name__ == "__main__":
    main()
