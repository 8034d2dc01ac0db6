"""Several data sets in one study: throws for robots beside the paper's, and independent replicates of both."""

import numpy as np
import pytest
from small_study import labelled, run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import GridSettings, Settings
from pipeline.results import study_tables
from pipeline.stages import STAGES
from pipeline.stages.analyse import read_columns
from pipeline.stages.assess import PREDICTIONS, read_predictions
from pipeline.stages.collect import COLLECT, TRANSITIONS
from pipeline.stages.data_sets import DataSetId, NetworkId, data_sets, network_ids, networks_of
from pipeline.stages.environments import WEIGHTS
from pipeline.stages.train import TRAIN
from pipeline.store.encoding import decode_table
from pipeline.store.store import Store
from pipeline.workflow.identity import TrialId, trials_of
from tasks.analysis.tables import ANALYSES

SETTINGS = """
name: sets
replicates: 2
throws: {n_throws: 4, n_steps: 20}
designed_throws: {n_throws: 6}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 10, batch_size: 16}
ensemble: {n_members: 2}
grid:
  depths: [1.0]
  environments: [true_slush, residual_slush, designed_throws]
  single_member_depths: [1.0]
  n_trials: 3
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 2, afpo: {population_size: 4}}
transfer: {n_generations: 1, adapted_environments: [designed_throws]}
assess: {n_designs: 6}
"""


def settings_with(**changes):
    return parse(Settings, SETTINGS, name="sets").model_copy(update=changes)


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    store = Store.open(tmp_path_factory.mktemp("sets") / "store", create=True)
    with serial_cluster() as cluster:
        return store, run(settings_with(), store, cluster, STAGES[:-1])


def trial(environment, index):
    return TrialId("evolve", environment, 1.0, index, n_replicates=2)


