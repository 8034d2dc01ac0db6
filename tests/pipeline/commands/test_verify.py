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
from pipeline.store.store import Store


def damage_a_history(store: Store) -> tuple[Path, bytes]:
    """Change the last byte of a file; return its path and its sound content."""
    path = min(store.root.glob("items/evolve/*/*/history.parquet"))
    good = path.read_bytes()
    path.write_bytes(good[:-1] + b"?")
    return path, good


def make_newer(document: Path) -> None:
    """Seal a document with the next schema version."""
    found = json.loads(document.read_text())
    body = {name: inner for name, inner in found.items() if name not in ("schema", "version", "sha256")}
    document.write_bytes(encode_document(body, schema=found["schema"], version=found["version"] + 1))


@pytest.fixture
def where(store) -> tuple[str, str]:
    return "--store", str(store.root)


def test_an_intact_store_passes(where, store, capsys):
    assert call("verify", *where) == 0
    said = capsys.readouterr()
    assert f"{n_items(store)} items: every byte" in said.out
    assert said.err.splitlines()[-1].startswith("verify: 100%, ")


def test_damage_is_named_discarded_and_repaired(options, where, store, capsys):
    """By the commands that the message advises, from any folder."""
    path, good = damage_a_history(store)
    with pytest.raises(DamagedArtifact, match=str(path)) as told:
        store.read(store.manifest("evolve", path.parent.name), path.name)
    discard, study = re.findall(r"`puddle (.*?)`", str(told.value))
    assert call("verify", *where) == 1
    said = capsys.readouterr().out
    assert str(path) in said and "study tiny: evolve dry_land/1m/trial-0#" in said
    assert "verify --discard --store" in said
    assert path.exists()
    assert call(*shlex.split(discard)) == 1 and not path.exists()
    assert call(study, "--workers", "0", *options) == 0
    assert path.read_bytes() == good
    assert call("verify", *where) == 0


@pytest.mark.parametrize("newer", [False, True])
def test_damage_is_named_even_if_the_record_is_unreadable(newer, options, where, store, capsys):
    """A foreign file in place of the record is damage; a newer puddle's record is not, and is left alone."""
    path, _ = damage_a_history(store)
    record = store.study_path("tiny") / "study.json"
    if newer:
        make_newer(record)
    else:
        shutil.copy(path.parent / "manifest.json", record)
    assert call("verify", "--discard", *where) == 1
    said = capsys.readouterr().out
    assert str(record) in said and f"of no study: {path}" in said
    assert not path.exists()
    assert call("study", "--workers", "0", *options) == (2 if newer else 0)
    assert call("verify", *where) == (1 if newer else 0)


def put_a_file_for_a_folder(store: Store) -> None:
    """Hide a folder of items, so that looking for a listed item fails."""
    prefix = next(store.root.glob("items/analyse/*"))
    shutil.rmtree(prefix)
    prefix.touch()


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda store: make_newer(min(store.root.glob("items/analyse/*/*/manifest.json"))), "A newer puddle wrote it"),
        (put_a_file_for_a_folder, "Not a directory"),
    ],
)
def test_problems_that_discarding_does_not_repair_hide_no_others(spoil, expected, where, store, capsys):
    spoil(store)
    lost = min(store.root.glob("items/evolve/*/*/manifest.json"))
    lost.unlink()
    assert call("verify", *where) == 1
    said = capsys.readouterr().out
    assert expected in said
    assert re.search(rf"study tiny: evolve dry_land/1m/trial-0#\d: {lost}: expected a manifest", said)
