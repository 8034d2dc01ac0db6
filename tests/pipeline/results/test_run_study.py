"""A study run from Python: it is the command's, its progress is shown, mistakes are named, and a stop is resumed."""

import io
import sys

import numpy as np
import pytest
from small_study import ON_DRY_LAND

import puddle
from pipeline.store.store import Store

ARM = {"evolution": {"n_generations": np.int64(6), "afpo": {"population_size": 4}}, "seed": 3}


class Interrupted(io.StringIO):
    """A notebook whose user stops the call when evolution begins."""

    def write(self, text):
        if "evolve" in text:
            raise KeyboardInterrupt
        return super().write(text)


@pytest.fixture
def study_file(tmp_path, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:1")  # seconds less without MLflow
    monkeypatch.setenv("FORCE_COLOR", "1")  # as notebooks do
    (tmp_path / "tiny.yaml").write_text(ON_DRY_LAND)
    return tmp_path / "tiny.yaml"


def test_a_stopped_study_is_resumed_by_the_same_call(study_file, monkeypatch, capsys):
    call = {"store": study_file.parent / "store", "workers": 0, **ARM}
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt, match="the same call resumes"):
        patch.setattr(sys, "stderr", Interrupted())
        puddle.run_study(study_file, **call)
    store = Store.open(study_file.parent / "store", create=False)
    with store.lock_study("tiny"):  # nobody runs it any more
        pass
    study = puddle.run_study(study_file, **call)
    said = capsys.readouterr()
    assert "stage 3 of 8, evolve: 100%" in said.err and "\x1b" not in said.err and not said.out
    assert all(one.missing == one.failed == 0 for one in study.progress.values())
    assert (study.settings.seed, study.settings.evolution.n_generations) == (3, 6)
    assert study.settings.grid.environments == ("dry_land",)  # of the file
    assert len(study.champions()) == 1


@pytest.mark.parametrize(
    ("preset", "settings", "said"),
    [
        ("smok", {}, "preset 'smok': expected one of .*; did you mean smoke"),
        ("none.yaml", {}, "none.yaml: expected a settings file"),
        ("smoke", {"grid": {"dephts": [1]}}, "grid.dephts: unknown setting; did you mean grid.depths"),
        ("smoke", {"grid.depths": [-1.0]}, "depths.*: expected greater than or equal to 0, got -1"),
        ("smoke", {"physics": puddle.Physics(gravity=1.0), "seed": object()}, "seed: expected a valid integer"),
        ("smoke", {"store": "/dev/null/store", "workers": 0}, "/dev/null"),  # found by the study's process
    ],
)
def test_a_mistake_is_named(preset, settings, said, tmp_path):
    with pytest.raises(puddle.PuddleError, match=said):
        puddle.run_study(preset, **{"store": tmp_path / "store", **settings})
    assert not (tmp_path / "store").exists()
