"""`puddle verify` on a store with a finished study."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from command_line import call
from small_study import n_items

from pipeline.errors import DamagedArtifact
from pipeline.store.encoding import encode_document
from pipeline.store.store import Store, StudyRecord


def damage_a_history(store: Store) -> tuple[Path, bytes]:
    """Change the last byte of a file; return its path and its sound content."""
    path = min(store.root.glob("items/evolve/*/*/history.parquet"))
    good = path.read_bytes()
    path.write_bytes(good[:-1] + b"?")
    return path, good


def lose_a_manifest(store: Store) -> Path:
    lost = min(store.root.glob("items/evolve/*/*/manifest.json"))
    lost.unlink()
    return lost


def make_newer(document: Path) -> None:
    """Seal a document with the next schema version."""
    found = json.loads(document.read_text())
    body = {name: inner for name, inner in found.items() if name not in ("schema", "version", "sha256")}
    document.write_bytes(encode_document(body, schema=found["schema"], version=found["version"] + 1))


def test_an_intact_store_passes(options, store, capsys):
    n_bytes = sum(store.item_bytes(*item) - store.manifest_path(*item).stat().st_size for item in store.items())
    (store.root / "mlflow.db").write_bytes(bytes(9_000_000))  # a mirror, which is not checked
    assert call("verify", *options) == 0
    said = capsys.readouterr()
    assert f"{n_items(store)} items, {n_bytes / 1e6:,.1f} MB: every byte" in said.out and n_bytes < 9_000_000
    assert said.err.splitlines()[-1].startswith("verify: 100%, ")


def test_damage_is_named_discarded_and_repaired(options, store, capsys):
    """By the commands that the message advises, from any folder."""
    path, good = damage_a_history(store)
    with pytest.raises(DamagedArtifact, match=str(path)) as told:
        store.read(store.manifest("evolve", path.parent.name), path.name)
    discard, study = re.findall(r"`puddle (.*?)`", str(told.value))
    assert call("verify", *options) == 1
    said = capsys.readouterr().out
    assert str(path) in said and "study tiny: evolve dry_land/1m/trial-0#" in said and "verify --settings" in said
    assert path.exists()
    assert call(*shlex.split(discard)) == 1 and not path.exists()
    assert call(study, "--workers", "0", *options) == 0
    assert path.read_bytes() == good
    assert call("verify", *options) == 0


@pytest.mark.parametrize("newer", [False, True])
def test_damage_is_named_even_if_the_record_is_unreadable(newer, options, store, capsys):
    """A foreign file in place of the record is damage; a newer puddle's record is not, and is left alone."""
    path, _ = damage_a_history(store)
    record = store.study_path("tiny") / "study.json"
    if newer:
        make_newer(record)
    else:
        shutil.copy(path.parent / "manifest.json", record)
    assert call("verify", "--discard", *options) == 1
    said = capsys.readouterr().out
    assert str(record) in said and f"of no study: evolve {path.parent.name}" in said
    assert not path.exists()
    assert call("study", "--workers", "0", *options) == (2 if newer else 0)
    assert call("verify", *options) == (1 if newer else 0)


def make_a_manifest_newer(store: Store) -> None:
    make_newer(next(store.root.glob("items/analyse/*/*/manifest.json")))


def put_a_file_for_a_folder(store: Store) -> None:
    """Hide a folder of items, so that looking for a listed item fails."""
    prefix = next(store.root.glob("items/analyse/*"))
    shutil.rmtree(prefix)
    prefix.touch()


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [(make_a_manifest_newer, "A newer puddle wrote it"), (put_a_file_for_a_folder, "Not a directory")],
)
def test_problems_that_discarding_does_not_repair_hide_no_others(spoil, expected, options, store, capsys):
    spoil(store)
    lost = lose_a_manifest(store)
    assert call("verify", *options) == 1
    said = capsys.readouterr().out
    assert expected in said
    assert f"{lost}: expected the manifest of study tiny's evolve dry_land/1m/trial-0#" in said


def test_one_study_of_a_store_is_verified_by_its_name(store, capsys):
    record = store.read_study("tiny")
    store.write_study(StudyRecord("other", {**record.settings, "name": "other"}, record.items[:1]))
    damaged = record.items[-1]
    path = next(store.manifest_path(damaged.stage, damaged.key).parent.glob("[!m]*"))
    path.write_bytes(path.read_bytes() + b"?")
    by_name = ("--store", str(store.root), "--json", "--study")
    assert call("verify", *by_name, "other") == 0
    intact = json.loads(capsys.readouterr().out)
    assert (intact["study"], intact["intact"], intact["n_items"]) == ("other", True, 1)
    assert call("verify", *by_name, "tiny") == 1
    found = json.loads(capsys.readouterr().out)
    assert not found["intact"] and str(path) in found["problems"][0] and not found["discarded"]
    assert found["damaged"] == [f"study tiny: {damaged.stage} {damaged.label}"]
    assert call("verify", *by_name, "unknown") == 2
