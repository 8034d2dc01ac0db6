"""Write tables and figures of results in README.md and docs from docs/results/*.json: `python -m benchmarks.published`.

A results file is the ``results.json`` of `puddle export`. `python -m benchmarks.published EXPORT/results.json` records
one first, under the name of its study, and the figures of the export that docs/results/pictures.json names. A study
that is run one depth at a time is exported and recorded again with each.

Tables, and what they were made with, stand between markers; figures in running text are those of
benchmarks/page_sentences.py. It ends with exit code 1, and says why, where the words of a page no longer follow from
the results.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from benchmarks.page_sentences import SENTENCES
from benchmarks.results_tables import TABLES, transfer
from benchmarks.sentences import ROOT, complaints, with_figures

RESULTS = ROOT / "docs" / "results"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
PICTURES = "results/pictures.json"  # of each picture of docs: which figure of which results, their digest, and its own
SECTION = re.compile(
    r"<!-- from docs/results/([\w-]+)\.json, (\S+): python -m benchmarks\.published -->\n.*?<!-- end -->", re.S
)


def with_results(page: Path) -> tuple[str, list[str]]:
    """Return a page with the tables and figures of the results files, and complaints about what these do not show."""
    name = page.relative_to(ROOT).as_posix()
    sentences = SENTENCES.get(name, ())
    text = with_figures(with_sections(page.read_text(encoding="utf-8")), sentences)
    return text, [f"{name}: {complaint}" for complaint in complaints(text, sentences)]


def with_sections(page: str) -> str:
    """Replace what stands between a page's markers by the tables of the results files that they name."""

    def section(found: re.Match[str]) -> str:
        study, what = found.groups()
        results = json.loads((RESULTS / f"{study}.json").read_text(encoding="utf-8"))
        marker = found.group(0).split("\n", 1)[0]
        table = TABLES[what](results) if what in TABLES else transfer(results, what)
        return f"{marker}\n{table}\n<!-- end -->"

    return SECTION.sub(section, page)


def record(given: Path) -> None:
    """Record an export under the name of its study."""
    results = json.loads(given.read_text(encoding="utf-8"))
    shutil.copyfile(given, RESULTS / f"{results['study']}.json")
    record_pictures(results, given.parent / "figures", ROOT / "docs")


def record_pictures(results: Mapping[str, Any], figures: Path, docs: Path) -> None:
    """Copy the figures of an export that pages show, and note their digests and those of what they are drawn from.

    Args:
        results: of the export.
        figures: its figures.
        docs: the folder of the pages.
    """
    index = docs / PICTURES
    document = json.loads(index.read_text(encoding="utf-8"))
    for name, picture in document["pictures"].items():
        if picture["results"] == results["study"]:
            shutil.copyfile(figures / f"{picture['figure']}.png", docs / name)
            picture["drawn_from"] = results["digests"][picture["of"]]
            picture["sha256"] = sha256((docs / name).read_bytes()).hexdigest()
    index.write_text(f"{json.dumps(document, indent=1)}\n", encoding="utf-8")


def main() -> None:
    """Record a study's results, if a file is given, and write tables and figures."""
    options = argparse.ArgumentParser(description=main.__doc__)
    options.add_argument("results", nargs="*", type=Path, help="results.json of an export")
    given = options.parse_args()
    for path in given.results:
        record(path)
    found = []
    for page in PAGES:
        text, of_page = with_results(page)
        page.write_text(text, encoding="utf-8")
        found += of_page
    sys.exit("\n".join(found) or 0)


if __name__ == "__main__":
    main()
