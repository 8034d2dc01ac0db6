import numpy as np
import pytest

from tasks.analysis.scores import Scores


def test_columns_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match=r"expected \(n_trials,\) for all"):
        Scores(np.array(["dry_land"]), np.zeros(2), np.zeros(2, int), np.zeros(2), np.zeros(2), np.zeros(2))


def test_trials_come_in_the_order_of_their_numbers():
    trial, zeros = np.array([2, 0, 1]), np.zeros(3)
    table = Scores(np.array(["dry_land"] * 3), np.full(3, 9.0), trial, zeros, trial.astype(float), zeros)
    assert table.values("dry_land", "zero_shot", 9.0).tolist() == [0.0, 1.0, 2.0]
    assert table.replicate.tolist() == [0, 0, 0]


def test_a_sample_has_the_replicates_of_its_finite_values():
    trial, zeros = np.array([2, 0, 1]), np.zeros(3)
    table = Scores(
        np.array(["residual_slush"] * 3), np.full(3, 9.0), trial, zeros, np.array([2, 0, np.nan]), zeros, trial % 2 + 5
    )
    found = table.sample("residual_slush", "zero_shot", 9.0)
    assert (found.values.tolist(), found.replicate.tolist()) == ([0.0, 2.0], [5, 5])
