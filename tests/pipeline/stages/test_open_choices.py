"""Choices that the paper leaves open and that a whole study makes: what its stages do with them."""

import json

import numpy as np
import pytest
from small_study import labelled, run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.stages.analyse import read_columns
from pipeline.stages.evolve import EVOLVE
from pipeline.stages.transfer import CHAMPION, SCORE, TRANSFER
from pipeline.store.design_file import design_from
from pipeline.store.encoding import decode_json
from pipeline.store.store import Store
from pipeline.workflow.identity import to_json
from tasks.analysis.tables import ANALYSES
from tasks.analysis.tables.regressions import predictors_of

SETTINGS = """
name: choices
throws: {n_throws: 2, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 10, batch_size: 16}
ensemble: {n_members: 3, deviation: sample}
grid: {depths: [9.0], environments: [true_slush, residual_slush], single_member_depths: [], n_trials: 1}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 2, afpo: {population_size: 4}}
transfer: {n_generations: 1}
assess: {n_designs: 4}
"""


@pytest.fixture(scope="module")
def settings():
    return parse(Settings, SETTINGS, name="choices")


@pytest.fixture(scope="module")
def done(tmp_path_factory, settings):
    store = Store.open(tmp_path_factory.mktemp("choices") / "store", create=True)
    with serial_cluster() as cluster:
        return store, run(settings, store, cluster, STAGES[:-1])


def test_the_sample_s_deviation_is_that_of_fitness_scores_and_predictions(done):
    store, upstream = done
    scored = labelled(upstream["transfer"].done)["residual_slush/9m/trial-0"][-1]
    scores = decode_json(store.read(scored, SCORE), "scores")
    (ranked,) = labelled(upstream["analyse"].done)["exploiters"]
    files = {"exploiters.parquet": store.read(ranked, "exploiters.parquet")}
    assert scores["predicted_sd"] == pytest.approx(read_columns(files, ANALYSES["exploiters"])["disagreement"][0])
    assert scores["fitness"] == pytest.approx(scores["predicted"] - scores["predicted_sd"])
    assert design_from(decode_json(store.read(scored, CHAMPION), "champion"), "champion").frequency.size == 1
    predicted = np.array([[1.0], [3.0], [8.0]])
    assert predictors_of(predicted, "sample")["mean - 1 sd"] == pytest.approx(4 - np.sqrt(13))


def changed(settings: Settings, *overrides: str) -> Settings:
    return parse(Settings, settings.model_dump_json(), name="choices", overrides=overrides)


def specs(stage, settings: Settings) -> list[str]:
    return [json.dumps(to_json(chain.spec), sort_keys=True) for chain in stage.plan(settings)]


def test_what_is_not_chosen_is_in_no_key(settings):
    usual = changed(settings, "ensemble.deviation=population")
    for stage in (EVOLVE, TRANSFER):
        written = "".join(specs(stage, usual))
        for name in ("deviation", "range_of_motion", "changed_genes", "parent_selection"):
            assert f'"{name}"' not in written
    assert "deviation" in "".join(specs(EVOLVE, settings))
