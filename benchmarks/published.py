"""Write tables and figures of results in README.md and docs from docs/results/*.json: `python -m benchmarks.published`.

A results file is the ``results.json`` of `puddle export`. `python -m benchmarks.published EXPORT/results.json` records
one first, under the name of its study, and the figures of the export that docs/results/pictures.json names. `--add-to
STUDY EXPORT/results.json` adds its depths to those recorded for a study that is run one depth at a time.

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
from tasks.analysis import paper

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


def with_part(results: Mapping[str, Any], part: Mapping[str, Any], study: str) -> dict[str, Any]:
    """Add the results of some depths to those of a study that is run one depth at a time.

    Args:
        results: of the study so far; empty if there are none.
        part: results of a run with the same settings at other depths, or at some of the same.
        study: name of the study.

    Returns:
        The results of the study, with the part's where both have some.
    """
    depths = {arm["depth"] for arm in part["arms"]}
    joined = {
        name: sorted(
            [*(row for row in results.get(name, ()) if row["depth"] not in depths), *part[name]],
            key=lambda row: row["depth"],
        )
        for name in ("arms", "champions", "variance")
    }
    about = {name: part[name] for name in ("source", "made_with", "core_seconds", "digests")}
    assessed = paper.DEPTH in depths or not results.get("accuracy")
    return {
        "schema": part["schema"],
        "version": part["version"],
        "study": study,
        "parts": {**results.get("parts", {}), part["study"]: about},
        "n_replicates": part["n_replicates"],
        "penalty": part["penalty"],
        "arms": joined["arms"],
        "accuracy": part["accuracy"] if assessed else results["accuracy"],
        "variance": joined["variance"],
        "champions": joined["champions"],
    }


def record(given: Path, study: str | None) -> None:
    """Record an export under the name of its study, or add its depths to a study of another name."""
    if study is None:
        results = json.loads(given.read_text(encoding="utf-8"))
        shutil.copyfile(given, RESULTS / f"{results['study']}.json")
        record_pictures(results, given.parent / "figures", ROOT / "docs")
        return
    file = RESULTS / f"{study}.json"
    so_far = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    document = with_part(so_far, json.loads(given.read_text(encoding="utf-8")), study)
    file.write_text(f"{json.dumps(document, indent=1, ensure_ascii=False)}\n", encoding="utf-8")


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
    options.add_argument("--add-to", metavar="STUDY", help="study that these are depths of")
    given = options.parse_args()
    for path in given.results:
        record(path, given.add_to)
    found = []
    for page in PAGES:
        text, of_page = with_results(page)
        page.write_text(text, encoding="utf-8")
        found += of_page
    sys.exit("\n".join(found) or 0)


if __name__ == "__main__":
    main()
