"""`puddle gc` on a store with a finished study, or one stopped halfway."""

import shutil

import pytest
from command_line import call, refused
from small_study import n_items

from pipeline.commands.gc import find_garbage
from pipeline.errors import PuddleError
from pipeline.store.store import Store, StudyRecord


def test_items_that_no_study_needs_are_listed_and_then_removed(options, store, capsys):
    before = n_items(store)
    assert call("study", "--workers", "0", *options, "--set", "seed=2") == 0
    both = n_items(store)
    assert both > before
    half = store.root / "items" / "evolve" / "00" / ("0" * 64)
    half.mkdir(parents=True)
    (half / ".history.parquet.tmp").write_bytes(b"half")
    assert call("gc", "--store", str(store.root)) == 0
    said = capsys.readouterr().out
    assert "items that no study needs" in said and "gc --remove --store" in said
    assert n_items(store) == both and half.exists()
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    assert "MB are free again" in capsys.readouterr().out
    assert n_items(store) == before and not half.exists()
    assert call("verify", "--store", str(store.root)) == 0
    assert call("gc", "--remove", "--store", str(store.root)) == 0  # what a study needs is no garbage
    assert "that no study needs" not in capsys.readouterr().out


def test_a_study_stopped_halfway_needs_its_finished_items(options, store):
    record = store.read_study("tiny")
    chosen = {**record.settings, "evolution": {**record.settings["evolution"], "n_generations": 8}}
    store.write_study(StudyRecord("tiny", chosen, ()))  # as a driver does before the first work item
    evolved = [item.key for item in record.items if item.stage == "evolve"]
    found = {key for _, key in find_garbage(store)}
    assert evolved and not found & set(evolved)  # its first four generations are those of the longer study
    assert found >= {item.key for item in record.items if item.stage == "report"}


@pytest.mark.parametrize(
    "lost",
    [
        ("collect", "residual_slush/throws-2"),
        ("train", "residual_slush/member-01"),
        ("transfer", "dry_land/1m/trial-0"),
    ],
)
def test_nothing_is_removed_while_a_recorded_item_is_gone(lost, recorded, tmp_path):
    """It will be computed again, to the same bytes, and so what was made from it is needed."""
    store = Store.open(shutil.copytree(recorded, tmp_path / "store"), create=False)
    stage, label = lost
    key = next(item.key for item in store.read_study("tiny").items if (item.stage, item.label) == (stage, f"{label}#0"))
    assert not find_garbage(store)
    store.discard(stage, key)
    with pytest.raises(
        PuddleError, match=f"{key}/manifest.json: expected study tiny's {stage} {label}#0, found no file"
    ):
        find_garbage(store)


def test_items_made_with_earlier_networks_are_garbage_before_the_new_ones_exist(study, settings, recorded, tmp_path):
    store, (_, upstream) = Store.open(shutil.copytree(recorded, tmp_path / "store"), create=False), study
    other = settings.model_dump(mode="json")
    other["training"]["n_iterations"] += 1
    store.write_study(StudyRecord(settings.name, other, ()))
    garbage = find_garbage(store)
    old = [*upstream["train"].done.values(), *upstream["assess"].done.values()]
    old += [
        chain
        for stage in ("evolve", "adapt", "transfer")
        for trial, chain in upstream[stage].done.items()
        if settings.learner(trial.environment)
    ]
    assert set(garbage) >= {(one.stage, one.key) for chain in old for one in chain}


def test_nothing_is_removed_while_a_study_is_driven(store, capsys):
    with store.lock_study("other"):
        assert "study other is driven by process" in refused(capsys, "gc", "--remove", "--store", str(store.root))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda store: store.record_path("tiny").write_text("{}"), "study.json"),
        (lambda store: store.record_path("tiny").unlink(), "study.json: expected a study's record, found no file"),
        (
            lambda store: store.write_study(StudyRecord("tiny", {**store.read_study("tiny").settings, "wings": 2}, ())),
            "expected settings of this version of puddle",
        ),
    ],
)
def test_items_of_a_study_whose_record_says_nothing_stay_until_the_study_is_deleted(spoil, message, store, capsys):
    before = n_items(store)
    spoil(store)
    assert message in refused(capsys, "gc", "--remove", "--store", str(store.root))
    assert n_items(store) == before
    shutil.rmtree(store.study_path("tiny"))
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    assert n_items(store) == 0
