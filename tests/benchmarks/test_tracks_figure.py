"""The picture of docs/your-own-tank.md is that of its results file."""

import json

from benchmarks.published import RESULTS
from benchmarks.sentences import ROOT
from benchmarks.tracks_figure import PICTURE, tracks_accuracy

RESULTS_FILE = RESULTS / "tracks-rollouts.json"


def test_the_picture_is_drawn_from_its_results_file():
    drawn = tracks_accuracy(json.loads(RESULTS_FILE.read_text(encoding="utf-8")))
    assert drawn.png == (ROOT / "docs" / PICTURE).read_bytes()


def test_another_result_makes_another_picture():
    results = json.loads(RESULTS_FILE.read_text(encoding="utf-8"))
    row = next(row for row in results["studies"] if row["learned_from"] == "tracks" and row["noise_mm"] == 2)
    row["displacement"] = [2 * metres for metres in row["displacement"]]
    assert tracks_accuracy(results).png != (ROOT / "docs" / PICTURE).read_bytes()
