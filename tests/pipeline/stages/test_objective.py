"""Studies with another objective than the paper's: what is selected for it, and what states it."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from small_study import labelled, run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.stages import environments
from pipeline.stages.analyses.analysis_tables import read_table
from pipeline.stages.evolve import EVOLVE
from pipeline.stages.segments import CURVE, HISTORY, POPULATION, champion_of, population_of
from pipeline.stages.transfer import SCORE, TRANSFER
from pipeline.store.encoding import decode_json, decode_table
from pipeline.store.store import Store
from pipeline.workflow.identity import to_json
from pipeline.workflow.stage import Execution

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


@pytest.mark.parametrize("stage", ["evolve", "transfer"])
def test_designs_and_adapted_controllers_are_selected_for_it(fast, settings, stage):
    store, upstream = fast
    for trial, (segment, *_) in upstream[stage].done.items():
        files = {name: store.read(segment, name) for name in segment.files}
        population = population_of({POPULATION: files[POPULATION]})
        home = trial.environment if stage == "evolve" else "true_slush"
        simulation = environments.simulation_spec(settings, home)
        environment = environments.build_environment(simulation.media, home, 1.0, {})
        rollouts = environments.roll_out(simulation, Execution(), environment, population.designs)
        np.testing.assert_array_equal(population.fitness, rollouts.second_half_speed)
        history = decode_table(files[HISTORY], schema="history", version=1, source=HISTORY)
        assert history["fitness"].max() == population.fitness[population.champion()]
        assert (history["fitness"] != history["displacement"][:, 0]).any()


def test_tables_and_the_page_state_its_unit(fast, tmp_path):
    store, upstream = fast
    (segment,) = labelled(upstream["evolve"].done)["dry_land/1m/trial-0"]
    for name, column in ((HISTORY, "fitness"), (CURVE, "best_fitness")):
        path = tmp_path / name
        path.write_bytes(store.read(segment, name))
        assert json.loads(pq.read_schema(path).metadata[b"puddle"])["units"][column] == "m/s"
    (done,) = labelled(upstream["report"].done)["index.html"]
    page = store.read(done, "index.html").decode()
    assert "speed in the second half [m/s]" in page and "Fitness [m/s]" in page and "to travel as far" not in page
    assert "best fitness [m/s]" in store.read(done, "fitness_curves.svg").decode()


def test_champions_are_compared_by_displacement(fast):
    store, upstream = fast
    for label, parts in labelled(upstream["transfer"].done).items():
        scores = decode_json(store.read(parts[-1], SCORE), label)
        assert scores["fitness"] != scores["predicted"]
        if label.startswith("true_slush"):
            assert scores["zero_shot"] == scores["predicted"]
    for label, (done,) in labelled(upstream["analyse"].done).items():
        if label.startswith("instruments/true_slush"):
            (claimed,) = read_table({"champions.parquet": store.read(done, "champions.parquet")}, "champions")[
                "claimed"
            ]
            (segment,) = labelled(upstream["evolve"].done)["true_slush/1m/trial-0"]
            population = population_of({POPULATION: store.read(segment, POPULATION)})
            assert champion_of(population) is not None
            assert claimed == population.fitness[population.champion()]


def test_the_paper_s_objective_leaves_keys_as_they_were(settings):
    paper = settings.model_copy(
        update={"evolution": settings.evolution.model_copy(update={"objective": "displacement"})}
    )
    for stage in (EVOLVE, TRANSFER):
        ours, theirs = (to_json(stage.plan(of)[0].spec) for of in (settings, paper))
        assert "objective" not in theirs
        assert ours == {**theirs, "objective": "second_half_speed"}


def test_an_unknown_objective_lists_those_there_are():
    with pytest.raises(PuddleError, match=r"evolution.objective.*'displacement' or 'second_half_speed'"):
        parse(Settings, SETTINGS.replace("second_half_speed", "third_half_speed"), name="fast")
