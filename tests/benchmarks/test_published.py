"""Published results: files that grow depth by depth, and tables that are written from them."""

import hashlib
import json

import pytest

from benchmarks.published import PICTURES, few_throws, made_with, members, record_pictures, rounds, with_part


def export(name, depth, zero_shot, accuracy=()):
    rows = {"environment": "true_slush", "depth": depth}
    return {
        "schema": "puddle.results",
        "version": 1,
        "study": name,
        "source": "configs/desk.yaml",
        "made_with": {"python": "3.11"},
        "core_seconds": {"evolve": 1.0},
        "digests": {"evolve": name},
        "arms": [{**rows, "zero_shot": {"n": 1, "mean": zero_shot, "sd": None}}],
        "accuracy": list(accuracy),
        "champions": [{**rows, "trial": 0, "zero_shot": zero_shot}],
    }


def test_depths_are_added_in_order_and_replaced_where_they_were_run_again():
    found = with_part({}, export("desk-9m", 9.0, 17.0, ["of 9 m"]), "desk")
    found = with_part(found, export("desk-2m", 2.0, 25.0, ["of 2 m"]), "desk")
    assert [arm["depth"] for arm in found["arms"]] == [2.0, 9.0] and found["accuracy"] == ["of 9 m"]
    found = with_part(found, export("desk-2m", 2.0, 26.0), "desk")
    assert [champion["zero_shot"] for champion in found["champions"]] == [26.0, 17.0]
    assert list(found["parts"]) == ["desk-9m", "desk-2m"] and found["study"] == "desk"


@pytest.fixture
def studies():
    def arm(environment, zero_shot):
        moments = {name: {"n": 6, "mean": zero_shot, "sd": 1.0} for name in ("predicted", "zero_shot", "adapted")}
        return {"environment": environment, "depth": 9.0, **moments}

    champions = [{"environment": "designed_throws", "trial": k, "zero_shot": 5.0 + k % 3} for k in range(6)]
    study = {"arms": [arm("true_slush", 10.0), arm("designed_throws", 6.0)], "champions": champions, "n_replicates": 3}
    fit = {"learned_from": "designed_throws", "name": "mean", "r": 0.9, "slope": 1.1}
    few = {**study, "series": "few throws", "variant": "25 × 200", "accuracy": []}
    return {"studies": [few, {**study, "series": "members", "variant": "2", "accuracy": [fit]}]}


def test_shares_are_of_each_data_set(studies):
    row = few_throws(studies).splitlines()[2]
    assert row == "| 25 × 200 | robots | 6 | 6.0 ± 1.0 | 6.0 ± 1.0 | 6.0 ± 1.0 | 50 %, 60 %, 70 % | 60 % |"


def test_accuracy_stands_beside_the_arm_whose_ensemble_it_is_of(studies):
    assert members(studies).splitlines()[2].endswith("| 50 %, 60 %, 70 % | 60 % | 0.90 | 1.10 |")


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


def test_rounds_are_means_over_data_sets():
    rows = [
        {"n_throws": 100, "n_rounds": 2, "error": [0.1 + 0.2 * k, 0.5, 0.5], "zero_shot": [4.0, 6.0 + k]}
        for k in (0, 1)
    ]
    (row,) = rounds({"in_true_slush": [10.0, 11.0], "rows": rows}).splitlines()[2:]
    assert row == "| 100 | 2 | 0.20 0.50 0.50 | 5.0, 5.5 | 50 % |"


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (
            {"commit": f"0123456{'f' * 33}", "cpu": "A", "python": "3.11.7"},
            "Measured at commit 0123456, on A, Python 3.11.7.",
        ),
        ({"commit": "0123456-dirty"}, "Measured at commit 0123456 with changes."),
        ({"commit": "0123456-dirty", "recorded at": "789abcd"}, "Recorded at commit 789abcd."),
        (
            {"commit": "0123456", "preset at": "789abcd"},
            "Measured at commit 0123456, with the preset as it is at 789abcd.",
        ),
    ],
)
def test_pages_say_what_results_were_made_with(made, words):
    assert made_with({"made_with": made}) == words
