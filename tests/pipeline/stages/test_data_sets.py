"""A study of several data sets, replicates and kinds of arms: what each is made from, and what tells them apart."""

import numpy as np
import pytest
from small_study import labelled

from pipeline.results import study_tables
from pipeline.stages import environments
from pipeline.stages.collect import COLLECT
from pipeline.stages.cost import seconds_of_rollout
from pipeline.stages.data_sets import DataSetId, NetworkId, data_sets, network_ids, networks_of
from pipeline.stages.files import HISTORY, PREDICTIONS, SCORE, TRANSITIONS, WEIGHTS
from pipeline.stages.reader import read_study
from pipeline.stages.segments import trial_spec
from pipeline.stages.train import TRAIN
from pipeline.store.encoding import decode_json
from pipeline.workflow.identity import TrialId, trials_of
from pipeline.workflow.stage import StoredFiles


def trial(environment, index):
    return TrialId("evolve", environment, 1.0, index, n_replicates=2)


def test_trials_take_turns_over_the_replicates(settings_with):
    def networks(environment, index):
        return networks_of(trial(environment, index), settings_with().learner(environment))

    assert networks("true_slush", 1) == []
    for index in range(3):
        own = DataSetId("designed_throws", index % 2)
        assert networks("designed_throws", index) == [NetworkId(own, 0), NetworkId(own, 1)]
        assert networks("designed_single_member", index) == [NetworkId(own, index // 2)]


def test_a_replicate_changes_no_identity_of_the_first(settings_with):
    """The first replicate of a study is the study without replicates."""
    alone, both = settings_with(replicates=1), settings_with()
    specs = {chain.label: chain.spec for chain in COLLECT.plan(both)}
    for chain in COLLECT.plan(alone):
        assert specs[chain.label] == chain.spec
    members = {chain.label: chain.spec for chain in TRAIN.plan(both)}
    same = [chain for chain in TRAIN.plan(alone) if chain.label in members]
    assert len(same) >= 4 and all(members[chain.label] == chain.spec for chain in same)


def test_data_sets_and_networks_all_differ(sets, settings_with):
    store, upstream = sets
    assert len(data_sets(settings_with())) == 4
    networks = {store.read(done, WEIGHTS) for (done,) in upstream["train"].done.values()}
    assert len(networks) == len(network_ids(settings_with())) == 8
    first = {
        label: TRANSITIONS.read([StoredFiles(store, done)])
        for label, (done,) in labelled(upstream["collect"].done).items()
    }
    assert list(first) == [
        *("residual_slush/throws-0", "residual_slush/replicate-1/throws-0"),
        *("designed_throws/throws-0", "designed_throws/replicate-1/throws-0"),
    ]
    throws = read_study(settings_with(), upstream, store).throws  # of the main data set alone
    np.testing.assert_array_equal(throws.state, first["residual_slush/throws-0"]["state"])
    states = [table["state"][0].tolist() for table in first.values()]
    assert len(np.unique(states, axis=0)) == 4
    assert len(first["designed_throws/throws-0"]["step"]) == 6 * 29  # as many steps as the design chooses


def test_both_ensembles_are_assessed_on_the_same_designs(sets, analysed):
    store, upstream = sets
    regressions = analysed(sets, "regressions")
    assert set(regressions["learned_from"]) == {"residual_slush", "designed_throws"}
    shares = labelled(upstream["assess"].done)
    for k in range(3):
        one, other = (
            PREDICTIONS.read([StoredFiles(store, shares[label][0])])
            for label in (f"{learner}/true_slush/1m/trial-{k}" for learner in ("residual_slush", "designed_throws"))
        )
        assert (one["true"] == other["true"]).all() and (one["predicted"] != other["predicted"]).any()


def test_trials_have_the_replicates_that_they_depend_on(sets, analysed):
    """Trials 0 and 2 of the three are of the first replicate; those without networks depend on none."""
    scores = analysed(sets, "scores")
    learned = ~np.isin(scores["environment"], ["true_slush", "randomised_slush"])
    assert (scores["replicate"] == np.where(learned, scores["trial"] % 2, 0)).all()


def test_tables_name_the_data_set(sets, settings_with):
    store, upstream = sets
    tables = study_tables.parts_of("learning_curves", upstream, store, only={})
    assert {name for table in tables for name in table["data_set"].to_pylist()} == {
        of.label for of in data_sets(settings_with())
    }


# -- arms beside those of the paper ----------------------------------------------------------------------------------


def scores_of(sets, environment):
    store, upstream = sets
    found = {trial: parts[-1] for trial, parts in upstream["transfer"].done.items() if trial.environment == environment}
    return [decode_json(store.read(scored, SCORE), trial.label) for trial, scored in found.items()]


def test_champions_of_ensembles_are_scored_with_their_disagreement(sets, analysed):
    """Of an ensemble's networks, or of the members of domain randomisation; their weight is 0.5."""
    for environment in ("residual_slush", "designed_throws", "randomised_slush"):
        for scores in scores_of(sets, environment):
            assert scores["predicted_sd"] > 0 and scores["predicted"] != scores["zero_shot"]
            assert scores["fitness"] == pytest.approx(scores["predicted"] - 0.5 * scores["predicted_sd"])
    ranked = analysed(sets, "exploiters")
    mine = ranked["environment"] == "residual_slush"
    expected = sorted(scores["predicted_sd"] for scores in scores_of(sets, "residual_slush"))
    assert sorted(ranked["disagreement"][mine]) == pytest.approx(expected)


def test_trials_of_domain_randomisation_share_the_members_of_the_study_s_seed(settings_with):
    settings = settings_with(seed=4)
    trials = [trial for trial in trials_of(settings, "evolve") if trial.environment == "randomised_slush"]
    built = [trial_spec(settings, trial, trial.environment).at_home({}) for trial in trials]
    media = {"randomised_slush": settings.randomised_slush.of_study(4)}
    expected = environments.build_environment(media, "randomised_slush", 1.0, {})
    assert len(built) == 3 and all(one == expected for one in built)
    cost = seconds_of_rollout(settings, "true_slush", 9.0)
    assert seconds_of_rollout(settings, "randomised_slush", 9.0) == pytest.approx(3 * cost)


def test_fitness_is_the_mean_over_members_less_their_disagreement(sets):
    store, upstream = sets
    n_members = {"true_slush": 1, "single_member": 1, "residual_slush": 2, "randomised_slush": 3}
    for trial, segments in upstream["evolve"].done.items():
        history = HISTORY.read([StoredFiles(store, segments[0])])
        by_member = history["displacement"]
        assert by_member.shape[1] == n_members.get(trial.environment, by_member.shape[1])
        deviation = by_member.std(axis=1)
        np.testing.assert_allclose(history["fitness"], by_member.mean(axis=1) - 0.5 * deviation, rtol=1e-12)
