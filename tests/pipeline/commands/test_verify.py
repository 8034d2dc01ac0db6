"""`puddle verify` as a person uses it, on a store with a study that is done."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from command_line import call
from small_study import n_items

from pipeline.errors import DamagedArtifact
from pipeline.store.encoding import encode_sealed
from pipeline.store.store import Store


@pytest.fixture
def store(options) -> Store:
    return Store.open(Path(options[-1]), create=False)


def test_a_store_that_is_well_verifies(options, store, capsys):
    n_bytes = store.bytes_to_verify()
    (store.root / "mlflow.db").write_bytes(bytes(9_000_000))  # a mirror, which is not looked at
    assert call("verify", *options) == 0
    said = capsys.readouterr()
    assert f"{n_items(store)} items, {n_bytes / 1e6:,.1f} MB: every byte" in said.out and n_bytes < 9_000_000
    assert said.err.splitlines()[-1].startswith("verify: 100%, ")


def test_damage_is_named_discarded_and_mended(options, store, capsys):
    (path,) = list(store.root.glob("items/evolve/*/*/history.parquet"))[:1]
    good = path.read_bytes()
    path.write_bytes(good[:-1] + b"?")
    assert call("verify", *options) == 1
    said = capsys.readouterr().out
    assert str(path) in said and "study tiny: evolve dry_land/1m/trial-0#" in said and "verify --settings" in said
    assert path.exists()
    assert call("verify", "--discard", *options) == 1
    assert not path.exists() and "`puddle study --settings" in capsys.readouterr().out
    assert call("study", "--workers", "0", *options) == 0
    assert path.read_bytes() == good
    assert call("verify", *options) == 0


def swap_for_a_manifest(record: Path) -> None:
    shutil.copy(next(record.parents[2].rglob("manifest.json")), record)


def make_newer(document: Path) -> None:
    """As a newer puddle would have sealed it."""
    found = json.loads(document.read_text())
    body = {name: inner for name, inner in found.items() if name not in ("schema", "version", "sha256")}
    document.write_bytes(encode_sealed(body, schema=found["schema"], version=found["version"] + 1))


@pytest.mark.parametrize(("spoil", "mends"), [(swap_for_a_manifest, True), (make_newer, False)])
def test_damage_is_named_where_the_record_can_not_be_read_either(spoil, mends, options, store, capsys):
    """A foreign file where the record was is damage; a newer puddle's record is none, and is left as it is."""
    (path,) = list(store.root.glob("items/evolve/*/*/history.parquet"))[:1]
    path.write_bytes(b"")
    record = store.root / "studies" / "tiny" / "study.json"
    spoil(record)
    assert call("verify", "--discard", *options) == 1
    said = capsys.readouterr().out
    assert str(record) in said and f"of no study: evolve {path.parent.name}" in said
    assert not path.exists()
    assert call("study", "--workers", "0", *options) == (0 if mends else 2)
    assert call("verify", *options) == (0 if mends else 1)


def test_a_report_that_was_edited_is_noticed(options, store, capsys):
    (store.export_path("tiny") / "index.html").write_text("better")
    assert call("verify", *options) == 1
    said = capsys.readouterr().out
    assert "index.html: expected SHA-256" in said and "puts it back" in said and "computed again" not in said
    assert call("study", "--workers", "0", *options) == 0
    assert call("verify", *options) == 0


def test_the_report_of_a_study_that_is_driven_is_left_out(options, store, capsys):
    """Its driver keeps the record before it puts the report where people look."""
    (store.export_path("tiny") / "index.html").write_text("an earlier one")
    with store.lock_study("tiny"), store.lock_study("new"):
        assert call("verify", *options) == 0
    said = capsys.readouterr().out
    assert "study tiny is driven by process" in said and "the copy of its report was left out" in said
    assert "every byte is as it was committed" in said
    assert call("verify", *options) == 1


def make_a_manifest_newer(store: Store) -> None:
    make_newer(next(store.root.glob("items/analyse/*/*/manifest.json")))


def make_another_record_newer(store: Store) -> None:
    store.write_study("newer", {}, ())
    make_newer(store.study_path("newer") / "study.json")


def put_a_file_for_a_folder(store: Store) -> None:
    """No item is found below it, and asking for one that the record lists fails."""
    prefix = next(store.root.glob("items/analyse/*"))
    shutil.rmtree(prefix)
    prefix.touch()


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (make_a_manifest_newer, "A newer puddle wrote it"),
        (make_another_record_newer, "A newer puddle wrote it"),
        (put_a_file_for_a_folder, "Not a directory"),
    ],
)
def test_what_discarding_does_not_mend_hides_nothing_else(spoil, expected, options, store, capsys):
    spoil(store)
    (lost,) = list(store.root.glob("items/evolve/*/*/manifest.json"))[:1]
    lost.unlink()
    (store.export_path("tiny") / "index.html").write_text("better")
    assert call("verify", *options) == 1
    said = capsys.readouterr().out
    assert expected in said
    assert f"{lost}: expected the manifest of study tiny's evolve dry_land/1m/trial-0#" in said
    assert "index.html: expected SHA-256" in said


def test_files_that_lost_their_manifest_are_told_of_as_unfinished(options, store, capsys):
    """Of a study that was stopped, whose record lists no items; so are those of a driver that is at work."""
    store.write_study("tiny", store.read_study("tiny").settings, ())
    assert call("verify", *options) == 0
    assert "unfinished" not in capsys.readouterr().out
    lost = next(store.root.glob("items/evolve/*/*/manifest.json"))
    lost.unlink()
    assert call("verify", *options) == 0
    said = capsys.readouterr().out
    assert said.startswith("1 unfinished items: files without a manifest") and "every byte" in said
    (advised,) = re.findall(r"`puddle (.*?)`", said)
    assert call(*shlex.split(advised)) == 0 and not lost.parent.exists()
    capsys.readouterr()
    assert call("verify", *options) == 0
    assert "unfinished" not in capsys.readouterr().out


def test_what_a_study_lists_and_lacks_is_damage_and_not_unfinished(options, store, capsys):
    lost = next(store.root.glob("items/evolve/*/*/manifest.json"))
    lost.unlink()
    assert call("verify", *options) == 1
    said = capsys.readouterr().out
    assert f"{lost}: expected the manifest" in said and "unfinished" not in said


def test_what_a_message_of_damage_advises_mends_it(options, store, capsys):
    """Whoever reads the item, and from whatever folder."""
    (path,) = list(store.root.glob("items/evolve/*/*/history.parquet"))[:1]
    good = path.read_bytes()
    path.write_bytes(good[:-1] + b"?")
    with pytest.raises(DamagedArtifact) as told:
        store.read(store.manifest("evolve", path.parent.name), path.name)
    assert str(path) in str(told.value) and "nothing else is lost" in str(told.value)
    discard, study = re.findall(r"`puddle (.*?)`", str(told.value))
    assert call(*shlex.split(discard)) == 1 and not path.exists()
    assert call(study, "--workers", "0", *options) == 0
    assert path.read_bytes() == good
    assert call("verify", *options) == 0
