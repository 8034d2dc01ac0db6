"""Trial scores: the file of a champion's scores, and its reader."""

import json

import numpy as np
import pytest

from pipeline.stages.trial_scores import NO_CHAMPION, decode_scores, encode_scores

OF_ENSEMBLE = {"fitness": 2.5, "predicted": 3.0, "predicted_sd": 0.5, "zero_shot": 1.0, "zero_shot_com": 0.75}
ADAPTED = OF_ENSEMBLE | {"predicted_sd": None, "adapted": 4.0, "adapted_com": 3.5}
DIVERGED = ADAPTED | dict.fromkeys(("zero_shot", "zero_shot_com", "adapted", "adapted_com"))


@pytest.mark.parametrize("scores", [OF_ENSEMBLE, ADAPTED, DIVERGED, None])
def test_the_reader_is_the_inverse_of_the_writer(scores):
    assert decode_scores(encode_scores(scores), "trial-0") == scores


def test_the_file_tells_what_diverged_from_what_was_not_simulated():
    """Other programs read it: null where a rollout diverged or there is no σ, and no key where there is no value."""
    written = json.loads(encode_scores(ADAPTED | {"zero_shot": np.nan, "adapted": -np.inf}))
    assert written == ADAPTED | {"status": "ok", "zero_shot": None, "adapted": None}
    assert json.loads(encode_scores(OF_ENSEMBLE)).keys().isdisjoint({"adapted", "adapted_com"})
    assert json.loads(encode_scores(None)) == {"status": NO_CHAMPION}
