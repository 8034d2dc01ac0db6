import numpy as np
import pytest
from scores_of import scores_of

from tasks.analysis.scores import BEST, ScoredTrial, Scores, arm_name


def test_trials_come_in_the_order_of_their_numbers_with_their_replicates():
    trials = [
        ScoredTrial("residual_slush", 9.0, k, k % 2 + 5, zero_shot=z) for k, z in ((2, 2.0), (0, 0.0), (1, np.nan))
    ]
    found = Scores.of(trials).sample(("residual_slush", "zero_shot"), 9.0)
    assert (found.values.tolist(), found.replicate.tolist()) == ([0.0, 2.0], [5, 5])


def test_arms_are_listed_the_deepest_first_in_their_usual_order():
    table = scores_of({("dry_land", 1.0): [0], ("true_slush", 1.0): [0], ("dry_land", 9.0): [0]})
    assert table.arms() == [("dry_land", 9.0), ("true_slush", 1.0), ("dry_land", 1.0)]
    assert table.depths() == [1.0, 9.0]


@pytest.mark.parametrize(("arm", "name"), [(BEST, "True Slush"), (("dry_land", "adapted"), "Dry Land adapted")])
def test_names_of_arms(arm, name):
    assert arm_name(arm) == name
