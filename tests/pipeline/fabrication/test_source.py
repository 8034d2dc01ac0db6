"""The champion of a study that is proposed for a kit."""

import shutil

import numpy as np
import pytest

from pipeline.errors import PuddleError
from pipeline.fabrication.source import proposed
from pipeline.stages.transfer import read_scores
from pipeline.store.store import Store


def test_the_proposed_champion_of_a_study(study, settings):
    store, upstream = study
    source = proposed(settings, store)
    found = read_scores(settings, upstream["transfer"], store)
    trials = [trial for trial in found if trial.environment == "residual_slush"]
    zero_shot = np.array([found[trial].zero_shot for trial in trials])
    trial = trials[int(np.argmin(np.abs(zero_shot - zero_shot.mean())))]
    nearest = found[trial]
    assert source.name == f"tiny-trial-{trial.index}" and source.depth == 1.0
    assert len(source.predicted) == 2
    mean, deviation = np.mean(source.predicted), np.std(source.predicted)
    # The champion's fitness is μ - σ over the same members.
    assert mean - deviation == pytest.approx(nearest.fitness, abs=1e-6)
    assert (mean, deviation) == pytest.approx((nearest.predicted, nearest.predicted_sd), abs=1e-6)


@pytest.mark.parametrize("file", ["score.json", "champion.json"])
@pytest.mark.parametrize("spoil", [lambda good: good[:-2] + b"?\n", lambda good: good[:-1]])
def test_a_damaged_champion_is_reported_instead_of_proposing_another(file, spoil, study, settings, tmp_path):
    """A damaged trial would be missing from the mean."""
    store = Store(shutil.copytree(study[0].root, tmp_path / "store"))
    for path in store.root.glob(f"items/transfer/*/*/{file}"):
        path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(PuddleError) as told:
        proposed(settings, store)
    said = str(told.value)
    assert file in said and "nothing else is lost" in said
    assert f"`puddle verify --discard --store {store.root}`" in said and "`puddle study`" in said
