"""`puddle gc` on a store with a finished study, or one stopped halfway."""

import shutil
from pathlib import Path

import pytest
from command_line import call
from small_study import ON_DRY_LAND, n_items

from pipeline.cluster import session
from pipeline.commands.examination import examine_store
from pipeline.commands.garbage import find_garbage, remove_garbage
from pipeline.config.loading import parse
from pipeline.config.settings import RESIDUAL_ENVIRONMENTS, Settings
from pipeline.errors import PuddleError
from pipeline.store.store import Store, StudyRecord


@pytest.fixture
def store(options) -> Store:
    return Store.open(Path(options[-1]), create=False)


def test_what_a_study_needs_is_not_garbage(options, store, capsys):
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    assert "that no study needs" not in capsys.readouterr().out
    assert call("verify", *options) == 0


def test_items_that_no_study_needs_are_listed_and_then_removed(options, store, capsys):
    before = n_items(store)
    assert call("study", "--workers", "0", *options, "--set", "seed=2") == 0
    said = capsys.readouterr().err
    assert "study tiny is on record with different settings (seed: 1 → 2). This run replaces its report" in said
    both = n_items(store)
    assert both > before
    half = store.root / "items" / "evolve" / "00" / ("0" * 64)
    half.mkdir(parents=True)
    (half / ".history.parquet.tmp").write_bytes(b"half")
    assert call("gc", "--store", str(store.root)) == 0
    said = capsys.readouterr().out
    assert "items that no study needs" in said and "whose commit never ended" in said and "gc --store" in said
    assert n_items(store) == both and half.exists()
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    assert "MB are free again" in capsys.readouterr().out
    assert n_items(store) == before and not half.exists()
    assert call("verify", *options) == 0
    assert call("gc", "--store", str(store.root)) == 0
    assert "that no study needs" not in capsys.readouterr().out


def test_the_advised_command_names_the_same_store(options, store, monkeypatch, capsys):
    monkeypatch.chdir(store.root.parent)
    monkeypatch.setenv("PUDDLE_STORE", "elsewhere")
    (store.root / "items" / "evolve" / "00" / ("0" * 64)).mkdir(parents=True)
    assert call("gc", "--store", "store") == 0
    assert "puddle gc --store store --remove` removes it" in capsys.readouterr().out


def test_the_users_own_files_are_not_garbage_whatever_their_names(options, store, capsys):
    folder = store.export_path("tiny")
    ours, theirs = folder / ".index.html.tmp", folder / ".notes.tmp"
    ours.write_text("half")
    theirs.write_text("mine")
    (folder / ".drafts.tmp").mkdir()
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    said = capsys.readouterr().out
    assert str(ours) in said and not ours.exists()
    assert theirs.read_text() == "mine" and (folder / ".drafts.tmp").is_dir() and "notes" not in said


def test_a_study_stopped_halfway_needs_its_finished_items(options, store):
    record = store.read_study("tiny")
    chosen = {**record.settings, "evolution": {**record.settings["evolution"], "n_generations": 8}}
    store.write_study(StudyRecord("tiny", chosen, ()))  # as a driver does before the first work item
    evolved = [item.key for item in record.items if item.stage == "evolve"]
    found = {key for _, key in find_garbage(store).items}
    assert evolved and not found & set(evolved)  # its first four generations are those of the longer study
    assert found >= {item.key for item in record.items if item.stage == "report"}


@pytest.fixture
def evolving(study, settings, tmp_path, monkeypatch) -> Store:
    """A copy of a store whose study has every environment and a record that lists no items, as during evolution."""
    monkeypatch.setattr(session, "SESSIONS_FOLDER", tmp_path)
    found = Store.open(shutil.copytree(study[0].root, tmp_path / "evolving"), create=False)
    found.write_study(StudyRecord(settings.name, settings.model_dump(mode="json"), ()))
    return found


@pytest.mark.parametrize("lost", [("collect", "throws-2"), ("train", "member-01"), ("transfer", "dry_land/1m/trial-0")])
def test_nothing_is_removed_while_a_recorded_item_is_gone(lost, recorded, tmp_path):
    """It will be computed again, to the same bytes, and so what was made from it is needed."""
    store = Store.open(shutil.copytree(recorded, tmp_path / "store"), create=False)
    stage, label = lost
    key = next(item.key for item in store.read_study("tiny").items if (item.stage, item.label) == (stage, f"{label}#0"))
    assert not find_garbage(store).items
    store.discard(stage, key)
    with pytest.raises(
        PuddleError, match=f"{key}/manifest.json: expected study tiny's {stage} {label}#0, found no file"
    ):
        find_garbage(store)


