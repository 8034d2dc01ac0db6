"""puddle collect --tracks: a data set of tracked throws, its key, and what is refused before anything is written."""

import gzip
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from command_line import WITHOUT_MLFLOW, call, refused
from small_study import labelled
from tank import filmed, write_tracks

from pipeline.commands.options import StudyOptions
from pipeline.errors import PuddleError
from pipeline.results.recorded_study import open_study
from pipeline.stages.collect import COLLECT
from pipeline.stages.tracked import check_tracks, report_lines, with_tracks
from tasks.bench.tracks import Tracks, residual_transitions
from tasks.bench.tracks.residuals import smooth_throws
from tasks.residual import MeasuredTransitions

SETTINGS = """name: tank
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 10, batch_size: 16}
ensemble: {n_members: 1}
grid: {depths: [1.0], environments: [residual_slush], single_member_depths: [], n_trials: 1}
evolution: {n_generations: 2, afpo: {population_size: 4}}
transfer: {n_generations: 1}
tracks: {file: tracks.csv}
throws: {source: tracks}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with tracks, settings and a store in which they are collected."""
    folder = tmp_path_factory.mktemp("tank")
    write_tracks(*filmed(4, seconds=0.5), folder / "tracks.csv")
    (folder / "plain.yaml").write_text(SETTINGS.partition("tracks:")[0])
    options = ["--settings", str(folder / "plain.yaml"), "--store", str(folder / "store"), "--workers", "0"]
    with pytest.MonkeyPatch.context() as briefly:
        briefly.setitem(residual_transitions.__kwdefaults__, "n_iterations", 10)
        assert call("collect", "--tracks", str(folder / "tracks.csv"), *options, *WITHOUT_MLFLOW) == 0
    return folder


def keys(settings) -> dict[str, str]:
    chains = {chain.identity: chain for chain in COLLECT.plan(settings)}
    return {of: COLLECT.item(settings, chain, 0, None, {}).key for of, chain in labelled(chains).items()}


def test_robots_of_tracks_are_tested_in_the_model_of_the_tank(folder, tmp_path, capsys) -> None:
    """With one member, the model is what the robots evolved in: they get as far as predicted, to rounding."""
    shutil.copytree(folder / "store", tmp_path / "store")
    where = ("tank", "--store", str(tmp_path / "store"), "--workers", "0")
    assert call("study", *where, *WITHOUT_MLFLOW) == 0
    said, progress = capsys.readouterr()
    assert "relative errors on throws held out of fit and training" in progress
    assert "of the way, expected at most 0.2: robots may go much less far" in progress
    page = (tmp_path / "store/studies/tank/report/index.html").read_text()
    shown = said + page.replace(page[page.index("<summary>Settings") : page.index("<summary>Software")], "")
    assert "Champions of study tank in the model of your tank" in said and "slush" not in said.replace("_slush", "")
    assert "Robots evolved for the model of your tank: tank" in page and "True Slush" not in shown
    study = open_study("tank", tmp_path / "store")
    assert study.settings.throws.source == "tracks" and study.settings.throws.n_throws == 4
    found = study.reader.throws
    assert isinstance(found, MeasuredTransitions) and np.unique(found.throw)[-4:].tolist() == [0, 1, 2, 3]
    (trial,) = study.trials()
    assert trial.environment == "residual_slush" and np.isfinite([trial.predicted, trial.adapted]).all()
    assert trial.zero_shot == pytest.approx(trial.predicted, abs=0.05)
    assert np.isfinite(study.simulate(study.champion("residual_slush", depth=1.0, trial=0)).displacement).all()
    said = refused(capsys, "fabricate", "--study", "tank", "--store", str(tmp_path / "store"))
    assert "of the way on throws that were held out, expected at most 0.2" in said and "--despite-errors" in said
    for command in ("adapt", "transfer"):
        assert call(command, *where, "--set", "target=flowing_slush", *WITHOUT_MLFLOW) == 0
    (trial,) = open_study("tank", tmp_path / "store").trials()
    assert np.isfinite([trial.zero_shot, trial.adapted]).all()
    kept = StudyOptions(study="tank", store=tmp_path / "store", tracks=folder / "tracks.csv").settings()
    assert kept.target == "flowing_slush"


def test_the_slush_stays_where_it_is_asked_for(folder) -> None:
    def target(*overrides: str) -> str:
        options = {"settings_file": folder / "plain.yaml", "tracks": folder / "tracks.csv"}
        return StudyOptions(**options, overrides=list(overrides)).settings().target

    assert target() == "tank_model"
    smoke = StudyOptions(preset="smoke", tracks=folder / "tracks.csv").settings()
    assert (smoke.target, smoke.grid.environments) == ("tank_model", ("dry_land", "residual_slush"))
    assert target("target=true_slush") == target("grid.environments=[true_slush,residual_slush]") == "true_slush"
    with pytest.raises(PuddleError, match="target: expected an environment of one medium, any of true_slush"):
        target("grid.environments=[designed_throws]")


