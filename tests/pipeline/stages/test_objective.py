"""Studies with another objective than the paper's: what is selected for it, and what states it."""

import json
import re
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from command_line import call
from pydantic_core import to_jsonable_python
from small_study import labelled, run, silent

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.results import recorded_study
from pipeline.results.comparisons import compare_studies
from pipeline.results.recorded_study import open_study
from pipeline.stages import environments
from pipeline.stages.evolve import EVOLVE
from pipeline.stages.files import CURVE, HISTORY
from pipeline.stages.segments import population_of
from pipeline.store.store import Store
from pipeline.workflow.record import DrivenStudy, settings_of
from pipeline.workflow.stage import Execution, StoredFiles
from tasks.design import Designs
from tasks.evolution import OBJECTIVES, Objective
from tasks.simulation import Conditions, simulate
from tasks.world import Physics

SETTINGS = """
name: fast
grid: {depths: [1.0], environments: [true_slush, dry_land], single_member_depths: [], n_trials: 1}
rollout: {n_settle: 5, n_measure: 31}
evolution: {n_generations: 2, objective: second_half_speed, afpo: {population_size: 4}}
transfer: {n_generations: 2}
assess: {n_designs: 4}
"""


@pytest.fixture(scope="module")
def settings():
    return parse(Settings, SETTINGS, name="fast")


@pytest.fixture(scope="module")
def fast(tmp_path_factory, settings):
    store = Store.open(tmp_path_factory.mktemp("fast") / "store", create=True)
    with serial_cluster() as cluster:
        return store, run(settings, store, cluster)


@pytest.mark.parametrize("stage", ["evolve", "adapt"])
def test_designs_and_adapted_controllers_are_selected_for_it(fast, settings, stage):
    store, upstream = fast
    for trial, (segment, *_) in upstream[stage].done.items():
        files = {name: store.read(segment, name) for name in segment.files}
        population = population_of(files)
        home = trial.environment if stage == "evolve" else "true_slush"
        simulation = environments.simulation_spec(settings, home)
        environment = environments.build_environment(simulation.media, home, 1.0, {})
        rollouts = environments.roll_out(simulation, Execution(), environment, population.designs)
        np.testing.assert_array_equal(population.fitness, rollouts.second_half_speed)
        history = HISTORY.read([files])
        assert history["fitness"].max() == population.fitness[population.champion()]
        assert (history["fitness"] != history["displacement"][:, 0]).any()


def test_tables_and_the_page_name_it_and_state_its_unit(fast, settings, tmp_path):
    store, upstream = fast
    lines = EVOLVE.summarise(settings, upstream, store).lines
    assert lines[0] == "fitness: speed in the second half [m/s]"
    (segment,) = labelled(upstream["evolve"].done)["dry_land/1m/trial-0"]
    for name, column in ((HISTORY.name, "fitness"), (CURVE.name, "best_fitness")):
        path = tmp_path / name
        path.write_bytes(store.read(segment, name))
        assert json.loads(pq.read_schema(path).metadata[b"puddle"])["units"][column] == "m/s"
    (done,) = labelled(upstream["report"].done)["index.html"]
    page = store.read(done, "index.html").decode()
    assert "speed in the second half [m/s]" in page
    assert "to travel as far" not in page
    assert "best fitness [m/s]" in store.read(done, "fitness_curves.svg").decode()


def straightness(rollouts):
    """Displacement of the root by the length of its path, with a trace of every member."""
    path = rollouts.trace[..., rollouts.n_settle - 1 :, 0, :2].astype(np.float64)
    return abs(rollouts.displacement) / np.linalg.norm(np.diff(path, axis=-2), axis=-1).sum(axis=-1)


CARRIER = "displacement_per_energy"  # settings know the names that are registered before they are declared
OWN = {"straightness": Objective(CARRIER, "Straightness", "", straightness, trace=True)}