def test_items_made_with_earlier_networks_are_garbage_before_the_new_ones_exist(study, settings, evolving):
    other = settings.model_dump(mode="json")
    other["training"]["n_iterations"] += 1
    evolving.write_study(StudyRecord(settings.name, other, ()))
    garbage = find_garbage(evolving)
    _, upstream = study
    old = [*upstream["train"].done.values(), *upstream["assess"].done.values()]
    old += [
        chain
        for stage in ("evolve", "transfer")
        for trial, chain in upstream[stage].done.items()
        if trial.environment in RESIDUAL_ENVIRONMENTS
    ]
    assert set(garbage.items) >= {(one.stage, one.key) for chain in old for one in chain}
    remove_garbage(evolving, garbage)
    assert not find_garbage(evolving).items


def test_nothing_is_removed_while_a_study_is_driven_or_unreadable(options, store, capsys):
    with store.lock_study("other"):
        assert call("gc", "--remove", "--store", str(store.root)) == 2
    assert "study other is driven by process" in capsys.readouterr().err
    with store.lock_all(), pytest.raises(PuddleError, match="is removing items"), store.lock_study("tiny"):
        pass
    (store.root / "studies" / "tiny" / "study.json").write_text("{}")
    assert call("gc", "--remove", "--store", str(store.root)) == 2
    assert "study.json" in capsys.readouterr().err
    assert n_items(store) == sum(1 for _ in store.root.glob("items/*/*/*/manifest.json"))


def test_other_commands_refuse_to_run_while_garbage_is_removed(options, store, capsys):
    """An item that is being removed would look damaged."""
    with store.lock_all():
        for command in ("status", "--digests"), ("status",), ("verify",):
            assert call(*command, *options) == 2
            assert "is removing items. Wait until it ends." in capsys.readouterr().err
        (found,) = examine_store(store.root, parse(Settings, ON_DRY_LAND, name="tiny"))
        assert found.verdict == "fail" and "is removing items" in found.found
    with store.lock_to_read():
        assert call("status", *options) == call("verify", *options) == 0


def test_settings_of_another_version_are_named(options, store, tmp_path, capsys):
    store.write_study(StudyRecord("tiny", {**store.read_study("tiny").settings, "wings": 2}, ()))
    assert call("gc", "--remove", "--store", str(store.root)) == 2
    said = capsys.readouterr().err
    assert (
        "expected settings of this version of puddle" in said
        and "wings: Extra inputs" in said
        and "nothing is removed" in said
    )
    kit = str(tmp_path / "kit")
    assert call("fabricate", "--study", "tiny", "--out", kit, "--store", str(store.root)) == 2
    said = capsys.readouterr().err
    assert said.startswith("puddle: study tiny: expected settings of this version of puddle") and "wings" in said


def test_items_of_a_study_without_a_record_stay_until_the_study_is_deleted(options, store, capsys):
    before = n_items(store)
    (store.study_path("tiny") / "study.json").unlink()
    assert call("gc", "--remove", "--store", str(store.root)) == 2
    said = capsys.readouterr().err
    assert "study.json: expected a study's record, found no file" in said and "Run the study again, or delete" in said
    assert n_items(store) == before
    shutil.rmtree(store.study_path("tiny"))
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    assert n_items(store) == 0


def test_folders_of_dead_drivers_are_swept(options, store, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(session, "SESSIONS_FOLDER", tmp_path)
    dead = tmp_path / "puddle-12345678"
    dead.mkdir()
    (dead / ".puddle-session").touch()
    stranger = tmp_path / "puddle-notes"
    stranger.mkdir()
    (stranger / "lock").write_text("of another program")
    assert call("gc", "--store", str(store.root)) == 0
    said = capsys.readouterr().out
    assert f"{dead}: left by a driver that is dead" in said and str(stranger) not in said and dead.exists()
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    assert not dead.exists() and (stranger / "lock").read_text() == "of another program"
