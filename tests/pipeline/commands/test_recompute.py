"""Results of a different version of the code: commands name them, and `--recompute` makes them anew."""

import json

import pytest
from command_line import call, refused

from pipeline.store.store import Store


def evolved(store: Store) -> list[str]:
    return [key for stage, key in store.items() if stage == "evolve"]


@pytest.fixture
def store(store) -> Store:
    """A copy of a finished study's store in which other code has made the items of evolve."""
    for key in evolved(store):
        manifest = store.manifest("evolve", key)
        files = {name: store.read(manifest, name) for name in manifest.files}
        store.discard("evolve", key)
        record = {**manifest.record, "code": {"modules": "00000000", "files": "0" * 64}}
        store.commit("evolve", manifest.identity, files, record=record)
    return store


WARNING = "A different version of the code made items of evolve."


def test_status_and_runs_name_the_stage_that_other_code_has_made(options, store, capsys):
    capsys.readouterr()
    assert call("status", *options) == 0
    said = capsys.readouterr().out
    assert said.count("ifferent version") == said.count(WARNING) == 1 and "--recompute evolve" in said
    assert call("status", "--json", *options) == 0
    counts = {stage["stage"]: stage["n_other_code"] for stage in json.loads(capsys.readouterr().out)["stages"]}
    assert counts.pop("evolve") == 2 and set(counts.values()) == {0}
    assert call("transfer", "--workers", "0", *options) == 0
    said = capsys.readouterr().err
    assert said.count("ifferent version") == said.count(WARNING) == 1


def test_recompute_makes_a_stage_anew(options, store, capsys):
    before = {key: store.manifest("evolve", key) for key in evolved(store)}
    said = refused(capsys, "evolve", "--recompute", "train", *options)
    assert "--recompute train: expected a stage that this command runs: evolve" in said
    with store.lock_study("other"):
        assert "study other is driven by process" in refused(capsys, "evolve", "--recompute", "evolve", *options)
    assert call("evolve", "--workers", "0", "--recompute", "evolve", *options) == 0
    assert "2 items of evolve are discarded" in capsys.readouterr().err
    after = {key: store.manifest("evolve", key) for key in evolved(store)}
    assert {key: of.digest for key, of in after.items()} == {key: of.digest for key, of in before.items()}
    assert all(of.record["code"] != before[key].record["code"] for key, of in after.items())
    assert call("status", *options) == 0
    said = capsys.readouterr().out
    assert "ifferent version" not in said and "missing" not in said
