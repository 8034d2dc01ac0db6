"""The command line as a user sees it: every mistake gives one clear message and exit code 2, never a traceback."""

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import WITHOUT_MLFLOW, call, refused

from pipeline.store.design_file import design_json
from pipeline.store.store import Store
from tasks.design import random_designs


@pytest.fixture(scope="module")
def finished(recorded, tmp_path_factory) -> list[str]:
    """Options for a finished study with networks."""
    root = shutil.copytree(recorded, tmp_path_factory.mktemp("study") / "store")
    return ["--study", "tiny", "--store", str(root)]


@pytest.fixture
def design(tmp_path) -> Path:
    path = tmp_path / "design.json"
    path.write_bytes(design_json(random_designs(1, np.random.default_rng(3))))
    return path


def in_environment(name: str) -> tuple[str, ...]:
    return "--environment", name, "--depth", "1"


def test_a_study_from_the_command_line(finished, capsys):
    """At its end it shows figures in 80 columns, the address of its page, and commands to try next."""
    store = Path(finished[-1])
    assert call("study", "--workers", "0", *WITHOUT_MLFLOW, *finished[1:]) == 0
    page = store / "studies" / "tiny" / "report" / "index.html"
    shown, _, advised = capsys.readouterr().out.strip().partition("\nNext:\n")
    heading, objective, scale, columns, _units, *arms, opened = shown.splitlines()
    assert heading.startswith("Champions of study tiny in True Slush, 1 m deep") and opened == f"Open: {page.as_uri()}"
    assert objective == "selected for: displacement" and scale.startswith("1/4,000 of the paper’s evolution")
    assert [arm.split(",")[0] for arm in arms][:3] == ["True Slush", "Dry Land", "Residual Slush"]
    assert max(len(line) for line in (heading, columns, *arms)) <= 80
    for line, command in zip(
        advised.splitlines(), ("champions tiny", "export tiny --out tiny", "ui tiny"), strict=True
    ):
        assert f"puddle {command} --store {store} " in line
    assert page.read_text().lower().startswith("<!doctype html>")
    assert call("status", *finished[1:]) == 0
    said = capsys.readouterr().out
    assert "no process is driving it" in said
    for stage in ("collect", "train", "evolve", "adapt", "transfer", "report"):
        assert f"  {stage:<9} done" in said


@pytest.mark.parametrize(
    ("environment", "film", "start"), [("dry_land", "gif", b"GIF89a"), ("residual_slush", "mp4", b"ftypisom")]
)
def test_simulate_reports_every_environment_and_films(environment, film, start, finished, design, capsys, tmp_path):
    out = tmp_path / f"film.{film}"
    shorter = ("--set", "physics.time_step=0.05") if film == "gif" else ()
    assert call("simulate", str(design), *in_environment(environment), "--out", str(out), *finished, *shorter) == 0
    said = capsys.readouterr().out
    assert "root" in said and "centre of mass" in said and str(out) in said
    assert (" 1 m deep, 1 s:" in said) == bool(shorter)  # 20 steps
    assert ("members" in said) == (environment == "residual_slush")
    assert start in out.read_bytes()[:12]


@pytest.mark.parametrize(("environment", "n_replays"), [("dry_land", 1), ("residual_slush", 2)])
def test_a_page_of_one_design_shows_the_networks_view(environment, n_replays, finished, design, tmp_path):
    """In True Slush, and in that of the networks."""
    out = tmp_path / "page.html"
    assert call("simulate", str(design), *in_environment(environment), "--out", str(out), *finished) == 0
    replays = json.loads(re.search(r'id="replays">(.*?)</script>', out.read_text()).group(1))
    assert len(replays) == n_replays
    assert all(replay["disagreement"]["most"] > 0 for replay in replays)


def test_a_page_of_one_design_without_networks(finished, design, capsys, tmp_path):
    for store in (tmp_path / "none", Path(finished[-1])):  # no store, and one without the networks of the preset
        where = ("--preset", "smoke", "--store", str(store), "--out", str(tmp_path / "alone.html"))
        assert call("simulate", str(design), *in_environment("true_slush"), *where) == 0
        assert "network" not in capsys.readouterr().out
        assert "<canvas" in (tmp_path / "alone.html").read_text()


def test_simulate_names_a_damaged_network_and_settings_that_train_none(finished, design, capsys, tmp_path):
    """No command trains any, so the message must not advise to run the study."""
    store = shutil.copytree(finished[-1], tmp_path / "damaged")
    network = min(store.glob("items/train/*/*/*.safetensors"))
    os.truncate(network, 100)
    words = ("simulate", str(design), *in_environment("residual_slush"), "--study", "tiny", "--store", str(store))
    assert str(network) in refused(capsys, *words)
    none = ("--set", "grid.environments=[true_slush]", "--set", "grid.single_member_depths=[]")
    said = refused(capsys, *words, *none)
    assert "study tiny trains no networks" in said and "grid.environments" in said and "puddle study" not in said


def test_a_stage_whose_inputs_are_missing(capsys, tmp_path):
    options = ("--preset", "smoke", "--store", str(tmp_path / "store"), "--workers", "0")
    said = refused(capsys, "assess", *options)
    assert "assess needs the results of collect" in said
    assert "Run `puddle collect` with the same options first" in said
    assert not (tmp_path / "store").exists()  # a refusal leaves nothing behind
    empty = Store.open(tmp_path / "store", create=True)
    refused(capsys, "assess", *options)
    assert empty.studies() == []


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("study", "--preset", "desktop"), "desk, fluid, laptop, paper, pontoon, row, row-small, smoke, tank"),
        (("evolv",), "No such command"),
        (("study", "--set", "grid.depth=[1]"), "--set grid.depth=[1]: grid.depth: unknown setting; did you mean"),
        (("simulate", "design.json", *in_environment("mud")), "expected one of"),
        (("simulate", "none.json", *in_environment("dry_land")), "none.json: No such file"),
        (("study", "--workers", "4", "--address", "head:6379"), "got --workers 4 with --address head:6379"),
    ],
)
def test_unknown_words(words, expected, design, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert expected in refused(capsys, *words)
    assert [path.name for path in tmp_path.iterdir()] == ["design.json"]


def test_an_invalid_design_is_named(design, capsys):
    design.write_text(json.dumps(json.loads(design.read_text()) | {"frequency": 7.0}))
    said = refused(capsys, "simulate", str(design), *in_environment("dry_land"))
    assert str(design) in said and "frequency is 7.0" in said


@pytest.mark.parametrize("name", ["film.mp5", "none/film.gif", "folder.gif", "pipe.gif"])
def test_paths_that_cannot_be_written_are_refused_before_the_work(name, capsys, tmp_path, design):
    (tmp_path / "folder.gif").mkdir()
    os.mkfifo(tmp_path / "pipe.gif")  # opening it waits for a reader
    said = refused(capsys, "simulate", str(design), *in_environment("dry_land"), "--out", str(tmp_path / name))
    assert "--out: " in said and name in said and "store" not in said
