"""report on a real study: which replays there are, their overlays, and the files of the report."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.report import wording
from pipeline.stages.analyses.analysis_tables import read_table
from pipeline.stages.analyses.specs import EXPLOITERS, INSTRUMENTS
from pipeline.stages.environments import MEMBER, simulation_spec
from pipeline.stages.part import PartId
from pipeline.stages.proposed_design import ANALYSED
from pipeline.stages.report import EVOLUTION, PAGE, REPORT
from pipeline.stages.report_findings import findings
from pipeline.stages.report_replays import replays_of
from pipeline.stages.transfer import SCORE, SCORED, read_scores
from pipeline.store.encoding import decode_json, encode_json
from pipeline.workflow.identity import Arm, InputName, TrialId, trials_of
from pipeline.workflow.stage import Execution, Failure
from tasks.world import ENVIRONMENTS


def inputs_of(store, item):
    return {name: {f: store.read(of.manifest, f) for f in of.files} for name, of in item.inputs.items()}


@pytest.fixture(scope="module")
def page(study, settings):
    """Settings and inputs of the page."""
    store, upstream = study
    chain = next(chain for chain in REPORT.plan(settings) if chain.label == PAGE)
    item = REPORT.item(settings, chain, 0, None, upstream)
    return item.spec.settings, inputs_of(store, item)


def replays(settings, inputs):
    simulation = simulation_spec(settings, *ENVIRONMENTS)
    return replays_of(simulation, trials_of(settings, "transfer"), Execution(), inputs)


def analysed(kind, environment=None):
    """The name of the input that is an analysis, of an arm at 1 m if one is named."""
    return InputName(ANALYSED, PartId(kind, Arm(environment, 1.0) if environment else None))


def by_environment(replays):
    return {(replay.environment, replay.seen_in): replay for replay in replays}


def test_every_arm_is_filmed_in_true_slush_and_where_it_evolved(page):
    spec, inputs = page
    found = by_environment(replays(spec, inputs))
    films = {
        environment: read_table(inputs[analysed(INSTRUMENTS, environment)], "films")
        for environment in ("dry_land", "residual_slush", "single_member")
    }
    median = {name: f"Residual Slush (member {table['member'][1]})" for name, table in films.items()}
    assert set(found) == {
        ("true_slush", "True Slush"),
        ("dry_land", "True Slush"),
        ("dry_land", "Dry Land"),
        ("residual_slush", "True Slush"),
        ("residual_slush", median["residual_slush"]),
        ("single_member", "True Slush"),
        ("single_member", median["single_member"]),
    }
    for (environment, seen_in), replay in found.items():
        moved = replay.frames[-1, 0, 0] - replay.frames[0, 0, 0]
        if environment != "true_slush":
            row = 0 if seen_in == "True Slush" else 1
            assert moved == pytest.approx(films[environment]["displacement"][row], abs=1e-5)
        assert replay.hallucinated == seen_in.startswith("Residual") and (replay.push is None) == (
            seen_in == "Dry Land"
        )
        assert [overlay.unit for overlay in replay.overlays] == ["m/s²", "× typical"]
    home, slush = found["residual_slush", median["residual_slush"]], found["residual_slush", "True Slush"]
    assert home.title == slush.title and not np.array_equal(home.push, slush.push)


def test_the_member_filmed_predicts_the_median(page):
    """The lower of two members: the one that predicts less."""
    _, inputs = page
    table = read_table(inputs[analysed(INSTRUMENTS, "residual_slush")], "films")
    ranked = read_table(inputs[analysed(EXPLOITERS)], "exploiters")
    mine = (ranked["kind"] == "champion") & (ranked["environment"] == "residual_slush")
    by_member = ranked["by_member"][mine & (ranked["trial"] == table["trial"][1])][0]
    assert table["member"][1] == np.argmin(by_member)
    assert table["displacement"][1] == by_member.min()


def test_without_networks_and_analysis_there_is_what_needs_none(page):
    spec, inputs = page
    bare = {name: files for name, files in inputs.items() if name.role not in (MEMBER, ANALYSED)}
    found = by_environment(replays(spec, bare))
    assert set(found) == {
        ("dry_land", "Dry Land"),
        *((name, "True Slush") for name in ("true_slush", "dry_land", "residual_slush", "single_member")),
    }
    assert not any(replay.overlays for replay in found.values())


def test_films_and_throws_take_as_long_as_in_the_simulation(page, settings):
    spec, inputs = page
    slow = spec.model_copy(update={"physics": spec.physics.model_copy(update={"time_step": 0.05})})
    for replay in replays(slow, inputs):
        assert replay.duration == pytest.approx(spec.rollout.n_measure * 0.05)
    found = findings(inputs, slow, None)
    assert found.throws.seconds == pytest.approx(settings.throws.n_steps * 0.05)


def test_champions_without_scores_in_true_slush_are_filmed_where_they_evolved(page):
    spec, inputs = page
    unseen = {}
    for name, files in inputs.items():
        if name.role == SCORED:
            scores = decode_json(files[SCORE], name.label) | {"zero_shot": None, "zero_shot_com": None}
            files = {**files, SCORE: encode_json(scores)}
        unseen[name] = files
    assert {seen_in for _, seen_in in by_environment(replays(spec, unseen))} & {"True Slush"} == set()
    assert len(replays(spec, unseen)) == 3


def test_each_replay_is_a_gif_and_an_mp4_and_mlflow_gets_the_small_ones(study, settings):
    store, upstream = study
    summary = REPORT.summarise(settings, upstream["report"], store)
    folder = store.export_path(settings.name)
    elsewhere = ("dry_land", "residual_slush", "single_member")
    names = [f"replay-{name}-1m{home}" for name in elsewhere for home in ("", "-at-home")]
    names += ["replay", "replay-true_slush-1m"]
    assert {path.name for path in folder.glob("*.gif")} == {f"{name}.gif" for name in names}
    assert {path.name for path in folder.glob("*.mp4")} == {f"{name}.mp4" for name in names}
    assert {name for name in summary.artifacts if name.endswith(".gif")} == {"replay.gif"}
    assert {f"{name}.mp4" for name in names} | {PAGE} <= set(summary.artifacts)
    listed = [json.loads(path.read_text()) for path in folder.glob("films-*.json")]
    assert sorted(name for listing in listed for name in listing) == sorted(names)
    assert not any(name.startswith("films-") for name in summary.artifacts)
    scores = read_scores(settings, upstream["transfer"], store)
    of_dry_land = [trial for trial in scores if trial.environment == "dry_land"]
    best = max(of_dry_land, key=lambda trial: scores[trial].zero_shot).index
    films = {trial: set(films) for trial, films in summary.films.items()}
    both = {"replay-dry_land-1m.mp4", "replay-dry_land-1m-at-home.mp4"}
    assert films[TrialId("evolve", "dry_land", 1.0, best)] == both | {"replay.html"}
    assert set(films) == set(trials_of(settings, "evolve"))


def test_every_trial_has_a_replay_of_its_champion(study, settings):
    store, upstream = study
    films = REPORT.summarise(settings, upstream["report"], store).films
    for trial, scores in read_scores(settings, upstream["transfer"], store).items():
        page = films[trial.in_stage("evolve")]["replay.html"].decode()
        assert f"trial {trial.index}</h1>" in page and "http" not in page.replace("http-equiv", "")
        assert f"True Slush, 1 m deep: {wording.number(scores.zero_shot)} m in" in page


def test_an_arm_without_a_champion_leaves_no_film_and_no_failure(study, settings):
    store, upstream = study
    chain = next(chain for chain in REPORT.plan(settings) if chain.label == "films/residual_slush/1m")
    item = REPORT.item(settings, chain, 0, None, upstream)
    none = {SCORE: encode_json({"status": "no champion: every design of the trial diverged"})}
    inputs = {name: none if name.role == SCORED else files for name, files in inputs_of(store, item).items()}
    assert REPORT.compute(item.job, inputs) == {"films-residual_slush-1m.json": encode_json({})}


def test_failed_and_untried_work_items_are_listed_apart(study, settings):
    _, upstream = study
    first, second = trials_of(settings, "transfer")[:2]
    reasons = Failure("failed after 2 attempts at a: not possible: an error"), Failure("evolve of a", tried=False)
    lost = dict(zip((first, second), reasons, strict=True))
    chain = next(chain for chain in REPORT.plan(settings) if chain.label == PAGE)
    upstream = {**upstream, "transfer": replace(upstream["transfer"], failed=lost)}
    spec = REPORT.item(settings, chain, 0, None, upstream).spec
    assert spec.failed == (f"transfer: {first.label} {lost[first]}",)
    assert spec.not_possible == (f"transfer: {second.label} not possible: evolve of a",)


def test_segments_of_a_very_long_trial_stay_in_their_order(study, settings):
    """The curve's parts are joined in the order of the inputs."""
    _, upstream = study
    trial, segments = next(iter(upstream["evolve"].done.items()))
    long = replace(upstream["evolve"], done={trial: segments[:1] * 10_001})
    chain = next(chain for chain in REPORT.plan(settings) if chain.label == PAGE)
    inputs = REPORT.item(settings, chain, 0, None, {**upstream, "evolve": long}).inputs
    assert [name.index for name in inputs if name.role == EVOLUTION] == list(range(10_001))
