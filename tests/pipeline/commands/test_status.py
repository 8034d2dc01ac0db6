"""`puddle status` and `puddle studies`: what is on record is never shown as missing."""

import json

from command_line import call, refused

from pipeline.store.store import FailedChain, Store, StudyRecord


def status_of(capsys, *options: str) -> dict:
    capsys.readouterr()
    assert call("status", "--json", *options) == 0
    return json.loads(capsys.readouterr().out)


def states(status: dict) -> set[str]:
    return {stage["state"] for stage in status["stages"]} - {"not needed"}


def test_other_settings_are_shown_beside_the_study_on_record(options, store, capsys):
    assert call("status", *options, "--set", "evolution.n_generations=6", "--set", "grid.n_trials=2") == 0
    said = capsys.readouterr().out
    assert "missing" not in said and "started" not in said
    assert "The settings given differ from it (recorded → given):" in said
    assert "  grid.n_trials: 1 → 2" in said and "  evolution.n_generations: 4 → 6" in said
    assert "puddle forecast" in said
    assert call("status", *options) == 0
    assert "differ" not in capsys.readouterr().out


def test_a_name_without_a_record_is_missing_and_the_others_are_named(options, store, capsys):
    assert call("status", *options, "--set", "name=other") == 0
    said = capsys.readouterr().out
    assert "report    started" in said and "The store has no study other, but tiny" in said


def test_status_as_json(options, store, capsys):
    status = status_of(capsys, "tiny", "--store", str(store.root))
    assert (status["study"], status["store"], status["done"]) == ("tiny", str(store.root), True)
    assert [stage["stage"] for stage in status["stages"]][2] == "evolve" and states(status) == {"done"}
    assert {"n_done", "n_items", "units", "unit", "core_seconds", "failed"} <= status["stages"][2].keys()
    differing = status_of(capsys, *options, "--set", "seed=3")
    assert differing["settings_differ"] == ["seed: 1 → 3"] and states(differing) == {"done"}


def test_what_was_made_from_a_lost_item_is_not_missing(options, store, capsys):
    first = next(item for item in store.read_study("tiny").items if item.label == "dry_land/1m/trial-0#0")
    store.discard(first.stage, first.key)
    status = status_of(capsys, *options)
    by_stage = {stage["stage"]: stage for stage in status["stages"]}
    assert by_stage["evolve"]["state"] == "started" and by_stage["evolve"]["n_done"] == 1  # of 2
    assert {by_stage[name]["state"] for name in ("transfer", "analyse", "report")} == {"done"}
    assert call("study", "--workers", "0", *options) == 0  # computes the one item, and uses the rest again
    assert states(status_of(capsys, *options)) == {"done"}


def test_studies_are_listed(store, capsys):
    record = store.read_study("tiny")
    longer = {**record.settings["evolution"], "n_generations": 8}
    settings = {**record.settings, "name": "longer", "seed": 7, "evolution": longer}
    failed = (FailedChain("evolve", "dry_land/1m/trial-0", "an error"),)
    store.write_study(StudyRecord("longer", settings, (), failed, source="preset smoke"))
    store.write_study(StudyRecord("broken", settings, ()))
    path = store.study_path("broken") / "study.json"
    path.write_bytes(path.read_bytes()[:-9])
    assert call("studies", "--store", str(store.root)) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"3 studies in {store.root}\n")
    assert f"broken: {path}" in said and "tiny: done\n" in said and f"settings from {record.source}" in said
    assert "longer: stage 3 of 8: evolve, 0 of 4 items" in said and "settings from preset smoke\n" in said
    assert (store.export_path("tiny") / "index.html").as_uri() in said
    assert call("studies", "--json", "--store", str(store.root)) == 0
    broken, longer, tiny = json.loads(capsys.readouterr().out)["studies"]
    assert broken["problem"] and not broken["done"]
    assert tiny["done"] and tiny["changed"] and tiny["page"].startswith("file:///")
    assert longer["source"] == "preset smoke" and not longer["done"]


def test_a_store_without_studies_and_no_store(tmp_path, capsys):
    Store.open(tmp_path / "store", create=True)
    assert call("studies", "--store", str(tmp_path / "store")) == 0
    assert capsys.readouterr().out.startswith("no studies in")
    assert str(tmp_path / "none") in refused(capsys, "studies", "--store", str(tmp_path / "none"))