@pytest.fixture(scope="module", params=[*OWN, "mean_over_depths", CARRIER])  # the last leaves all as it was
def scored(request, tmp_path_factory, settings):
    """A study with an objective, the results of its stages, and a function that scores a design."""
    with pytest.MonkeyPatch.context() as patch:
        name = CARRIER if request.param in OWN else request.param
        patch.setitem(OBJECTIVES, name, OWN.get(request.param, OBJECTIVES[name]))
        depths = (0.0, 1.0) if request.param == "mean_over_depths" else None
        evolution = settings.evolution.model_copy(update={"objective": name, "objective_depths": depths})
        environments_ = ("true_slush", "dry_land", "randomised_slush")
        grid = settings.grid.model_copy(update={"environments": environments_, "n_trials": 2})
        settings = settings.model_copy(update={"evolution": evolution, "grid": grid})
        store = Store.open(tmp_path_factory.mktemp("scored") / "store", create=True)
        with serial_cluster() as cluster:
            upstream = run(settings, store, cluster)
        DrivenStudy(settings, store, silent).update(upstream)
        known = dict.fromkeys(OWN, settings)  # unlike those that are registered before settings are declared
        patch.setattr(
            recorded_study,
            "settings_of",
            lambda record: known.get(record.settings["evolution"]["objective"]) or settings_of(record),
        )

        def score(design, home):
            simulation = environments.simulation_spec(settings, home)
            at = environments.build_environment(simulation.media, home, 1.0, {})
            found = [
                settings.evolution.maximised.score(
                    environments.roll_out(
                        simulation, Execution(), replace(at, depth=depth), design, trace=True, motor_work=True
                    )
                )
                for depth in depths or (1.0,)
            ]
            return np.mean(found, axis=0)

        yield open_study("fast", store.root), upstream, score


def test_champions_are_scored_by_it_in_the_target(scored):
    study, _, score = scored
    best = {}
    for row in study.champions().to_pylist():
        design = study.champion(row["environment"], depth=1.0, trial=row["trial"])
        by_member = score(design, row["environment"])
        assert row["predicted_score"] == by_member.mean()
        assert row["fitness"] == pytest.approx(by_member.mean() - by_member.std())
        assert row["predicted_sd_score"] == (by_member.std() if len(by_member) > 1 else None)
        assert row["zero_shot_score"] == score(design, "true_slush")[0]
        assert row["zero_shot"] == study.simulate(design, depth=1.0).displacement[0]
        adapted = study.champion(row["environment"], depth=1.0, trial=row["trial"], adapted=True)
        assert row["adapted_score"] == score(adapted, "true_slush")[0]
        best.setdefault(row["environment"], []).append(row["zero_shot_score"])
    for row in study.table("transfer").to_pylist():
        assert row["zero_shot"] == pytest.approx(np.mean(best[row["environment"]]))
    assert "paper" not in study.tables
    unit = study.settings.evolution.maximised.unit.encode()
    assert {study.table(name).field(column).metadata[b"unit"] for name, column in SCORES} == {unit}
    assert study.champions().field("zero_shot_score").metadata[b"unit"] == unit


SCORES = (("scores", "zero_shot"), ("transfer", "adapted"), ("robustness", "starts"))


def test_the_best_by_it_is_listed_first(scored, capsys):
    study, upstream, _ = scored
    objective = study.settings.evolution.maximised
    assert call("champions", "fast", "--store", str(study.store.root)) == 0
    said = capsys.readouterr().out
    assert f"champions by zero-shot {objective.label.lower()} in True Slush" in said
    rows = sorted(study.champions().to_pylist(), key=lambda row: -row["zero_shot_score"])
    first = next(line for line in said.splitlines() if re.search(r" 1 +[01] ", line))
    assert f"{rows[0]['zero_shot_score']:z.2f}".replace("-", "−") in first
    (done,) = labelled(upstream["report"].done)["index.html"]
    page, words = study.store.read(done, "index.html").decode(), objective.label.lower()
    assert f"the {words} of zero-shot champions was on average" in page and f"its {words} there" in page
    heading = f"zero-shot [{objective.unit}]" if objective.unit else "zero-shot"
    assert f">{heading}</th>" in page
    label = f"{words} in True Slush [{objective.unit}]" if objective.unit else f"{words} in True Slush"
    assert label in study.store.read(done, "transfer_at_depth.svg").decode()


