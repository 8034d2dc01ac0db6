"""Trials that evolve in a single network: each in one of its own, however few members the ensemble has."""

import pytest
from small_study import labelled, run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.stages.analyse import read_columns
from pipeline.stages.environments import WEIGHTS
from pipeline.stages.transfer import SCORE
from pipeline.store.encoding import decode_json
from pipeline.store.store import Store
from tasks.analysis.tables import ANALYSES

N_MEMBERS, N_TRIALS = 2, 4

SETTINGS = f"""
name: singles
throws: {{n_throws: 2, n_steps: 20}}
network: {{hidden_layers: 1, width: 4}}
training: {{n_iterations: 10, batch_size: 16}}
ensemble: {{n_members: {N_MEMBERS}}}
grid: {{depths: [1.0], environments: [true_slush], single_member_depths: [1.0], n_trials: {N_TRIALS}}}
rollout: {{n_settle: 5, n_measure: 20}}
evolution: {{n_generations: 2, afpo: {{population_size: 4}}}}
transfer: {{n_generations: 1, adapted_environments: []}}
assess: {{n_designs: 4}}
"""


@pytest.fixture(scope="module")
def singles(tmp_path_factory):
    store = Store.open(tmp_path_factory.mktemp("singles") / "store", create=True)
    with serial_cluster() as cluster:
        return store, run(parse(Settings, SETTINGS, name="singles"), store, cluster, STAGES[:-1])


def test_every_trial_has_a_network_of_its_own(singles):
    store, upstream = singles
    networks = {store.read(done, WEIGHTS) for (done,) in upstream["train"].done.values()}
    assert len(networks) == N_TRIALS


def test_champions_repeat_their_scores_in_their_own_networks(singles):
    store, upstream = singles
    scored = labelled(upstream["transfer"].done)
    scores = [
        decode_json(store.read(scored[f"single_member/1m/trial-{k}"][-1], SCORE), "scores") for k in range(N_TRIALS)
    ]
    assert all(score["predicted"] == score["fitness"] and score["predicted_sd"] is None for score in scores)
    (done,) = labelled(upstream["analyse"].done)["scores"]
    rows = read_columns({"scores.parquet": store.read(done, "scores.parquet")}, ANALYSES["scores"])
    own = rows["environment"] == "single_member"
    assert rows["predicted"][own].tolist() == [score["predicted"] for score in scores]
