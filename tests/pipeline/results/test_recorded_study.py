"""A recorded study, read back: its progress, tables, champions and networks, and what is refused."""

import shutil
from dataclasses import replace

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from small_study import run, tiny

import puddle
from pipeline.cluster import serial_cluster
from pipeline.commands.status import study_status
from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.results.recorded_study import CHAMPIONS, StageProgress, open_study
from pipeline.results.study_tables import KEYS, SOURCES
from pipeline.stages import STAGES
from pipeline.stages.report import read_page
from pipeline.store.design_file import design_json
from pipeline.store.store import FailedChain, Store
from tasks.evolution import OPERATORS
from tasks.simulation import simulate
from tasks.world import TrueSlush

N_TRIALS, POPULATION, N_GENERATIONS = 2, 4, 4
ARMS = ("true_slush", "dry_land", "residual_slush", "single_member")


@pytest.fixture(scope="module")
def opened(recorded):
    return puddle.open_study("tiny", store=str(recorded))


@pytest.fixture
def store(recorded, tmp_path) -> Store:
    """A copy of the store, to be changed."""
    return Store.open(shutil.copytree(recorded, tmp_path / "store"), create=False)


def record_settings(store: Store, settings: dict) -> None:
    store.write_study(replace(store.read_study("tiny"), settings=settings))


def test_settings_and_progress_are_those_of_the_record(opened, settings):
    assert opened.settings == settings and opened.name == "tiny"
    assert list(opened.progress) == [stage.name for stage in STAGES]
    assert opened.progress["collect"] == StageProgress(done=3, failed=0, missing=0)
    assert opened.progress["evolve"] == StageProgress(done=2 * len(ARMS) * N_TRIALS, failed=0, missing=0)


def test_a_study_is_shown_by_its_progress_and_its_table(opened, settings):
    shown, html = repr(opened), opened._repr_html_()
    assert "evolve 16 of 16" in shown and "champions, histories" in shown and len(shown) < 600
    assert html.count("<tr>") == 1 + len(ARMS) and "Residual Slush" in html and "zero-shot [m]" in html
    assert "Ensemble(2 plain networks" in repr(opened.ensemble())
    assert max(len(repr(value)) for value in (opened.record, opened.settings, opened.progress)) < 1500


