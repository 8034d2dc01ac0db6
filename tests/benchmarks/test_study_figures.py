"""Pictures of docs that are drawn from results files."""

import json

from benchmarks.published import RESULTS
from benchmarks.study_figures import pictures, report_of

_SIZE = slice(16, 24)  # width and height in a PNG; fonts may differ between machines


def test_docs_hold_the_pictures_that_results_files_give() -> None:
    found = pictures()
    assert "transfer_desk.png" in found
    for name, png in found.items():
        assert (RESULTS.parent / name).read_bytes()[_SIZE] == png[_SIZE]


def test_a_report_has_every_champion_of_a_results_file() -> None:
    results = json.loads((RESULTS / "desk.json").read_text(encoding="utf-8"))
    found = [(trial.environment, trial.depth, trial.trial, trial.zero_shot) for trial in report_of(results).trials]
    names = ("environment", "depth", "trial", "zero_shot")
    assert found == [tuple(champion[name] for name in names) for champion in results["champions"]]
