"""Studies addressed by their names, which take the settings on record."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import call, refused

from pipeline.config.loading import load
from pipeline.config.settings import Settings


@pytest.mark.parametrize(
    "words",
    [
        ("status", "tiny"),
        ("settings", "tiny"),
        ("forecast", "tiny"),
        ("evolve", "tiny", "--workers", "0"),
        ("study", "tiny", "--workers", "0"),
    ],
)
def test_a_name_takes_the_recorded_settings(words, done, store, capsys):
    before = store.read_study("tiny")
    assert call(*words, "--store", str(store.root)) == 0
    after = store.read_study("tiny")
    assert after == before and after.source == str(done / "tiny.yaml")  # nothing was computed, and the source stays
    said = capsys.readouterr()
    assert "tiny" in said.out + said.err or "dry_land" in said.err


def test_settings_may_be_changed_beside_a_name(store, capsys):
    assert call("settings", "tiny", "--store", str(store.root), "--set", "seed=7") == 0
    (store.root / "printed.yaml").write_text(capsys.readouterr().out)
    printed = load(Settings, store.root / "printed.yaml")
    assert printed.seed == 7 and printed.grid.environments == ("dry_land",)


def test_what_used_code_that_is_gone_is_shown_and_not_computed(store, capsys):
    """The record is what it would be had the target been another medium, whose file was then removed."""
    record = store.read_study("tiny")
    settings = {**record.settings, "target": "honey", "honey": {"decay": 5.0}}
    items = tuple(item for item in record.items if item.label != "paper#0")  # which such a study does not have
    store.write_study(replace(record, settings=settings, items=items))
    options = ("--store", str(store.root))
    simulate = ("simulate", "docs/design.json", "--study", "tiny", "--depth", "1", *options)
    for words in (("status", "tiny"), ("studies",), ("champions", "tiny"), ("settings", "tiny")):
        assert call(*words, *options) == 0
    said = capsys.readouterr()
    assert "The code of honey is not here." in said.out and 'honey: {"decay": 5.0}' in said.out
    for command in ("study", "evolve", "forecast", "doctor"):
        missing = refused(capsys, command, "tiny", *options)
        assert missing == "puddle: study tiny: expected the code of honey, found none\n"
    assert "expected the code of honey, found none" in refused(capsys, "gc", *options)
    assert call(*simulate, "--environment", "dry_land") == 0
    assert "expected one of true_slush" in refused(capsys, *simulate)


def test_an_unknown_name_lists_the_studies(store, capsys):
    record = store.read_study("tiny")
    for name in ("tiny-2", "other"):
        store.write_study(replace(record, name=name))

    def message(name: str) -> str:
        return refused(capsys, "status", name, "--store", str(store.root))

    assert f"study 'othr': {store.root} holds other, tiny, tiny-2; did you mean other?" in message("othr")
    assert "holds other, tiny, tiny-2" in message("../tiny")
    assert "--preset smoke" in message("smoke")


@pytest.mark.parametrize("command", ["study", "status", "forecast", "doctor"])
def test_a_damaged_record_is_refused_and_stays(command, store, capsys):
    path = store.study_path("tiny") / "study.json"
    damaged = path.read_bytes()[:-20]
    path.write_bytes(damaged)
    files = sorted(store.root.rglob("*"))
    said = refused(capsys, command, "tiny", "--store", str(store.root))
    assert said.startswith(f"puddle: {path}") and len(said.splitlines()) == 1
    assert path.read_bytes() == damaged and sorted(store.root.rglob("*")) == files


def test_a_lost_record_and_an_empty_store_are_refused(store, tmp_path, capsys):
    (store.study_path("tiny") / "study.json").unlink()
    said = refused(capsys, "status", "tiny", "--store", str(store.root))
    assert "study.json: expected a record, found no file" in said
    shutil.rmtree(store.study_path("tiny"))
    assert "holds no study yet" in refused(capsys, "status", "tiny", "--store", str(store.root))
    nowhere = str(tmp_path / "nowhere")
    assert "expected a store" in refused(capsys, "study", "tiny", "--store", nowhere)
    assert not Path(nowhere).exists()


@pytest.mark.parametrize(
    "words",
    [
        ("study", "tiny", "--settings", "tiny.yaml"),
        ("study", "--preset", "laptop", "--settings", "tiny.yaml"),
        ("simulate", "docs/design.json", "--depth", "1", "--study", "tiny", "--preset", "smoke"),
    ],
)
def test_two_sources_of_settings_are_refused(words, capsys):
    said = refused(capsys, *words)
    assert "expected only one of a study's name, --preset and --settings, got " in said
