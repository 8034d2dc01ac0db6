"""The arm of domain randomisation: evolved without throws or networks, and compared with the others."""

import numpy as np
import pytest
from small_study import labelled, run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import environments
from pipeline.stages.analyse import read_columns
from pipeline.stages.segments import HISTORY, trial_spec
from pipeline.stages.transfer import SCORE
from pipeline.store.encoding import decode_json, decode_table
from pipeline.store.store import Store
from pipeline.workflow.identity import trials_of
from tasks.analysis.tables import ANALYSES

SETTINGS = """
name: randomised
seed: 4
randomised_slush: {n_members: 3}
ensemble: {disagreement_penalty: 0.5}
grid: {depths: [1.0], environments: [true_slush, randomised_slush], single_member_depths: [], n_trials: 2}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 2, afpo: {population_size: 4}}
transfer: {n_generations: 1}
assess: {n_designs: 4}
"""


@pytest.fixture(scope="module")
def randomised(tmp_path_factory):
    store = Store.open(tmp_path_factory.mktemp("randomised") / "store", create=True)
    with serial_cluster() as cluster:
        return store, run(parse(Settings, SETTINGS, name="randomised"), store, cluster)


def test_every_trial_has_the_members_of_the_study_s_seed():
    settings = parse(Settings, SETTINGS, name="randomised")
    trials = [trial for trial in trials_of(settings, "evolve") if trial.environment == "randomised_slush"]
    built = [trial_spec(settings, trial, trial.environment).at_home({}) for trial in trials]
    assert len(built) == 2 and built[0] == built[1]
    assert (
        built[0].components
        == environments.build_environment(
            {"randomised_slush": settings.randomised_slush.of_study(4)}, "randomised_slush", 1.0, {}
        ).components
    )
    assert not settings.needs_ensemble
    assert environments.relative_cost(settings, "randomised_slush") == 3


def test_fitness_is_the_mean_over_members_less_their_disagreement(randomised):
    store, upstream = randomised
    for label, segments in labelled(upstream["evolve"].done).items():
        history = decode_table(store.read(segments[0], HISTORY), schema="history", version=1, source=HISTORY)
        by_member = history["displacement"]
        assert by_member.shape[1] == (3 if label.startswith("randomised") else 1)
        assert np.array_equal(history["fitness"], by_member.mean(axis=1) - 0.5 * by_member.std(axis=1))


def test_champions_are_scored_over_members_and_in_true_slush(randomised):
    store, upstream = randomised
    for label, parts in labelled(upstream["transfer"].done).items():
        scores = decode_json(store.read(parts[-1], SCORE), label)
        assert scores["adapted"] is not None
        if label.startswith("randomised"):
            assert scores["predicted_sd"] > 0 and scores["predicted"] != scores["zero_shot"]
            assert scores["fitness"] == pytest.approx(scores["predicted"] - 0.5 * scores["predicted_sd"])


def test_the_page_tells_what_it_is_and_shows_a_member(randomised):
    store, upstream = randomised
    (done,) = labelled(upstream["report"].done)["index.html"]
    page = store.read(done, "index.html").decode()
    assert "Randomised Slush, <i>Ẽ</i></dt>" in page and "Randomised Slush (member " in page


def test_the_analysis_compares_it(randomised):
    store, upstream = randomised
    done = labelled(upstream["analyse"].done)

    def table(name):
        return read_columns({f"{name}.parquet": store.read(done[name][0], f"{name}.parquet")}, ANALYSES[name])

    contrasts = table("contrasts")
    pairs = {(str(a), str(b)) for a, b in zip(contrasts["a"], contrasts["b"], strict=True)}
    best, own = "true_slush/zero_shot", "randomised_slush"
    assert pairs == {(f"{own}/zero_shot", best), (f"{own}/adapted", best)}
    assert own in table("transfer")["environment"]
