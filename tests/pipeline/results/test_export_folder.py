"""`puddle export` and `puddle champions`: what they write and print, and what they refuse."""

import csv
import json
import shutil
from pathlib import Path

import mujoco
import polars as pl
import pytest
from command_line import call, refused

import puddle
from pipeline.config.loading import load
from pipeline.config.settings import Settings
from pipeline.results.export_folder import LARGE_TABLES
from pipeline.store.design_file import design_json, load_design
from tasks.residual import arm_kind


@pytest.fixture(scope="module")
def exported(recorded, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("export") / "out"
    assert call("export", "tiny", "--out", str(out), "--store", str(recorded)) == 0
    return out


@pytest.fixture
def store(recorded, tmp_path) -> Path:
    """A copy of the store, to be damaged."""
    return shutil.copytree(recorded, tmp_path / "store")


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_every_champion_is_a_design_file(exported, recorded):
    study = puddle.open_study("tiny", recorded)
    rows = study.champions().to_pylist()
    names = {f"{row['environment']}-1m-trial-{row['trial']}" for row in rows}
    adapted = {f"dry_land-1m-trial-{trial}-adapted" for trial in (0, 1)}
    assert {path.stem for path in (exported / "champions").iterdir()} == names | adapted
    design = load_design(exported / "champions" / "dry_land-1m-trial-1.json")
    assert design_json(design) == design_json(study.champion("dry_land", depth=1.0, trial=1))
    body = load_design(exported / "champions" / "dry_land-1m-trial-1-adapted.json")
    assert (body.parent == design.parent).all() and not (body.phase == design.phase).all()


def test_tables_are_those_of_the_study(exported, recorded):
    study = puddle.open_study("tiny", recorded)
    written = set(study.tables) - set(LARGE_TABLES)
    assert {path.stem for path in (exported / "tables").glob("*.parquet")} == written
    for name in written:
        assert pl.read_parquet(exported / "tables" / f"{name}.parquet").equals(pl.from_arrow(study.table(name))), name
    with (exported / "tables" / "columns.csv").open() as sheet:
        listed = list(csv.DictReader(sheet))
    of = {(row["table"], row["column"]): row for row in listed}
    assert of["predictions", "depth"]["unit"] == "m"
    assert of["scores", "zero_shot"]["unit"] == "m" and of["transfer", "zero_shot"]["meaning"]
    assert {row["table"] for row in listed} == written
    assert all(of[name, ""]["meaning"].endswith((".", "?")) for name in written)  # a sentence on each table


def test_figures_and_latex_are_there_and_settings_load(exported, settings):
    names = {path.name for path in (exported / "figures").iterdir()}
    drawn = {f"{name}.{kind}" for name in ("transfer_at_depth", "fitness_curves") for kind in ("svg", "png", "pdf")}
    assert names == {*drawn, "captions.txt"}
    assert (exported / "figures" / "captions.txt").read_text().startswith("transfer_at_depth: Displacement in True")
    assert r"\begin{tabular}" in (exported / "transfer.tex").read_text()
    assert load(Settings, exported / "settings.yaml") == settings
    manifest = json.loads((exported / "export.json").read_text())
    assert manifest["study"] == "tiny" and set(manifest["files"]) == files(exported).keys() - {"export.json"}


def test_tables_can_be_chosen_and_champions_be_models_of_mujoco_too(recorded, exported, tmp_path, capsys):
    chosen = ("--table", "histories", "--table", "scores", "--table", "scores", "--mjcf")
    assert call("export", "tiny", "--out", str(tmp_path / "out"), "--store", str(recorded), *chosen) == 0
    assert "2 tables" in capsys.readouterr().out
    names = files(tmp_path / "out").keys()
    tables = {name for name in names if name.startswith("tables/")}
    assert tables == {"tables/histories.parquet", "tables/scores.parquet", "tables/columns.csv"}
    histories = pl.read_parquet(tmp_path / "out" / "tables" / "histories.parquet")
    assert histories.equals(pl.from_arrow(puddle.open_study("tiny", recorded).table("histories")))
    models = {name for name in names if name.endswith(".xml")}
    for name in models:
        assert mujoco.MjModel.from_xml_path(str(tmp_path / "out" / name)).geom("ground").pos[2] == -1.0
    rest = {name for name in files(exported) if not name.startswith("tables/")}
    assert {name.replace(".xml", ".json") for name in models} == {name for name in rest if "champions/" in name}
    assert names - tables - models == rest


def test_a_study_that_has_only_begun_exports_what_is_done_and_says_what_is_missing(store, tmp_path, capsys):
    for stage in ("adapt", "transfer", "assess", "analyse", "report"):
        shutil.rmtree(store / "items" / stage)
    assert call("export", "tiny", "--out", str(tmp_path / "out"), "--store", str(store)) == 0
    said = capsys.readouterr().out
    assert "transfer: 8 work items are missing" in said and "0 champions" in said
    assert (tmp_path / "out" / "tables" / "fitness_curves.parquet").exists()
    assert call("champions", "tiny", "--store", str(store)) == 2
    assert "no champions" in capsys.readouterr().err


def test_a_table_that_the_study_does_not_have_is_refused(recorded, tmp_path, capsys):
    out = tmp_path / "out"
    said = refused(capsys, "export", "tiny", "--out", str(out), "--store", str(recorded), "--table", "history")
    assert "study tiny has no table history" in said and "champions, histories" in said and not out.exists()
    inside = refused(capsys, "export", "tiny", "--out", str(recorded / "out"), "--store", str(recorded))
    assert "outside the store" in inside


def test_champions_are_ranked_by_what_they_do_in_true_slush(recorded, capsys):
    assert call("champions", "tiny", "--store", str(recorded)) == 0
    printed = capsys.readouterr().out
    champions = puddle.open_study("tiny", recorded).champions().to_pylist()
    ranked = sorted(champions, key=lambda row: -row["zero_shot"])
    labels = [arm_kind(row["environment"]).label.split()[0] for row in ranked]
    found = [line for line in printed.splitlines() if line.startswith(tuple(labels))]
    assert all(line.startswith(label) for line, label in zip(found, labels, strict=True))
    assert all(len(line) <= 80 for line in printed.splitlines() if "`" not in line)