def test_networks_that_learn_without_a_study_are_those_of_the_study(opened, settings):
    throws = puddle.throw("true_slush", settings.throws, seed=settings.seed)
    of = {"network": settings.network, "training": settings.training, "seed": settings.seed}
    learned, studied = puddle.learn(throws, n_members=2, **of), opened.ensemble()
    for ours, theirs in zip((*learned.weights, *learned.biases), (*studied.weights, *studied.biases), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    for environment in (puddle.DryLand(1.0), puddle.ResidualSlush(1.0, learned), "randomised_slush"):
        with pytest.raises(ValueError, match="environment: expected one with one medium"):
            puddle.throw(environment)


def test_progress_tells_failed_from_missing(store):
    record = store.read_study("tiny")
    evolved = [item for item in record.items if item.stage == "evolve"]
    of_two = [item for item in evolved if item.label.startswith(("true_slush/1m/trial-0#1", "dry_land/1m/trial-1#1"))]
    for item in of_two:  # the second segment of both trials
        store.discard(item.stage, item.key)
    store.write_study(replace(record, failed=(FailedChain("evolve", "true_slush/1m/trial-0", "its worker died"),)))
    found = open_study("tiny", store.root).progress
    assert found["evolve"] == StageProgress(done=14, failed=1, missing=1)
    assert found["collect"].missing == found["train"].missing == 0


def test_what_is_on_record_is_read_although_something_before_it_was_lost(store, opened):
    lost = (("evolve", "true_slush/1m/trial-0#0"), ("train", "residual_slush/member-00#0"))
    for item in store.read_study("tiny").items:
        if (item.stage, item.label) in lost:
            store.discard(item.stage, item.key)
    found = open_study("tiny", store.root)
    assert found.progress["evolve"] == StageProgress(done=15, failed=0, missing=1)
    assert found.progress["transfer"] == StageProgress(done=8, failed=0, missing=0)
    assert found.champions() == opened.champions()
    assert len(found.table("histories")) == len(opened.table("histories")) - POPULATION * N_GENERATIONS
    curves = read_page(found.settings, found.upstream, store).curves
    assert [len(curve) for of_arm in curves.values() for curve in of_arm] == 7 * [N_GENERATIONS]
    with pytest.raises(PuddleError, match="residual_slush/member-00 is not"):
        found.ensemble()


def test_every_table_has_the_keys_and_is_read(opened):
    assert set(opened.tables) == {CHAMPIONS, *SOURCES} - {"tank", "elites", "engines"}
    for name in opened.tables:
        table = opened.table(name)
        assert table.column_names[:3] == list(KEYS) and table.schema.types[:3] == list(KEYS.values()), name
        assert all(b"unit" in field.metadata for field in table.schema), name
        assert len(pl.from_arrow(table)) == len(table.to_pandas()) == len(table) > 0, name


def test_histories_hold_every_design_with_the_name_of_its_operator(opened):
    histories = opened.table("histories")
    assert len(histories) == len(ARMS) * N_TRIALS * POPULATION * N_GENERATIONS
    assert set(histories["operator"].to_pylist()) <= set(OPERATORS)
    first = histories.filter(pc.equal(histories["generation"], 0))
    assert set(first["operator"].to_pylist()) == {"random"}
    assert histories.schema.field("fitness").metadata[b"unit"] == b"m"
    assert histories.schema.field("operator").metadata[b"unit"] == b""


def test_filters_select_what_polars_would(opened):
    frame = pl.from_arrow(opened.table("histories"))
    chosen = opened.table("histories", environment="residual_slush", depth=1.0, trial=1)
    expected = frame.filter((pl.col("environment") == "residual_slush") & (pl.col("trial") == 1))
    assert pl.from_arrow(chosen).equals(expected) and len(expected) == POPULATION * N_GENERATIONS
    drawn = pl.from_arrow(opened.table("predictions"))
    assert pl.from_arrow(opened.table("predictions", trial=0)).equals(drawn.filter(pl.col("trial") == 0))
    assert set(opened.table("scores", environment="dry_land")["environment"].to_pylist()) == {"dry_land"}
    assert set(opened.table("learning_curves")["member"].to_pylist()) == {0, 1}


def test_a_champion_scores_again_what_the_table_says(opened, settings):
    champions, slush = opened.champions(), TrueSlush(depth=1.0)
    assert champions.column_names[:6] == [*KEYS, "predicted", "zero_shot", "adapted"]
    assert champions.column_names[-1] == "design_json"  # after the numbers
    assert len(champions) == len(ARMS) * N_TRIALS
    steps = {"n_settle": settings.rollout.n_settle, "n_measure": settings.rollout.n_measure}
    for row in champions.to_pylist():
        at = {key: row[key] for key in KEYS}
        champion = opened.champion(**at)
        assert len(champion) == 1 and design_json(champion).decode() == row["design_json"]
        predicted = opened.simulate(champion, **at).displacement
        if row["environment"] == "residual_slush":
            assert (predicted.mean(), predicted.std()) == (row["predicted"], row["predicted_sd"])
            assert row["fitness"] == pytest.approx(predicted.mean() - predicted.std(), rel=1e-12)
        else:
            assert predicted.mean() == pytest.approx(row["predicted"], abs=1e-9)
            assert row["fitness"] == row["predicted"] and row["predicted_sd"] is None
        assert pc.max(opened.table("histories", **at)["fitness"]).as_py() == row["fitness"]
        assert opened.simulate(champion, "true_slush", depth=1.0).displacement[0] == row["zero_shot"]
        assert simulate(champion, slush, **steps).displacement[0] == row["zero_shot"]
        assert (row["adapted"] is None) == (row["environment"] != "dry_land")
        if row["adapted"] is not None:
            adapted = opened.champion(**at, adapted=True)
            assert opened.simulate(adapted, "true_slush", depth=1.0).displacement[0] == row["adapted"]
    with pytest.raises(PuddleError, match=r"environment: expected one of true_slush, .*, got 'honey'"):
        opened.simulate(champion, "honey", depth=1.0)


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("history", {}, "expected a table, one of champions, histories"),
        ("tank", {}, "study tiny has none"),
        ("histories", {"environment": "mud"}, "expected one of true_slush, dry_land, residual_slush, single_member"),
        ("histories", {"depth": 2.0}, "depth: expected one of 1, got 2.0"),
        ("champions", {"trial": 2}, "trial: expected one of 0, 1, got 2"),
        ("regressions", {"trial": 0}, "its rows have no trial"),
    ],
)
def test_what_is_not_there_is_refused(opened, name, given, message):
    with pytest.raises(PuddleError, match=message):
        opened.table(name, **given)


