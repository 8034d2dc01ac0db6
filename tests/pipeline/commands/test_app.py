"""The command line as a user sees it: every mistake gives one clear message and exit code 2, never a traceback."""

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import typer
from command_line import call

from pipeline.cluster import serial_cluster
from pipeline.commands.app import main
from pipeline.commands.options import ExecutionOptions, with_options
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.store.design_file import design_document
from pipeline.store.store import Store
from tasks.design import random_designs

SETTINGS = """name: tiny
throws: {n_throws: 4, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 20, batch_size: 64}
ensemble: {n_members: 2}
grid:
  depths: [1.0]
  single_member_depths: []
  n_trials: 1
rollout: {n_settle: 5, n_measure: 20}
work: {engine: reference, generations_per_item: 2}
evolution: {n_generations: 2, afpo: {population_size: 4}}
transfer: {n_generations: 2}
"""


@pytest.fixture
def settings(tmp_path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(SETTINGS)
    return path


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A finished study: its settings file and its store."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "tiny.yaml").write_text(SETTINGS)
    options = ["--settings", str(folder / "tiny.yaml"), "--store", str(folder / "store")]
    assert call("study", "--workers", "0", *options) == 0
    return options


@pytest.fixture
def design(tmp_path) -> Path:
    path = tmp_path / "design.json"
    path.write_text(json.dumps(design_document(random_designs(1, np.random.default_rng(3)))))
    return path


def refused(capsys, *arguments: str) -> str:
    assert call(*arguments) == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    return said


def check_headline(said: str, page: Path, store: str) -> None:
    """Check what a study shows at its end: figures in 80 columns, the page's address, and commands that exist."""
    heading, objective, scale, columns, _units, *arms, opened = said.strip().partition("\nNext:\n")[0].splitlines()
    assert heading.startswith("Champions of study tiny in True Slush, 1 m deep")
    assert objective == "selected for: displacement"
    assert scale == "1/8,000 of the paper’s evolution: the figures mean nothing"
    assert re.split("  +", columns) == ["evolved in", "depth", "predicted", "zero-shot", "of E", "adapted", "of E"]
    assert [arm.split(",")[0] for arm in arms] == ["True Slush", "Dry Land", "Residual Slush"]
    assert opened == f"Open: {page.as_uri()}"
    assert max(len(line) for line in (heading, columns, *arms)) <= 80
    advised = [line.strip() for line in said.partition("\nNext:\n")[2].splitlines()]
    for line, command in zip(advised, ("champions tiny", "export tiny", "ui tiny"), strict=True):
        assert f"puddle {command} --store {store} " in line


def test_a_study_from_the_command_line(study, capsys, tmp_path):
    assert call("status", *study) == 0
    said = capsys.readouterr().out
    assert "no process is driving it" in said
    for stage in ("collect", "train", "evolve", "transfer", "report"):
        assert f"  {stage:<9} done" in said
    assert call("study", "--workers", "0", *study) == 0
    page = Path(study[-1]) / "studies" / "tiny" / "report" / "index.html"
    check_headline(capsys.readouterr().out, page, study[-1])
    assert call("status", "--digests", *study) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum("history.parquet" in line for line in lines) == 6
    items = [json.loads(path.read_text()) for path in Path(study[-1]).glob("items/train/*/*/manifest.json")]
    assert {f"{item['digest']}  train/{item['record']['label']}/0" for item in items} <= set(lines)
    assert page.read_text().lower().startswith("<!doctype html>")


def test_simulate_reports_every_environment_and_films(study, design, capsys, tmp_path):
    for environment in ("dry_land", "true_slush", "residual_slush"):
        film = "mp4" if environment == "residual_slush" else "gif"
        out = tmp_path / f"{environment}.{film}"
        arguments = (str(design), "--environment", environment, "--depth", "1", "--out", str(out))
        assert call("simulate", *arguments, *study) == 0
        said = capsys.readouterr().out
        assert "root" in said and "centre of mass" in said and str(out) in said
        assert out.read_bytes()[:12].endswith(b"ftypisom") if film == "mp4" else out.read_bytes().startswith(b"GIF89a")
    assert "members" in said  # the last environment is residual_slush


def test_simulate_prints_the_simulated_seconds(study, design, capsys):
    arguments = (str(design), "--environment", "dry_land", "--depth", "1", "--set", "physics.time_step=0.05")
    assert call("simulate", *arguments, *study) == 0
    assert "Dry Land, 1 m deep, 1 s:" in capsys.readouterr().out  # 20 steps


def test_a_page_of_one_design_shows_the_networks_view(study, design, capsys, tmp_path):
    for environment, depth in (("dry_land", "1"), ("true_slush", "1"), ("residual_slush", "1")):
        out = tmp_path / f"{environment}.html"
        arguments = (str(design), "--environment", environment, "--depth", depth, "--out", str(out))
        assert call("simulate", *arguments, *study) == 0
        replays = json.loads(re.search(r'id="replays">(.*?)</script>', out.read_text()).group(1))
        assert len(replays) == (1 if environment == "dry_land" else 2)  # in True Slush, and in that of the networks
        for replay in replays:
            assert [overlay["unit"] for overlay in replay["overlays"]] == ["m/s²"]
            assert bool(replay["push"]) == (environment != "dry_land")
    alone = tmp_path / "alone.html"
    for store in (tmp_path / "none", Path(study[-1])):  # no store, and one without the networks of the preset
        arguments = (str(design), "--environment", "true_slush", "--depth", "1", "--out", str(alone))
        capsys.readouterr()
        assert call("simulate", *arguments, "--preset", "smoke", "--store", str(store)) == 0
        assert "network" not in capsys.readouterr().out
        assert "<canvas" in alone.read_text()


def test_simulate_names_a_damaged_network(study, design, capsys, tmp_path):
    store = tmp_path / "damaged"
    shutil.copytree(study[-1], store)
    network = min(store.glob("items/train/*/*/*.safetensors"))
    os.truncate(network, 100)
    arguments = (str(design), "--environment", "residual_slush", "--depth", "1", *study[:-1], str(store))
    assert str(network) in refused(capsys, "simulate", *arguments)


NO_NETWORKS = ("--set", "grid.environments=[true_slush]", "--set", "grid.single_member_depths=[]")


def test_simulate_names_settings_that_train_no_networks(design, settings, capsys, tmp_path):
    """No command trains any, so the message must not advise to run the study."""
    options = ("--depth", "1", "--settings", str(settings), "--store", str(tmp_path / "none"), *NO_NETWORKS)
    said = refused(capsys, "simulate", str(design), "--environment", "residual_slush", *options)
    assert "study tiny trains no networks" in said and "grid.environments" in said and "puddle study" not in said


def test_forecast_counts_the_remaining_work(study, settings, capsys, tmp_path):
    arguments = ("--settings", str(settings), "--set", "grid.environments=[dry_land]", "--cores", "64")
    assert call("forecast", *arguments, "--store", str(tmp_path / "none")) == 0
    said = capsys.readouterr().out
    assert "64 cores" in said and "evolve" in said and "2 generations" in said
    assert call("forecast", *study) == 0
    assert re.search(r"^evolve +done ", capsys.readouterr().out, flags=re.M)


@pytest.mark.parametrize("stage", ["train", "evolve", "assess"])
def test_a_stage_whose_inputs_are_missing(stage, settings, capsys, tmp_path):
    options = ("--settings", str(settings), "--store", str(tmp_path / "store"), "--workers", "0")
    said = refused(capsys, stage, *options)
    assert f"{stage} needs the results of collect" in said
    assert f"puddle collect --settings {settings} --store {tmp_path / 'store'}`" in said
    assert not (tmp_path / "store").exists()  # a refusal leaves nothing behind
    empty = Store.open(tmp_path / "store", create=True)
    refused(capsys, stage, *options)
    assert empty.studies() == empty.studies(recorded=False) == []


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("wobble: 3", "wobble"),
        ("seed: many", "seed"),
        ("grid: {depths: [-1.0]}", "depths"),
        ("grid: {depths: [deep]}", "depths"),
        ("grid: {depths: [.nan]}", "depths"),
        ("grid: {environments: [true_mud]}", "true_slush"),
        ("work: {engine: warp}", "batch"),
        ("evolution: {afpo: {random_share: 0.9}}", "random_share"),
    ],
)
def test_settings_mistakes_name_file_line_and_field(line, expected, capsys, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(f"name: mine\n{line}\n")
    said = refused(capsys, "study", "--settings", str(path), "--store", str(tmp_path / "store"))
    assert f"{path}:2" in said and expected in said
    assert not (tmp_path / "store").exists()


def test_unknown_words(capsys, tmp_path, design):
    assert "desk, laptop, paper, pontoon, row, row-small, smoke, tank" in refused(
        capsys, "study", "--preset", "desktop"
    )
    assert "No such command" in refused(capsys, "evolv")
    said = refused(capsys, "study", "--set", "grid.depth=[1]", "--store", str(tmp_path / "store"))
    assert "--set grid.depth" in said and "depths" in said
    said = refused(capsys, "simulate", str(design), "--environment", "mud", "--depth", "1")
    assert "true_slush, dry_land, residual_slush" in said


@pytest.mark.parametrize("depth", ["-1", "nan", "inf", "deep", "1e39", "1000.1"])
def test_invalid_depths(depth, design, capsys):
    reference = ("--set", "work.engine=reference")
    said = refused(capsys, "simulate", str(design), "--environment", "dry_land", "--depth", depth, *reference)
    assert "depth" in said


def test_invalid_designs(capsys, tmp_path, design):
    def refusal(text: str) -> str:
        path = tmp_path / "bad.json"
        path.write_text(text)
        said = refused(capsys, "simulate", str(path), "--environment", "dry_land", "--depth", "1")
        assert str(path) in said
        return said

    good = json.loads(design.read_text())
    assert "JSON" in refusal("{")
    assert "not a design" in refusal("[]")
    assert "version" in refusal(json.dumps({**good, "version": 2}))
    assert "unknown field wings" in refusal(json.dumps({**good, "wings": 2}))
    assert "missing field phase" in refusal(json.dumps({k: v for k, v in good.items() if k != "phase"}))
    assert "length_scale" in refusal(json.dumps({**good, "length_scale": [1, 2]}))
    assert "parent of link 1" in refusal(json.dumps({**good, "parent": [-1, 4, 0, 0, 0, 0]}))
    assert "parent" in refusal(json.dumps({**good, "parent": [-1, 10**30, 0, 0, 0, 0]}))
    assert "frequency is 7.0" in refusal(json.dumps({**good, "frequency": 7.0}))
    assert "motor_on" in refusal(json.dumps({**good, "motor_on": [0, 1, 1, 1, 1, 1]}))
    said = refused(capsys, "simulate", str(tmp_path / "none.json"), "--environment", "dry_land", "--depth", "1")
    assert "cannot be read" in said


@pytest.mark.timeout(60)
def test_paths_that_cannot_be_written_are_refused_before_the_work(capsys, tmp_path, design):
    (tmp_path / "folder.gif").mkdir()
    os.mkfifo(tmp_path / "pipe.gif")  # opening it waits for a reader
    (tmp_path / "device.gif").symlink_to("/dev/null")
    (tmp_path / "circle.gif").symlink_to("circle.gif")
    expected = {
        "film.mp5": "ends in .gif or .mp4 or .html",
        "none/film.gif": "in an existing folder",
        "folder.gif": "not a regular file",
        "pipe.gif": "not a regular file",
        "device.gif": "not a regular file",
        "circle.gif": "Too many levels of symbolic links",
        f"{'a' * 300}.gif": "File name too long",
        f"{'a/' * 3000}film.gif": "File name too long",
    }
    words = ("simulate", str(design), "--environment", "dry_land", "--depth", "1", "--out")
    for name, reason in expected.items():
        said = refused(capsys, *words, str(tmp_path / name))
        assert "--out" in said and reason in said and "store" not in said
    for name in list(expected)[-2:]:
        said = refused(
            capsys, "fabricate", str(design), "--store", str(tmp_path / "store"), "--out", str(tmp_path / name)
        )
        assert "File name too long" in said


def test_a_missing_or_newer_store(study, capsys, tmp_path):
    settings = study[:2]
    assert "expected a store" in refused(capsys, "status", *settings, "--store", str(tmp_path / "nowhere"))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("mine")
    assert "thesis.tex" in refused(capsys, "study", *settings, "--store", str(tmp_path / "full"))
    newer = tmp_path / "newer"
    shutil.copytree(study[-1], newer)
    document = json.loads((newer / "store.json").read_text())
    (newer / "store.json").write_text(json.dumps({**document, "version": 99}))
    assert "99" in refused(capsys, "study", *settings, "--store", str(newer))


def test_damaged_weights_are_computed_again(study, capsys, tmp_path):
    store = tmp_path / "store"
    shutil.copytree(study[-1], store)
    options = ("--workers", "0", *study[:2], "--store", str(store))
    weights = sorted(store.glob("items/train/*/*/weights.safetensors"))[0]
    intact = weights.read_bytes()
    weights.write_bytes(intact[:100] + bytes([intact[100] ^ 1]) + intact[101:])
    # Longer trials read the weights, find the damage, and have the weights computed again.
    longer = ("--set", "evolution.n_generations=4", "--set", "grid.environments=[residual_slush]")
    assert call("study", *options, *longer) == 0
    assert "weights.safetensors" in "".join(capsys.readouterr())
    assert weights.read_bytes() == intact


def test_a_foreign_manifest_is_computed_again(study, capsys, tmp_path):
    store = tmp_path / "store"
    shutil.copytree(study[-1], store)
    manifest = sorted(store.glob("items/collect/*/*/manifest.json"))[0]
    intact = json.loads(manifest.read_text())
    manifest.write_text("{}")
    assert call("study", "--workers", "0", *study[:2], "--store", str(store)) == 0
    assert str(manifest) in "".join(capsys.readouterr())
    assert json.loads(manifest.read_text())["digest"] == intact["digest"]


def test_single_members_evolve_only_at_depths_of_the_grid():
    grid = parse(Settings, "grid: {depths: [3.0], n_trials: 1}", name="three").grid
    assert {depth for _, depth, _ in grid.trials()} == {3.0}


@pytest.mark.parametrize(
    ("grid", "said"),
    [
        ("depths: [2.0, 1.0, 2.0]", "depths repeats a value: expected each value once"),
        ("depths: [2.0, 1.0, 3.0, 1.0000001]", "depths has 1.0 and 1.0000001, and both are shown as 1 m"),
        ("single_member_depths: [123.4567, 123.4568]", "single_member_depths has 123.4567 and 123.4568, and both"),
    ],
)
def test_depths_with_the_same_label_are_refused(grid, said):
    """Results are found by label: one trial's would stand for the other's."""
    with pytest.raises(PuddleError, match=re.escape(said)):
        parse(Settings, f"grid: {{{grid}}}", name="mine")
    assert parse(Settings, "grid: {depths: [123.456, 123.457]}", name="mine").grid.depths == (123.456, 123.457)


def test_workers_and_an_address_are_refused_together(study, capsys):
    for workers in ("0", "4"):
        assert call("study", *study, "--workers", workers, "--address", "head:6379") == 2
        assert f"got --workers {workers} with --address head:6379" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], {"address": None, "n_workers": None}),
        (["--workers", "2"], {"address": None, "n_workers": 2}),
        (["--address", "auto"], {"address": "auto", "n_workers": None}),
    ],
)
def test_a_study_runs_on_this_machine_unless_an_address_is_given(options, expected, monkeypatch):
    requested = []

    @with_options
    def command(execution: ExecutionOptions) -> None:
        with execution.cluster(on_ray=lambda **where: requested.append(where) or serial_cluster())():
            pass

    alone = typer.Typer()
    alone.command()(command)
    monkeypatch.setenv("RAY_ADDRESS", "http://of-another-tool:8265")
    alone(options, standalone_mode=False)
    assert requested == [expected]


def test_a_bug_ends_in_a_traceback_and_its_own_exit_code(capsys):
    def defective(arguments):
        raise ZeroDivisionError("ours")

    with pytest.raises(SystemExit) as ended:
        main(["study"], run=defective)
    assert ended.value.code == 70
    said = capsys.readouterr().err
    assert said.startswith("Traceback") and "in defective" in said and said.endswith("ZeroDivisionError: ours\n")