def test_trials_take_turns_over_the_replicates():
    settings = settings_with()
    assert networks_of(settings, trial("true_slush", 1)) == []
    for index in range(3):
        own = DataSetId("designed_throws", index % 2)
        assert networks_of(settings, trial("designed_throws", index)) == [NetworkId(own, 0), NetworkId(own, 1)]
        assert networks_of(settings, trial("designed_single_member", index)) == [NetworkId(own, index // 2)]


def test_every_single_member_trial_has_a_network_of_its_own():
    for replicates in (1, 2, 3):
        settings = settings_with(replicates=replicates)
        own = [networks_of(settings, of) for of in trials_of(settings, "evolve") if of.environment == "single_member"]
        assert len({network for (network,) in own}) == 3
        assert {network for networks in own for network in networks} <= set(network_ids(settings))


def test_a_replicate_changes_no_identity_of_the_first():
    """The first replicate of a study is the study without replicates."""
    alone, both = settings_with(replicates=1), settings_with()
    specs = {chain.label: chain.spec for chain in COLLECT.plan(both)}
    for chain in COLLECT.plan(alone):
        assert specs[chain.label] == chain.spec
    members = {chain.label: chain.spec for chain in TRAIN.plan(both)}
    same = [chain for chain in TRAIN.plan(alone) if chain.label in members]
    assert len(same) >= 4 and all(members[chain.label] == chain.spec for chain in same)


def test_data_sets_and_networks_all_differ(sets):
    store, upstream = sets
    assert len(data_sets(settings_with())) == 4
    networks = {store.read(done, WEIGHTS) for (done,) in upstream["train"].done.values()}
    assert len(networks) == len(network_ids(settings_with())) == 8
    first = {
        label: decode_table(store.read(done, TRANSITIONS), schema="transitions", version=1, source=label)
        for label, (done,) in labelled(upstream["collect"].done).items()
    }
    assert list(first) == [
        *("throws-0", "replicate-1/throws-0"),
        *("designed_throws/throws-0", "designed_throws/replicate-1/throws-0"),
    ]
    states = [table["state"][0].tolist() for table in first.values()]
    assert len(np.unique(states, axis=0)) == 4
    assert len(first["designed_throws/throws-0"]["step"]) == 6 * 29  # as many steps as the design chooses


def test_champions_are_compared_with_the_throws_that_their_own_networks_learned_from(sets):
    store, upstream = sets
    for environment in ("residual_slush", "designed_throws", "single_member", "designed_single_member"):
        table = analysed(store, upstream, "champion_coverage", f"/{environment}/1m")
        assert table["trial"].tolist() == [k for k in range(3) for _ in range(7)]
        whole = table["component"] == "all"
        of_components = table["share_outside"][~whole].reshape(3, 6).sum(axis=1)
        assert table["share_outside"][whole] == pytest.approx(of_components)
        assert (table["n"] > 0).all()


def test_only_the_arms_that_adapt_are_adapted(sets):
    _, upstream = sets
    n_items = {of.environment: len(parts) for of, parts in upstream["transfer"].done.items()}
    assert n_items["designed_throws"] == 2 and n_items["residual_slush"] == 1


def test_both_ensembles_are_assessed_on_the_same_designs(sets):
    store, upstream = sets
    regressions = analysed(store, upstream, "regressions")
    assert set(regressions["learned_from"]) == {"throws", "designed_throws"}
    assert set(regressions["n_replicates"]) == {2}
    shares = labelled(upstream["assess"].done)
    for k in range(3):
        one, other = (
            read_predictions([{PREDICTIONS: store.read(shares[label][0], PREDICTIONS)}])
            for label in (f"true_slush/1m/trial-{k}", f"designed_throws/true_slush/1m/trial-{k}")
        )
        assert (one["true"] == other["true"]).all() and (one["predicted"] != other["predicted"]).any()


def test_a_single_ensemble_is_named_after_its_throws(tmp_path):
    grid = {
        "depths": [1.0],
        "environments": ["true_slush", "designed_throws"],
        "single_member_depths": [],
        "n_trials": 2,
    }
    settings = settings_with(replicates=1, grid=GridSettings.model_validate(grid))
    store = Store.open(tmp_path / "store", create=True)
    with serial_cluster() as cluster:
        upstream = run(settings, store, cluster, STAGES[:-1])
    assert set(analysed(store, upstream, "regressions")["learned_from"]) == {"designed_throws"}


def test_the_arms_are_contrasted_and_attributed(sets):
    store, upstream = sets
    contrasts = analysed(store, upstream, "contrasts")
    pairs = set(zip(contrasts["a"].tolist(), contrasts["b"].tolist(), strict=True))
    assert ("designed_throws/zero_shot", "residual_slush/zero_shot") in pairs
    assert "designed_throws" in analysed(store, upstream, "transfer")["environment"]


def test_the_variance_is_split_where_trials_depend_on_replicates(sets):
    """Trials 0 and 2 of the three are of the first replicate; those of True Slush depend on none."""
    store, upstream = sets
    scores, split = (analysed(store, upstream, name) for name in ("scores", "variance"))
    learned = scores["environment"] != "true_slush"
    assert (scores["replicate"] == np.where(learned, scores["trial"] % 2, 0)).all()
    rows = {
        (arm, quantity): at
        for at, (arm, quantity) in enumerate(zip(split["environment"], split["quantity"], strict=True))
    }
    for arm, n_replicates in (("true_slush", 1), ("residual_slush", 2), ("designed_single_member", 2)):
        at = rows[arm, "zero_shot"]
        assert (split["n"][at], split["n_replicates"][at]) == (3, n_replicates)
        assert (
            np.isfinite(split["sd_between"][at]) == np.isfinite(split["share_between_low"][at]) == (n_replicates == 2)
        )
    values = scores["zero_shot"][scores["environment"] == "residual_slush"]
    within = (values[0] - values[2]) ** 2 / 2
    between = (values[[0, 2]].mean() - values[1]) ** 2 * 2 / 3
    at = rows["residual_slush", "zero_shot"]
    pooled = between <= within
    assert split["sd_within"][at] ** 2 == pytest.approx(values.var(ddof=1) if pooled else within)
    assert split["sd_between"][at] ** 2 == pytest.approx(0 if pooled else (between - within) / (4 / 3))


def test_tables_name_the_data_set(sets):
    store, upstream = sets
    tables = study_tables.parts_of("learning_curves", upstream["train"], store, only={})
    assert {name for table in tables for name in table["data_set"].to_pylist()} == {
        of.label for of in data_sets(settings_with())
    }


def analysed(store, upstream, table, of=""):
    (done,) = labelled(upstream["analyse"].done)[table + of]
    return read_columns({f"{table}.parquet": store.read(done, f"{table}.parquet")}, ANALYSES[table])
