"""The stage pilot: what robots do before any trial evolves, and whether the throws cover it."""

import numpy as np
import pytest
from small_study import run

from pipeline.cluster import serial_cluster
from pipeline.config.loading import parse
from pipeline.config.settings import PilotSettings, Settings
from pipeline.stages import STAGES
from pipeline.stages.data_sets import DataSetId
from pipeline.stages.pilot import COVERAGE, PILOT, STATES, read_coverage
from pipeline.store.encoding import decode_table
from pipeline.store.store import Store
from tasks.residual import OBSERVATION

SETTINGS = """
name: piloted
throws: {n_throws: 8, n_steps: 60}
designed_throws: {n_throws: 16}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 10, batch_size: 16}
ensemble: {n_members: 2}
grid:
  depths: [1.0]
  environments: [true_slush, residual_slush, designed_throws]
  single_member_depths: []
  n_trials: 1
rollout: {n_settle: 20, n_measure: 60}
evolution: {n_generations: 3, afpo: {population_size: 4}}
"""


def settings_with(**changes):
    return parse(Settings, SETTINGS, name="piloted").model_copy(update=changes)


@pytest.fixture(scope="module")
def pilots(tmp_path_factory):
    store = Store.open(tmp_path_factory.mktemp("pilots") / "store", create=True)
    with serial_cluster() as cluster:
        return store, run(settings_with(), store, cluster, stages=STAGES[: STAGES.index(PILOT) + 1])["pilot"]


def files(store, results, group):
    (done,) = results.done[DataSetId(group, 0)]
    return {name: store.read(done, name) for name in done.files}


def test_it_runs_before_evolution_and_reads_no_true_slush():
    names = [stage.name for stage in STAGES]
    assert names.index("train") < names.index("pilot") < names.index("evolve")
    assert PILOT.reads(settings_with()) == ("collect", "train")
    assert all("slush" not in chain.spec.simulation.media for chain in PILOT.plan(settings_with()))


def test_every_data_set_is_checked_with_both_kinds_of_pilots(pilots):
    store, results = pilots
    for group in ("throws", "designed_throws"):
        found = read_coverage(files(store, results, group))
        assert list(found) == ["dry_land", "residual_slush"]
        for rows in found.values():
            assert [row.component for row in rows] == ["all", *OBSERVATION]
            assert sum(row.share_outside for row in rows[1:]) == pytest.approx(rows[0].share_outside)


def test_the_states_are_kept(pilots):
    store, results = pilots
    held = files(store, results, "throws")
    states = decode_table(held[STATES], schema="states", version=1, source=STATES)
    counts = {row.n for rows in read_coverage(held).values() for row in rows}
    assert states["observation"].shape[1] == 6 and np.isfinite(states["observation"]).all()
    assert counts == {int((states["seen_in"] == name).sum()) for name in ("dry_land", "residual_slush")}


def test_it_warns_where_too_much_is_outside(pilots):
    store, results = pilots
    strict, lenient = (settings_with(pilot=PilotSettings(most_outside=share)) for share in (0.0, 1.0))
    assert any(line.startswith("warning: throws: ") for line in PILOT.summarise(strict, results, store).lines)
    summary = PILOT.summarise(lenient, results, store)
    assert not any("warning" in line for line in summary.lines)
    assert set(summary.metrics) == {
        f"share_outside.{group}.{where}"
        for group in ("throws", "designed_throws")
        for where in ("dry_land", "residual_slush")
    }
    assert COVERAGE in files(store, results, "throws")
