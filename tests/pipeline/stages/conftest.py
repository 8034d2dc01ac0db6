"""A study with several data sets and replicates, single members, and domain randomisation."""

import pytest
from small_study import labelled, run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.stages.analyse import table_file
from pipeline.store.store import Store
from pipeline.workflow.stage import StoredFiles
from tasks.analysis.tables import ANALYSES

SETS = """
name: sets
replicates: 2
throws: {n_throws: 4, n_steps: 20}
learners: {designed_throws: {throws: {n_throws: 6}}}
randomised_slush: {n_members: 3}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 10, batch_size: 16}
ensemble: {n_members: 2, disagreement_penalty: 0.5}
grid:
  depths: [1.0]
  environments: [true_slush, residual_slush, designed_throws, randomised_slush]
  single_member_depths: [1.0]
  n_trials: 3
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 2, afpo: {population_size: 4}}
transfer: {n_generations: 1, adapted_environments: [designed_throws]}
assess: {n_designs: 6}
"""


@pytest.fixture(scope="session")
def settings_with():
    """Return the study's settings, some of them replaced."""
    return lambda **changes: parse(Settings, SETS, name="sets").model_copy(update=changes)


@pytest.fixture(scope="session")
def sets(settings_with, tmp_path_factory):
    store = Store.open(tmp_path_factory.mktemp("sets") / "store", create=True)
    with serial_cluster() as cluster:
        return store, run(settings_with(), store, cluster, STAGES[:-1])


@pytest.fixture(scope="session")
def analysed():
    """Read the table of an analysis, or of one arm, such as ``/dry_land/1m``."""

    def read(finished, table: str, of: str = ""):
        store, upstream = finished
        (done,) = labelled(upstream["analyse"].done)[table + of]
        return table_file(ANALYSES[table]).read([StoredFiles(store, done)])

    return read
