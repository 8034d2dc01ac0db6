"""Messages about designs that diverged, from tables made by hand."""

import numpy as np
import pytest

from pipeline.stages.divergence import in_adaptation, in_assessment, in_transfer, in_trial, somewhere
from pipeline.stages.segments import DRAWN, REJECTED
from pipeline.stages.trial_scores import NO_CHAMPION
from tasks.evolution import OPERATORS


def curve(n_diverged: list[int], *, best: float = 1.0) -> dict[str, np.ndarray]:
    """Make the curve of a trial with 500 designs a generation from generation 7 on, and 40 rejected draws each."""
    n = len(n_diverged)
    columns = {"generation": 7 + np.arange(n), "n_diverged": np.array(n_diverged), "best_fitness": np.full(n, best)}
    draws = {"random": (140, 40), "mutation": (300, 0), "crossover": (100, 0)}
    for name in OPERATORS:
        columns[DRAWN + name], columns[REJECTED + name] = (np.full(n, count) for count in draws[name])
    return columns


@pytest.mark.parametrize(
    ("describe", "n_diverged", "best", "said"),
    [
        (in_trial, [0, 0, 0], 1.0, None),
        (in_trial, [0, 3, 9], 1.0, "12 of 1,500 designs diverged and were discarded; the first in generation 8"),
        (in_trial, [1, 0], 1.0, "1 of 1,000 designs diverged and was discarded; in generation 7"),
        (in_trial, [500, 499], -3.0, "999 of 1,000 designs diverged and were discarded; the first in generation 7"),
        (in_trial, [500, 500], -np.inf, NO_CHAMPION),
        (
            in_adaptation,
            [0, 1],
            1.0,
            "1 of 1,000 designs of the adaptation diverged and was discarded; in generation 8",
        ),
        (in_adaptation, [500], -np.inf, "not adapted: every design of the adaptation diverged"),
    ],
)
def test_trials_and_adaptations(describe, n_diverged, best, said):
    assert describe(curve(n_diverged, best=best)) == said


@pytest.mark.parametrize(
    ("scores", "said"),
    [
        ({"zero_shot": 1.0}, None),
        ({"zero_shot": 1.0, "adapted": 2.0}, None),
        ({"zero_shot": None, "adapted": 2.0}, "the champion diverged in the target"),
        ({"zero_shot": 1.0, "adapted": None}, "the adapted champion diverged in the target"),
        (None, None),  # it is left to evolution
    ],
)
def test_transfers(scores, said):
    assert in_transfer(scores) == said


def test_assessments_count_each_design_once():
    true, predicted = np.arange(4.0), np.arange(8.0).reshape(4, 2)
    assert in_assessment({"true": true, "predicted": predicted}) is None
    true[0], predicted[0, 1], predicted[2, 1] = np.nan, np.nan, np.inf
    assert somewhere({"true": true, "predicted": predicted}).tolist() == [True, False, True, False]
    said = in_assessment({"true": true, "predicted": predicted})
    assert said == "2 of 4 designs diverged, in the target or under a member"
