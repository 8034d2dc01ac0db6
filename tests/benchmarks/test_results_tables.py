"""Tables that are written from results files."""

import numpy as np
import pytest

from benchmarks.recorded_tables import kernels
from benchmarks.results_tables import comparison, made_with, t_tests, transfer, variance
from benchmarks.tracks_tables import share_of


def test_predictions_of_ensembles_have_their_deviation_and_what_evolution_maximised():
    def moments(mean, sd=0.5):
        return {"n": 10, "mean": mean, "sd": sd}

    rows = {"depth": 2.0, "zero_shot": moments(-4.0), "adapted": moments(5.0)}
    arms = [
        {"environment": "true_slush", **rows, "predicted": moments(5.0), "zero_shot": moments(5.0)},
        {"environment": "single_member", **rows, "predicted": moments(9.0), "fitness": moments(9.0)},
        {
            "environment": "residual_slush",
            **rows,
            **{"predicted": moments(6.0), "predicted_sd": moments(1.25), "fitness": moments(3.5)},
        },
    ]
    heading, _, best, ensemble, single = transfer({"version": 2, "penalty": 2.0, "arms": arms}, "2m").splitlines()
    assert heading.startswith("| evolved in | predicted, μ | σ | μ − 2σ | zero-shot | adapted |")
    assert best.startswith("| True Slush, *E* |  |  |  | 5.0 ± 0.5 |")
    assert ensemble.startswith(
        "| Residual Slush, *Ê* | 6.0 ± 0.5 | 1.2 | 3.5 | −4.0 ± 0.5 | 5.0 ± 0.5 | −80 %, 100 % |"
    )
    assert single.startswith("| Single member, *Ê₁* | 9.0 ± 0.5 |  |  | −4.0")


def test_the_papers_results_stand_beside_the_studys():
    row = {"what": "a ratio", "paper": "-6%", "this_run": "-1%", "interval": "-3% to 2%", "verdict": "agrees"}
    test = {**row, "what": "Student's t at 9 m"}
    table = comparison({"comparison": [row, test, {**row, "this_run": "-"}]}).splitlines()
    assert table[2:] == ["| a ratio | −6 % | −1 % (−3 % to 2 %) | agrees |"]
    table = t_tests({"comparison": [row, {**test, "interval": "difference -1.0 to 2.0 m, at 99.8%"}]}).splitlines()
    assert table[2:] == ["| at 9 m | −6 % | −1 % | difference −1.0 to 2.0 m, at 99.8 % | agrees |"]


def test_a_share_is_of_the_means_of_data_sets_which_are_pairs():
    rng = np.random.default_rng(1)
    exact = rng.normal(8.0, 2.0, (8, 2))
    assert share_of({"data_sets": 8, "displacement": (0.9 * exact).ravel()}, {"displacement": exact.ravel()}).words == (
        "90 % (90 % to 90 %)"
    )
    within = exact + np.array([-1.0, 1.0])  # what trials of a data set differ by does not count
    assert share_of({"data_sets": 8, "displacement": within.ravel()}, {"displacement": exact.ravel()}).words == (
        "100 % (100 % to 100 %)"
    )


def test_19_of_20_intervals_of_a_share_hold_it():
    rng, n_studies, n_held = np.random.default_rng(2), 400, 0
    for _ in range(n_studies):
        of_data_set = rng.normal(8.0, 2.0, (8, 1))  # throws and networks that both rows share
        exact, tracks = (share * (of_data_set + rng.normal(0.0, 1.0, (8, 2))) for share in (1.0, 0.9))
        found = share_of({"data_sets": 8, "displacement": tracks.ravel()}, {"displacement": exact.ravel()})
        n_held += found.low <= 0.9 <= found.high
    assert n_held == pytest.approx(0.95 * n_studies, abs=4 * (0.95 * 0.05 * n_studies) ** 0.5)


def test_the_variance_between_replicates_has_its_share():
    share = {"share_between": 0.25, "share_between_low": 0.0, "share_between_high": 0.98}
    row = {"environment": "residual_slush", "depth": 9.0, "quantity": "zero_shot", "n": 10, "n_replicates": 2}
    known, unknown = ({**row, "sd_between": x, "sd_within": x, **share} for x in (1.5, None))
    unknown["share_between"] = None
    lines = variance({"variance": [known, unknown]}).splitlines()
    assert lines[2] == "| Residual Slush | 9 | zero-shot | 10 | 2 | 1.5 | 1.5 | 25 % (0 % to 98 %) |"
    assert lines[3].endswith("| 2 |  |  |  |")


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (
            {"commit": f"0123456{'f' * 33}", "cpu": "A", "python": "3.11.7"},
            "Measured at commit 0123456, on A, Python 3.11.7.",
        ),
        ({"commit": "0123456-dirty"}, "Measured at commit 0123456 with changes."),
        (
            {"commit": "0123456", "preset at": "789abcd"},
            "Measured at commit 0123456, with the preset as it is at 789abcd.",
        ),
    ],
)
def test_pages_say_what_results_were_made_with(made, words):
    assert made_with({"made_with": made}) == words


def test_what_no_kernel_takes_is_the_rest_of_a_generation():
    dry = {
        "environment": "Dry Land",
        "seconds": 0.0104,
        "shares": {"base simulator": 0.75, "networks": 0.0},
        "gflop": 0,
    }
    learned = {"environment": "Ê", "seconds": 0.1, "shares": {"base simulator": 0.3, "networks": 0.5}, "gflop": 12.0}
    assert kernels({"peak_gflops": 300, "rows": [dry, learned]}).splitlines() == [
        "| evolved in | a generation | base simulator | networks | the rest | networks, of the fp32 peak |",
        "|---|--:|--:|--:|--:|--:|",
        "| Dry Land | 10.4 ms | 75 % | 0 % | 25 % |  |",
        "| Ê | 100.0 ms | 30 % | 50 % | 20 % | 80 % |",  # 12 GFLOP in 50 ms are 240 GFLOP/s
    ]