def test_studies_of_different_objectives_are_compared_by_displacement(fast, settings, scored, tmp_path):
    (store, upstream), (study, *_) = fast, scored
    DrivenStudy(settings, store, silent).update(upstream)
    compared = compare_studies(study, open_study("fast", store.root))
    assert compared.objective.name == "displacement"
    row = next(row for row in compared.rows if row.a == "dry_land/zero_shot")
    moved = study.table("champions", environment="dry_land")["zero_shot"].to_numpy()
    assert row.of_a.value == pytest.approx(moved.mean())


def evolved(settings, tmp_path):
    """Evolve designs, and return the history of each trial with its environment."""
    store = Store.open(tmp_path / "store", create=True)
    with serial_cluster() as cluster:
        upstream = run(settings, store, cluster, [EVOLVE])
    for trial, segments in upstream["evolve"].done.items():
        history = HISTORY.read([StoredFiles(store, segment) for segment in segments])
        simulation = environments.simulation_spec(settings, trial.environment)
        environment = environments.build_environment(simulation.media, trial.environment, 1.0, {})
        yield history, simulation, environment


@pytest.mark.parametrize("designs_per_batch", ["null", "3"])
def test_a_generalist_is_selected_for_its_mean_over_depths(settings, tmp_path, designs_per_batch):
    """Depths of the objective may differ from the trial's own, at which displacement is recorded."""
    changes = ["evolution.objective=mean_over_depths", "evolution.objective_depths=[0,2,5]", "work.engine=reference"]
    changes.append(f"work.designs_per_batch={designs_per_batch}")
    settings = parse(Settings, settings.model_dump_json(), name="fast", overrides=changes)
    assert settings.selected_for == "mean displacement over depths of 0, 2 and 5 m"
    for history, simulation, environment in evolved(settings, tmp_path):
        moved = {
            depth: environments.roll_out(
                simulation, Execution(), replace(environment, depth=depth), Designs.from_arrays(history)
            ).displacement
            for depth in (0.0, 1.0, 2.0, 5.0)
        }
        np.testing.assert_array_equal(history["displacement"][:, 0], moved[1.0])
        np.testing.assert_array_equal(history["fitness"], np.mean([moved[of] for of in (0.0, 2.0, 5.0)], axis=0))
    (first, *_) = EVOLVE.plan(settings)
    assert to_jsonable_python(first.spec)["fitness"]["conditions"] == [
        to_jsonable_python(Conditions(of)) for of in (0, 2, 5)
    ]
    (paper, *_) = EVOLVE.plan(parse(Settings, SETTINGS, name="fast", overrides=["work.engine=reference"]))
    assert first.weight == 4 * paper.weight  # rollouts of each design: three depths and the trial's own


def test_a_robust_design_is_selected_for_its_mean_over_starts_and_steps(settings, tmp_path):
    changes = ["evolution.objective=robust_displacement"]
    settings = parse(Settings, settings.model_dump_json(), name="fast", overrides=changes)
    steps = settings.rollout
    for history, _, environment in evolved(settings, tmp_path):
        moved = []
        for n_substeps, start in ((1, 0), (2, 1)):
            designs = Conditions(start=start).of_designs(Designs.from_arrays(history))
            physics = Physics(time_step=1 / 60 / n_substeps)
            n_settle, n_measure = (n * n_substeps for n in (steps.n_settle, steps.n_measure))
            at = {"engine": "reference", "n_settle": n_settle, "n_measure": n_measure, "physics": physics}
            moved.append(simulate(designs, environment, **at).displacement)
        np.testing.assert_array_equal(history["displacement"][:, 0], moved[0])
        np.testing.assert_array_equal(history["fitness"], np.mean(moved, axis=0))
    (first, *_), (paper, *_) = (EVOLVE.plan(of) for of in (settings, parse(Settings, SETTINGS, name="fast")))
    assert first.weight == 3 * paper.weight
