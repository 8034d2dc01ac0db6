"""report on a real study: which replays there are, their overlays, and the files of the report."""

from dataclasses import replace

import numpy as np
import pytest
from small_study import inputs_of

from pipeline.report.page import robot_address
from pipeline.report.render import typeset
from pipeline.stages.files import SCORE
from pipeline.stages.reader import data_spec, read_inputs, read_study
from pipeline.stages.replays import replays_of
from pipeline.stages.report import FILM, PAGE, REPORT
from pipeline.store.encoding import decode_json, encode_json
from pipeline.workflow.identity import trials_of
from pipeline.workflow.stage import Execution, Failure


def item_of(label, settings, upstream):
    chain = next(chain for chain in REPORT.plan(settings) if chain.label == label)
    return REPORT.item(settings, chain, 0, None, upstream)


@pytest.fixture(scope="module")
def inputs(study, settings):
    """Inputs of the page."""
    store, upstream = study
    return inputs_of(store, item_of(PAGE, settings, upstream))


def best(settings, inputs):
    """The replays of the best champions, by where they evolved and where they are seen."""
    study = read_inputs(data_spec(settings, trials_of(settings, "transfer")), Execution(), inputs)
    return {(one.environment, one.seen_in): one for one in replays_of(study) if one.best}


def with_scores(inputs, **changes):
    return {
        name: {**files, SCORE: encode_json(decode_json(files[SCORE], name.label) | changes)}
        if name.role == "champions"
        else files
        for name, files in inputs.items()
    }


def test_the_best_of_every_arm_is_seen_in_true_slush_and_where_it_evolved(settings, inputs):
    found = best(settings, inputs)
    at_home = {name: seen_in for name, seen_in in found if "(member " in seen_in}
    arms = ("true_slush", "dry_land", "residual_slush", "single_member")
    assert at_home["residual_slush"].startswith("Residual Slush (member ")
    assert at_home["single_member"].startswith("Single member (member ")
    assert set(found) == {*((name, "True Slush") for name in arms), ("dry_land", "Dry Land"), *at_home.items()}
    for (_, seen_in), replay in found.items():
        assert replay.hallucinated == ("(member " in seen_in)
        assert replay.disagreement.shape == replay.frames.shape[:2]
        names = {"True Slush": "true_slush", "Dry Land": "dry_land", at_home["single_member"]: ""}
        assert replay.command == names.get(seen_in, "residual_slush")  # what `simulate` shows
    home, slush = found["residual_slush", at_home["residual_slush"]], found["residual_slush", "True Slush"]
    assert home.title == slush.title and not np.array_equal(home.frames, slush.frames)


def test_overrated_champions_are_seen_where_they_evolved_too(settings, inputs):
    study = read_inputs(data_spec(settings, trials_of(settings, "transfer")), Execution(), inputs)
    best = {one.robot for one in replays_of(study) if one.best}
    keys = [one.key for one in study.champions if one.environment == "residual_slush"]
    (other,) = [key for key in keys if robot_address(*key) not in best][:1]
    target, home = (one for one in replays_of(study, {other}) if one.robot == robot_address(*other))
    assert (target.seen_in, target.title) == ("True Slush", home.title) and "(member " in home.seen_in
    assert home.disagreement.shape == home.frames.shape[:2]


def test_without_networks_and_analysis_there_is_what_needs_none(settings, inputs):
    bare = {name: files for name, files in inputs.items() if name.role not in ("networks", "tables")}
    found = best(settings, bare)
    assert set(found) == {("dry_land", "Dry Land"), *((name, "True Slush") for name in ("true_slush", "dry_land"))}
    assert all(replay.disagreement is None for replay in found.values())


def test_champions_without_scores_in_true_slush_are_shown_where_they_evolved(settings, inputs):
    unseen = with_scores(inputs, zero_shot=None, zero_shot_com=None)
    assert {seen_in for _, seen_in in best(settings, unseen)} & {"True Slush"} == set()


def test_there_is_one_film_and_a_replay_of_every_champion(study, settings):
    store, upstream = study
    summary = REPORT.summarise(settings, upstream, store)
    folder = store.export_path(settings.name)
    assert {path.name for path in folder.glob("*.gif")} | {path.name for path in folder.glob("*.mp4")} == {
        f"{FILM}.gif",
        f"{FILM}.mp4",
    }
    assert {f"{FILM}.mp4", f"{FILM}.gif", PAGE, "scores.csv"} <= set(summary.artifacts)
    assert not any(name.startswith("robot-") for name in summary.artifacts)
    trials = zip(upstream["transfer"].done, read_study(settings, upstream, store).trials, strict=True)
    for trial, one in trials:
        page = summary.films[trial.in_stage("evolve")]["replay.html"].decode()
        assert f"trial {trial.index}</h1>" in page and "http" not in page.replace("http-equiv", "")
        assert typeset(f"True Slush, 1 m deep: {one.zero_shot:z.1f} m in") in page


def test_a_study_without_a_champion_has_no_film_and_no_failure(study, settings):
    store, upstream = study
    item = item_of("film", settings, upstream)
    inputs = with_scores(inputs_of(store, item), status="no champion: every design of the trial diverged")
    assert REPORT.compute(item, inputs) == {"replay.json": encode_json({"shown": []})}


def test_failed_and_untried_work_items_are_listed_apart(study, settings):
    _, upstream = study
    first, second = trials_of(settings, "transfer")[:2]
    reasons = Failure("failed after 2 attempts at a: not possible: an error"), Failure("evolve of a", tried=False)
    lost = dict(zip((first, second), reasons, strict=True))
    spec = item_of(PAGE, settings, {**upstream, "transfer": replace(upstream["transfer"], failed=lost)}).spec
    assert spec.failed == (f"transfer: {first.label} {lost[first]}",)
    assert spec.not_possible == (f"transfer: {second.label} not possible: evolve of a",)