def test_a_study_that_has_only_begun_has_progress_and_no_tables(tmp_path, recorded):
    shutil.copytree(recorded, tmp_path / "store", ignore=shutil.ignore_patterns("items"))
    begun = open_study("tiny", tmp_path / "store")
    assert begun.progress["evolve"] == StageProgress(done=0, failed=0, missing=16) and begun.tables == []
    assert "evolve 0 of 16" in begun._repr_html_() and "Champions" not in begun._repr_html_()
    assert len(begun.champions()) == 0 and begun.champions().schema.field("zero_shot").type == pa.float64()
    with pytest.raises(PuddleError, match="has no champion: it is not done yet"):
        begun.champion("dry_land", depth=1.0, trial=0)
    with pytest.raises(PuddleError, match="evolve is not done"):
        begun.table("histories")
    with pytest.raises(PuddleError, match="not done"):
        begun.ensemble()


def test_a_study_with_settings_of_a_stage_that_is_gone_opens(settings, store, opened):
    older = {**settings.model_dump(mode="json"), "pilot": {"n_generations": 50, "most_outside": 0.2}}
    record_settings(store, older)
    found = open_study("tiny", store.root)
    assert found.settings == settings and found.champions() == opened.champions()


def test_keys_are_refused_together(store):
    record_settings(store, tiny("grid.depths=[1, 9]").model_dump(mode="json"))
    with pytest.raises(PuddleError, match=r"environment single_member: depth: expected one of 1, got 9\.0"):
        open_study("tiny", store.root).champion("single_member", depth=9.0, trial=0)


def test_items_that_settings_no_longer_lead_to_are_counted(store, opened):
    """Every trial evolved in two segments, and settings of fewer generations have one."""
    record_settings(store, tiny("evolution.n_generations=3").model_dump(mode="json"))
    found = open_study("tiny", store.root)
    assert found.progress["evolve"] == StageProgress(done=16, failed=0, missing=0)
    assert found.champions() == opened.champions()
    status = study_status(found.settings, store, found.record, with_diverged=False).stages[2]
    assert (status.state, status.n_done, status.n_items) == ("done", 16, 16)


def test_a_damaged_history_is_named(store):
    history = min(store.root.glob("items/evolve/*/*/history.parquet"))
    history.write_bytes(history.read_bytes()[:-1] + b"x")
    with pytest.raises(DamagedArtifact, match=r"history\.parquet: expected SHA-256"):
        open_study("tiny", store.root).table("histories")


def test_a_study_is_read_by_its_recorded_keys(store, opened):
    """Where today's settings lead to another study's results, the recorded ones are shown, and a warning says so."""
    other = tiny("seed=7")
    with serial_cluster() as cluster:  # what the settings below lead to
        run(other, store, cluster, STAGES[:-1])
    record_settings(store, other.model_dump(mode="json"))
    note = "shown as it was recorded.*results of collect, train, evolve, adapt, assess, analyse;"
    with pytest.warns(UserWarning, match=note):
        found = puddle.open_study("tiny", store=store.root)
    assert found.champions() == opened.champions()
    assert found.table("histories")["fitness"] == opened.table("histories")["fitness"]
    weights = [ensemble.weights[0] for ensemble in (found.ensemble(), opened.ensemble())]
    np.testing.assert_array_equal(*weights)
