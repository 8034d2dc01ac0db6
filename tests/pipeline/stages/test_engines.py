"""Studies with another engine: champions scored there too, and a target that is a part of one."""

import sys

import numpy as np
import pytest
from command_line import WITHOUT_MLFLOW, call, refused

from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.results.recorded_study import open_study
from pipeline.stages.analyse import ANALYSE
from pipeline.stages.transfer import TRANSFER
from pipeline.store.design_file import save_design
from tasks.residual.throws import throw
from tasks.simulation import simulate
from tasks.world import TrueSlush

SETTINGS = """
name: engines
grid: {depths: [1.0], environments: [true_slush, dry_land], single_member_depths: [], n_trials: 2}
rollout: {n_settle: 5, n_measure: 31}
evolution: {n_generations: 2, afpo: {population_size: 4}}
transfer: {n_generations: 2, adapted_environments: [dry_land]}
assess: {n_designs: 4}
"""
STEPS = {"n_settle": 5, "n_measure": 31}
BOTH = ["transfer.engines=[batch,mujoco]"]


def studied_in(folder, name, overrides):
    (folder / "settings.yaml").write_text(SETTINGS)
    given = [argument for override in overrides for argument in ("--set", override)]
    where = ["--settings", str(folder / "settings.yaml"), "--store", str(folder / "store"), "--workers", "0"]
    assert call("study", *where, *given, *WITHOUT_MLFLOW) == 0
    return open_study(name, folder / "store")


@pytest.fixture(scope="module")
def studied(tmp_path_factory):
    return studied_in(tmp_path_factory.mktemp("engines"), "engines", BOTH)


def test_champions_are_scored_in_each_engine(studied):
    """Means over trials are those of simulations by hand, and Box2D's are the study's usual scores."""
    table = studied.table("engines").to_pylist()
    arms = [(row["environment"], row["engine"]) for row in table]
    assert arms == [(of, engine) for of in ("true_slush", "dry_land") for engine in ("Box2D", "mujoco")]
    for row in table:
        engine = row["engine"].replace("Box2D", "batch")
        champions = [studied.champion(row["environment"], depth=1.0, trial=trial) for trial in range(2)]
        by_hand = [simulate(one, TrueSlush(1.0), engine=engine, **STEPS).displacement[0] for one in champions]
        assert row["zero_shot"] == pytest.approx(np.mean(by_hand))
        assert np.isfinite(row["adapted"]) == (row["environment"] == "dry_land")
    assert table[0]["alike"] == 2 and table[0]["zero_shot"] != table[1]["zero_shot"]


def test_without_other_engines_nothing_is_new():
    """The specification of an item, which decides its key, and the tables are those of before."""
    plain, both = (parse(Settings, SETTINGS, name="engines", overrides=given) for given in ([], BOTH))
    specs = [TRANSFER.plan(settings)[0].spec for settings in (plain, both)]
    assert {*vars(specs[1])} - {*vars(specs[0])} == {"engines"}
    tables = [{chain.label for chain in ANALYSE.plan(settings)} for settings in (plain, both)]
    assert tables[1] - tables[0] == {"engines"}


def test_a_package_that_is_missing_is_named_before_the_study_begins(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    store = tmp_path / "store"
    for asked in (*BOTH, "target=mujoco_fluid"):
        said = refused(capsys, "study", "--preset", "smoke", "--store", str(store), "--set", asked)
        assert "run `make setup EXTRAS=mujoco`" in said and not store.exists()


def test_bars_are_thrown_and_robots_scored_in_the_target_s_engine(tmp_path):
    overrides = ["target=mujoco_fluid", "throws={n_throws: 4, n_steps: 6}", "training={n_iterations: 10}"]
    overrides += ["network={hidden_layers: 1, width: 4}", "ensemble.n_members=1", "evolution.afpo.population_size=2"]
    overrides += ["grid.environments=[mujoco_fluid,residual_slush]", "grid.n_trials=1", "name=fluid"]
    study = studied_in(tmp_path, "fluid", overrides)
    thrown = study.table("transitions")
    by_hand = throw("mujoco_fluid", study.settings.throws, seed=study.settings.seed)
    np.testing.assert_array_equal(np.stack(thrown["residual"].to_numpy()), by_hand.residual)
    (row,) = (row for row in study.champions().to_pylist() if row["environment"] == "residual_slush")
    champion = study.champion("residual_slush", depth=1.0, trial=0)
    assert row["zero_shot"] == pytest.approx(simulate(champion, "mujoco_fluid", depth=1.0, **STEPS).displacement[0])


def test_a_film_is_of_the_engine_asked_for(studied, tmp_path):
    save_design(studied.champion("dry_land", depth=1.0, trial=0), tmp_path / "d.json")
    settings = ("--preset", "smoke", "--set", "rollout.n_measure=30", "--depth", "1")
    for engine in ("batch", "mujoco"):
        film = ("--engine", engine, "--out", str(tmp_path / f"{engine}.gif"))
        assert call("simulate", str(tmp_path / "d.json"), *settings, *film) == 0
    assert (tmp_path / "batch.gif").read_bytes() != (tmp_path / "mujoco.gif").read_bytes()
