"""Trial scores: the file of a champion's scores, and its reader."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.stages.trial_scores import NO_CHAMPION, TrialScores, decode_scores, encode_scores

OF_ENSEMBLE = TrialScores(fitness=2.5, predicted=3.0, predicted_sd=0.5, zero_shot=1.0, zero_shot_com=0.75)
ADAPTED = replace(OF_ENSEMBLE, predicted_sd=None, adapted=4.0, adapted_com=3.5)
DIVERGED = replace(ADAPTED, zero_shot=np.nan, zero_shot_com=np.nan, adapted=np.nan, adapted_com=np.nan)


OF_OBJECTIVE = replace(ADAPTED, predicted_score=0.5, zero_shot_score=0.25, adapted_score=np.nan)


@pytest.mark.parametrize("scores", [OF_ENSEMBLE, ADAPTED, DIVERGED, OF_OBJECTIVE, None])
def test_the_reader_is_the_inverse_of_the_writer(scores):
    assert repr(decode_scores(encode_scores(scores), "trial-0")) == repr(scores)  # NaN differs from itself


def test_the_file_tells_what_diverged_from_what_was_not_simulated():
    """Other programs read it: null where a rollout diverged or there is no σ, and no key where there is no value."""
    assert json.loads(encode_scores(DIVERGED)) == {
        "status": "ok",
        "fitness": 2.5,
        "predicted": 3.0,
        **dict.fromkeys(("predicted_sd", "zero_shot", "zero_shot_com", "adapted", "adapted_com")),
    }
    assert json.loads(encode_scores(OF_ENSEMBLE)).keys().isdisjoint({"adapted", "adapted_com"})
    assert json.loads(encode_scores(None)) == {"status": NO_CHAMPION}


def test_what_is_missing_or_diverged_is_none():
    assert [one.by_name()["zero_shot"] for one in (OF_ENSEMBLE, DIVERGED)] == [1.0, None]
    assert [one.by_name()["adapted"] for one in (OF_ENSEMBLE, ADAPTED)] == [None, 4.0]
