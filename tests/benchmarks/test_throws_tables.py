"""Tables of docs/throws.md."""

import pytest

from benchmarks.throws_tables import exploiters, few_throws, members, regularisation, rounds, rules


@pytest.fixture
def studies():
    def arm(environment, zero_shot):
        moments = {name: {"n": 6, "mean": zero_shot, "sd": 1.0} for name in ("predicted", "zero_shot", "adapted")}
        return {"environment": environment, "depth": 9.0, **moments}

    champions = [
        {"environment": "designed_throws", "trial": k, "predicted": 11.0, "zero_shot": 5.0 + k % 3} for k in range(6)
    ] + [{"environment": "true_slush", "trial": k, "predicted": None, "zero_shot": 10.0} for k in range(6)]
    study = {"arms": [arm("true_slush", 10.0), arm("designed_throws", 6.0)], "champions": champions, "n_replicates": 3}
    fit = {"learned_from": "designed_throws", "name": "mean", "r": 0.9, "slope": 1.1}
    few = {**study, "series": "few throws", "variant": "25 × 200", "accuracy": []}
    return {"studies": [few, {**study, "series": "members", "variant": "2", "accuracy": [fit]}]}


def test_shares_are_of_each_data_set(studies):
    row = few_throws(studies).splitlines()[2]
    assert row == "| 25 × 200 | robots | 6 | 6.0 ± 1.0 | 6.0 ± 1.0 | 2 of 6 | 6.0 ± 1.0 | 50 %, 60 %, 70 % | 60 % |"


def test_accuracy_stands_beside_the_arm_whose_ensemble_it_is_of(studies):
    assert members(studies).splitlines()[2].endswith("| 50 %, 60 %, 70 % | 60 % | 0.90 | 1.10 |")


def test_exploiters_travel_less_than_half_of_their_prediction(studies):
    assert "| 6.0 ± 1.0 | 6.0 ± 1.0 | 2 of 6 | 6.0 ± 1.0 |" in members(studies).splitlines()[2]
    assert exploiters([(4.0, 2.0), (4.0, 1.9), (4.0, None)]) == "2 of 3"


def test_rules_have_their_shares_and_the_calibrated_k_of_each_data_set():
    row = {"arm": "designed_throws", "rule": "μ − k σ, k calibrated", "predicted": [4.0, 6.0]}
    rows = [{**row, "zero_shot": [4.0, 2.0], "k": 0.68}, {**row, "zero_shot": [6.0, 6.0], "k": 1.0}]
    line, _, best = rules({"in_true_slush": [5.0, 7.0], "rows": rows}).splitlines()[2:]
    figures = "| 5.0 ± 1.2 | 4.5 ± 1.9 | 1 of 4 | 50 %, 100 % | 75 % |"
    assert line == f"| μ − k σ, k calibrated (0.7, 1.0) | Designed throws {figures}"
    assert best == "*E* travels 6.0 ± 1.4 m (n = 2)."


def test_regularisation_shows_the_mean_and_the_range_over_networks():
    row = {"dropout": 0.001, "weight_decay": 0.0, "errors_of_networks": {"9": [[0.1, 0.2, 0.3], [0.3, 0.4, 0.5]]}}
    assert (
        regularisation({"regularisation": {"rows": [row]}}).splitlines()[2] == "| 0.001 | 0 | 0.300 (0.200 to 0.400) |"
    )


def test_rounds_are_means_over_data_sets():
    rows = [
        {"n_throws": 100, "n_rounds": 2, "error": [0.1 + 0.2 * k, 0.5, 0.5], "zero_shot": [4.0, 6.0 + k]}
        for k in (0, 1)
    ]
    row, _, best = rounds({"in_true_slush": [10.0, 11.0], "rows": rows}).splitlines()[2:]
    assert row == "| 100 | 2 | 0.20 0.50 0.50 | 5.0, 5.5 | 50 % |"
    assert best == "*E* travels 10.5 ± 0.7 m (n = 2)."