def test_the_key_is_that_of_the_content_wherever_the_file_lies(folder, tmp_path) -> None:
    settings = open_study("tank", folder / "store").settings
    for name in ("tracks.csv", "tracks-bars.csv"):
        shutil.copy(folder / name, tmp_path / name)
    moved = with_tracks(settings, tmp_path / "tracks.csv")
    assert moved.tracks.file == str(tmp_path / "tracks.csv") and keys(moved) == keys(settings)
    with (tmp_path / "tracks-bars.csv").open("a") as file:
        file.write("99,0.07,0.07,0.098\n")
    assert keys(with_tracks(settings, tmp_path / "tracks.csv")) != keys(settings)
    for change in ({"length_unit": "mm"}, {"flip_x": True}):
        other = settings.model_copy(update={"tracks": settings.tracks.model_copy(update=change)})
        assert keys(other) != keys(settings)


@pytest.mark.parametrize("bars", ["tracks-bars.csv", "tracks.csv-bars.csv"])
def test_the_bars_lie_beside_a_compressed_file(bars, folder, tmp_path) -> None:
    (tmp_path / "tracks.csv.gz").write_bytes(gzip.compress((folder / "tracks.csv").read_bytes()))
    shutil.copy(folder / "tracks-bars.csv", tmp_path / bars)
    settings = with_tracks(open_study("tank", folder / "store").settings, tmp_path / "tracks.csv.gz")
    assert settings.throws.n_throws == 4 and settings.tracks.bars == str(tmp_path / bars)


def test_the_file_may_be_named_beside_other_settings_of_tracks(folder) -> None:
    changed = ["tracks.angle_unit=deg", "tracks.flip_x=true"]
    options = StudyOptions(settings_file=folder / "plain.yaml", overrides=changed, tracks=folder / "tracks.csv")
    tracks = options.settings().tracks
    assert (tracks.file, tracks.angle_unit, tracks.flip_x) == (str(folder / "tracks.csv"), "deg", True)


def test_what_is_collected_needs_no_file_and_one_that_changed_is_refused(folder, capsys) -> None:
    file = folder / "tracks.csv"
    content, words = file.read_bytes(), ("collect", "tank", "--store", str(folder / "store"))
    file.unlink()
    try:
        assert call(*words, "--workers", "0") == 0
        assert f"{file}: No such file" in refused(capsys, *words, "--set", "tracks.flip_x=true")
        file.write_bytes(content + b"\n")
        said = refused(capsys, *words, "--set", "tracks.flip_x=true")
        assert str(file) in said and "it has changed since the study was recorded" in said
    finally:
        file.write_bytes(content)


def test_what_was_dropped_and_repaired_is_said(folder) -> None:
    """Every other picture is shown twice, and angles are those of ellipses."""
    settings = open_study("tank", folder / "store").settings
    table, bars = filmed(4, rate=120.0)
    shown = np.arange(len(table.time)) // 2 * 2
    assert (table.throw[shown] == table.throw).all()
    spun = (table.angle + 9 * table.time)[shown] % np.pi
    given = replace(table, x=table.x[shown], y=table.y[shown], angle=spun)
    report = smooth_throws(given, bars, Tracks(file="tracks.csv"), settings.physics).report
    lines = report_lines([asdict(report)], settings, 1, 0)
    assert f"{len(shown) // 2} frames at 60 a second" in lines[0]
    assert any(line.startswith(f"warning: {len(shown) // 2} more frames were dropped") for line in lines)
    assert any("angles are known up to half a turn" in line for line in lines)


@pytest.mark.parametrize(
    ("edits", "overrides", "message"),
    [
        (("tracks.csv", "angle", "heading"), (), "without angle"),
        (("tracks-bars.csv", "mass", "weight"), (), "tracks-bars.csv: expected the columns throw, length, width, mass"),
        (("tracks-bars.csv", "\n1,", "\n9,"), (), "tracks-bars.csv: throw 1 has no bar: give its length"),
        ((), ("tracks.flip_y=true",), "bars fall freely upward"),
        ((), ("throws.source=simulation",), "throws.source is simulation and tracks names a file"),
        ((), ("tracks.file=no-such.csv",), "no-such.csv"),
    ],
)
def test_bad_tracks_are_refused_before_anything_is_written(
    edits, overrides, message: str, folder, tmp_path, capsys
) -> None:
    for name in ("tracks.csv", "tracks-bars.csv"):
        shutil.copy(folder / name, tmp_path / name)
    if edits:
        file, old, new = edits
        (tmp_path / file).write_text((tmp_path / file).read_text().replace(old, new, 1))
    (tmp_path / "settings.yaml").write_text(SETTINGS.replace("tracks.csv", str(tmp_path / "tracks.csv")))
    options = ["--settings", str(tmp_path / "settings.yaml"), "--store", str(tmp_path / "store"), "--workers", "0"]
    said = refused(capsys, "collect", *options, *(word for one in overrides for word in ("--set", one)))
    assert message in said
    assert not (tmp_path / "store").exists()


def test_the_sample_of_the_documentation_fits_the_preset() -> None:
    sample = Path(__file__).parents[3] / "docs" / "tank-sample.csv"
    settings = StudyOptions(preset="tank", tracks=sample).settings()
    assert settings.throws.n_throws == 50 and settings.network.form == "wetted"
    paths = check_tracks(settings)
    assert paths is not None and len(paths.throw) == 50


def test_tracks_without_bars(folder, tmp_path, capsys) -> None:
    options = ["--settings", str(folder / "plain.yaml"), "--store", str(tmp_path / "store"), "--workers", "0"]
    shutil.copy(folder / "tracks.csv", tmp_path / "tracks.csv")
    said = refused(capsys, "collect", "--tracks", str(tmp_path / "tracks.csv"), *options)
    assert "or a file tracks-bars.csv beside it" in said
