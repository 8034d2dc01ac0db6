"""The results of a study in one small file."""

import json

import numpy as np
import pytest

from pipeline.results.recorded_study import open_study
from pipeline.results.results_json import results_of
from pipeline.stages import STAGES
from pipeline.stages.report import read_page


@pytest.fixture(scope="module")
def results(recorded):
    study = open_study("tiny", recorded)
    page = read_page(study.settings, study.upstream, study.store)
    return json.loads(json.dumps(results_of(study, page)))


def test_an_arm_has_the_mean_and_deviation_of_its_champions(results):
    assert {(arm["environment"], arm["depth"]) for arm in results["arms"]} == {
        (row["environment"], row["depth"]) for row in results["champions"]
    }
    for arm in results["arms"]:
        rows = [row for row in results["champions"] if row["environment"] == arm["environment"]]
        for quantity in {"predicted", "predicted_sd", "fitness", "zero_shot", "adapted"} & arm.keys():
            values = [row[quantity] for row in rows if row["depth"] == arm["depth"] and row[quantity] is not None]
            assert arm[quantity]["n"] == len(values)
            assert arm[quantity]["mean"] == pytest.approx(np.mean(values), abs=1e-4)
            if len(values) > 1:
                assert arm[quantity]["sd"] == pytest.approx(np.std(values, ddof=1), abs=1e-4)


def test_it_says_what_made_it(results):
    assert results["study"] == "tiny" and {"commit", "cpu", "torch"} <= results["made_with"].keys()
    names = [stage.name for stage in STAGES]
    assert list(results["core_seconds"]) == list(results["digests"]) == names
    assert len(set(results["digests"].values())) == len(names)


def test_it_is_small_and_repeats_the_tables(results, recorded):
    rows = open_study("tiny", recorded).table("paper").to_pandas()
    comparison = [(row["what"], row["verdict"]) for row in results["comparison"]]
    assert comparison == list(zip(rows.what, rows.verdict, strict=True))
    assert {row["name"] for row in results["accuracy"]} == {"mean", "mean - 1 sd"}
    assert len(json.dumps(results)) < 20_000
    learned = [row for row in results["champions"] if row["predicted_sd"] is not None]
    assert learned and results["penalty"] == 1
    for row in learned:
        assert row["fitness"] == pytest.approx(row["predicted"] - row["predicted_sd"], abs=2e-4)
