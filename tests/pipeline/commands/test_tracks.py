"""puddle collect --tracks: a data set of tracked throws, its key, and what is refused before anything is written."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import call, refused
from small_study import labelled
from tank import filmed, write_tracks

from pipeline.commands.options import StudyOptions
from pipeline.results.recorded_study import open_study
from pipeline.stages.collect import COLLECT, TRANSITIONS, read_transitions
from pipeline.stages.tracked import with_tracks
from pipeline.stages.train import TRAIN
from tasks.residual import MeasuredTransitions
from tasks.residual.rollouts import fit_medium
from tasks.tracks import residual_transitions

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
def collected(tmp_path_factory) -> tuple[Path, list[str]]:
    """A folder with tracks, settings and a store in which they are collected."""
    folder = tmp_path_factory.mktemp("tank")
    write_tracks(*filmed(4, seconds=0.5), folder / "tracks.csv")
    (folder / "plain.yaml").write_text(SETTINGS.partition("tracks:")[0])
    options = ["--settings", str(folder / "plain.yaml"), "--store", str(folder / "store"), "--workers", "0"]
    with pytest.MonkeyPatch.context() as briefly:
        briefly.setitem(fit_medium.__kwdefaults__, "n_first_iterations", 10)
        briefly.setitem(residual_transitions.__kwdefaults__, "n_iterations", 10)
        assert call("collect", "--tracks", str(folder / "tracks.csv"), *options) == 0
    return folder, options


def keys(settings) -> dict[str, str]:
    chains = {chain.identity: chain for chain in COLLECT.plan(settings)}
    return {of: COLLECT.item(settings, chain, 0, None, {}).key for of, chain in labelled(chains).items()}


def test_a_data_set_is_made_of_tracks(collected) -> None:
    folder, _ = collected
    study = open_study("tank", folder / "store")
    assert study.settings.throws.source == "tracks" and study.settings.throws.n_throws == 4
    ((part,),) = study.upstream["collect"].done.values()
    found = read_transitions([{TRANSITIONS: study.store.read(part, TRANSITIONS)}])
    assert isinstance(found, MeasuredTransitions) and np.unique(found.throw).tolist() == [0, 1, 2, 3]
    item = TRAIN.item(study.settings, TRAIN.plan(study.settings)[0], 0, None, study.upstream)
    inputs = {name: {of: study.store.read(part, of) for of in source.files} for name, source in item.inputs.items()}
    assert "errors.parquet" in TRAIN.compute(item, inputs)


def test_robots_evolve_from_tracks(collected, tmp_path) -> None:
    folder, _ = collected
    shutil.copytree(folder / "store", tmp_path / "store")
    for command in ("train", "pilot", "evolve", "transfer"):
        assert call(command, "--study", "tank", "--store", str(tmp_path / "store"), "--workers", "0") == 0
    (champion,) = open_study("tank", tmp_path / "store").champions().to_pylist()
    scores = [champion[name] for name in ("predicted", "zero_shot", "adapted")]
    assert champion["environment"] == "residual_slush" and np.isfinite(scores).all()


def test_the_key_is_that_of_the_content_wherever_the_file_lies(collected, tmp_path) -> None:
    folder, _ = collected
    settings = open_study("tank", folder / "store").settings
    for name in ("tracks.csv", "tracks-bars.csv"):
        shutil.copy(folder / name, tmp_path / name)
    moved = with_tracks(settings, tmp_path / "tracks.csv")
    assert moved.tracks.file == str(tmp_path / "tracks.csv") and keys(moved) == keys(settings)
    with (tmp_path / "tracks-bars.csv").open("a") as file:
        file.write("99,0.07,0.07,0.098\n")
    assert keys(with_tracks(settings, tmp_path / "tracks.csv")) != keys(settings)
    for change in ({"length_unit": "mm"}, {"fit": "steps"}):
        other = settings.model_copy(update={"tracks": settings.tracks.model_copy(update=change)})
        assert keys(other) != keys(settings)


def test_the_file_may_be_named_beside_other_settings_of_tracks(collected) -> None:
    folder, _ = collected
    changed = ["tracks.fit=steps", "tracks.flip_x=true"]
    options = StudyOptions(settings_file=folder / "plain.yaml", overrides=changed, tracks=folder / "tracks.csv")
    tracks = options.settings().tracks
    assert (tracks.file, tracks.fit, tracks.flip_x) == (str(folder / "tracks.csv"), "steps", True)


def test_what_is_collected_needs_no_file(collected, tmp_path, capsys) -> None:
    folder, _ = collected
    store = ["--store", str(folder / "store"), "--workers", "0"]
    (folder / "tracks.csv").rename(tmp_path / "elsewhere.csv")
    try:
        assert call("collect", "--study", "tank", *store) == 0
        message = refused(capsys, "collect", "--study", "tank", *store, "--set", "tracks.flip_x=true")
        assert f"{folder / 'tracks.csv'}: reading failed: No such file" in message
    finally:
        (tmp_path / "elsewhere.csv").rename(folder / "tracks.csv")


def test_tracks_that_changed_are_refused(collected, tmp_path, capsys) -> None:
    folder, _ = collected
    shutil.copytree(folder / "store", tmp_path / "store")
    settings = open_study("tank", folder / "store").settings
    other = tmp_path / "tracks.csv"
    other.write_bytes((folder / "tracks.csv").read_bytes() + b"\n")
    (tmp_path / "recorded.yaml").write_text(
        SETTINGS.partition("tracks:")[0]
        + f"throws: {{source: tracks}}\ntracks: {{file: '{other}', bars: '{settings.tracks.bars}', "
        f"sha256: {settings.tracks.sha256}, bars_sha256: {settings.tracks.bars_sha256}, flip_x: true}}\n"
    )
    options = ["--settings", str(tmp_path / "recorded.yaml"), "--store", str(tmp_path / "new"), "--workers", "0"]
    assert "it has changed since the study was recorded" in refused(capsys, "collect", *options)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("tracks.csv", "angle", "heading", "got none named angle: name the columns so"),
        ("tracks-bars.csv", "mass", "weight", "tracks-bars.csv: expected the columns throw, length, width, mass"),
        ("tracks-bars.csv", "\n1,", "\n9,", "tracks-bars.csv: throw 1 has no bar: give its length"),
        ("tracks.csv", "\n1,0.016667,", "\n1,0.000000,", "throw 1, frame 1: the time is 0 s after 0 s"),
        ("tracks.csv", "\n1,0.016667,", "\n1,0.016667,9,0,0\n1,0.02,", "throw 1, frame 1: the bar jumps at"),
        ("tracks.csv", "\n2,0.016667,", "\n2,0.016667,nan,0,0\n2,0.02,", "throw 2, frame 1: x is nan"),
        ("tracks.csv", "\n1,0.016667,", "\n1,,", "throw 1, frame 1: time is nan, expected a number"),
        ("tracks.csv", "\n2,0.016667,", "\n7,0.016667,", "throw 7 has 1 frame, expected at least 4"),
    ],
)
def test_bad_tracks_are_refused_before_anything_is_written(
    collected, tmp_path, capsys, file: str, old: str, new: str, message: str
) -> None:
    folder, _ = collected
    for name in ("tracks.csv", "tracks-bars.csv", "plain.yaml"):
        shutil.copy(folder / name, tmp_path / name)
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new, 1))
    options = ["--settings", str(tmp_path / "plain.yaml"), "--store", str(tmp_path / "store"), "--workers", "0"]
    said = refused(capsys, "collect", "--tracks", str(tmp_path / "tracks.csv"), *options)
    assert message in said and str(tmp_path) in said
    assert not (tmp_path / "store").exists()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["tracks.length_unit=mm"], "check tracks.length_unit (m or mm), tracks.scaling and tracks.metres_per_metre"),
        (["tracks.flip_y=true"], "bars fall freely upward"),
        (["tracks.angle_unit=deg"], "so that every bar would be upright: check tracks.angle_unit"),
        (["tracks.scaling=none"], "which is 1 to 3 m: check tracks.length_unit"),
        (["tracks.angle_unit=deg", "tracks.metres_per_metre=0.01"], "check tracks.length_unit"),
        (["replicates=1", "designed_throws.source=tracks"], "only throws can be tracked"),
        (["throws.source=simulation"], "throws.source is simulation and tracks names a file"),
    ],
)
def test_settings_that_do_not_fit_the_tracks_are_refused(collected, tmp_path, capsys, overrides, message: str) -> None:
    folder, _ = collected
    (tmp_path / "settings.yaml").write_text(SETTINGS.replace("tracks.csv", str(folder / "tracks.csv")))
    options = ["--settings", str(tmp_path / "settings.yaml"), "--store", str(tmp_path / "store"), "--workers", "0"]
    said = refused(capsys, "collect", *options, *(word for one in overrides for word in ("--set", one)))
    assert message in said
    assert not (tmp_path / "store").exists()


def test_tracks_without_bars_and_files_that_are_not_there(collected, tmp_path, capsys) -> None:
    folder, _ = collected
    options = ["--settings", str(folder / "plain.yaml"), "--store", str(tmp_path / "store"), "--workers", "0"]
    shutil.copy(folder / "tracks.csv", tmp_path / "tracks.csv")
    said = refused(capsys, "collect", "--tracks", str(tmp_path / "tracks.csv"), *options)
    assert "or a file tracks-bars.csv beside it" in said
    assert "no-such.csv" in refused(capsys, "collect", "--tracks", str(tmp_path / "no-such.csv"), *options)
