"""Published results: files that grow depth by depth, and what an export records."""

import hashlib
import json

from benchmarks.published import PICTURES, record_pictures, with_part


def export(name, depth, zero_shot, accuracy=()):
    rows = {"environment": "true_slush", "depth": depth}
    return {
        "schema": "puddle.results",
        "version": 2,
        "study": name,
        "source": "configs/desk.yaml",
        "made_with": {"python": "3.11"},
        "core_seconds": {"evolve": 1.0},
        "digests": {"evolve": name},
        "arms": [{**rows, "zero_shot": {"n": 1, "mean": zero_shot, "sd": None}}],
        "n_replicates": 2,
        "penalty": 1.0,
        "accuracy": list(accuracy),
        "variance": [{**rows, "quantity": "zero_shot", "sd_within": 1.0}],
        "champions": [{**rows, "trial": 0, "zero_shot": zero_shot}],
    }


def test_depths_are_added_in_order_and_replaced_where_they_were_run_again():
    found = with_part({}, export("desk-9m", 9.0, 17.0, ["of 9 m"]), "desk")
    found = with_part(found, export("desk-2m", 2.0, 25.0, ["of 2 m"]), "desk")
    assert [arm["depth"] for arm in found["arms"]] == [2.0, 9.0] and found["accuracy"] == ["of 9 m"]
    found = with_part(found, export("desk-2m", 2.0, 26.0), "desk")
    assert [champion["zero_shot"] for champion in found["champions"]] == [26.0, 17.0]
    assert [row["depth"] for row in found["variance"]] == [2.0, 9.0] and found["n_replicates"] == 2
    assert list(found["parts"]) == ["desk-9m", "desk-2m"] and found["study"] == "desk"


def test_recording_an_export_takes_the_pictures_that_pages_show(tmp_path):
    docs, figures = tmp_path / "docs", tmp_path / "figures"
    (docs / "results").mkdir(parents=True)
    figures.mkdir()
    (figures / "bars.png").write_bytes(b"new")
    stale = {"results": "laptop", "figure": "bars", "of": "analyse", "drawn_from": "old", "sha256": "older"}
    others = {**stale, "results": "row"}
    of_new = hashlib.sha256(b"new").hexdigest()
    document = {"pictures": {"laptop_bars.png": stale, "row_bars.png": others}}
    (docs / PICTURES).write_text(json.dumps(document))
    record_pictures({"study": "laptop", "digests": {"analyse": "d1"}}, figures, docs)
    found = json.loads((docs / PICTURES).read_text())["pictures"]
    assert (docs / "laptop_bars.png").read_bytes() == b"new"
    assert found == {"laptop_bars.png": {**stale, "drawn_from": "d1", "sha256": of_new}, "row_bars.png": others}
