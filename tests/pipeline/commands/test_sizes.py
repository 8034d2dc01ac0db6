"""What a forecast says that a study keeps is what a study keeps."""

import pytest
from small_study import NoBar

from pipeline.cluster import serial_cluster
from pipeline.commands.sizes import PAGE_BYTES, bytes_left, weigh
from pipeline.commands.specimens import layers_of
from pipeline.config.loading import parse
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.store.store import Store
from pipeline.workflow.dispatcher import run_stage
from pipeline.workflow.graph import StageRun, results_of
from tasks.residual.network import ResidualNetwork

SMALL = """
name: small
throws: {n_throws: 20}
network: {hidden_layers: 2, width: 32}
training: {n_iterations: 10, batch_size: 64}
ensemble: {n_members: 3}
grid: {depths: [3.0], n_trials: 2}
rollout: {n_settle: 20, n_measure: 100}
evolution: {n_generations: 40, afpo: {population_size: 16}}
transfer: {n_generations: 40}
assess: {n_designs: 60}
work: {throws_per_item: 10, generations_per_item: 20}
"""


def test_a_network_has_the_layers_that_are_priced():
    network = parse(Settings, SMALL, name="small").network
    layers = ResidualNetwork(network).arrays()
    assert [layers[f"weight_{i}"].shape for i in range(len(layers) // 2)] == layers_of(network)


def test_no_segment_is_longer_than_its_trial():
    """Whatever generations_per_item is: 3,000 of them by themselves would be weighed as another number."""
    asked = ["grid.environments=[dry_land]", "grid.single_member_depths=[]", "transfer.n_generations=30"]
    longest, endless = (
        weigh(parse(Settings, SMALL, name="small", overrides=[*asked, f"work.generations_per_item={n}"]))
        for n in (40, 3000)
    )
    assert endless == longest


def test_every_stage_keeps_about_what_was_said(tmp_path):
    """Within a third, the page apart, which is most of so small a study and made in test_report.py."""
    settings = parse(Settings, SMALL, name="small")
    store, sizes, upstream = Store.open(tmp_path / "store", create=True), weigh(settings), {}
    for stage in STAGES[:-1]:
        stage_run = StageRun(stage, settings, upstream, store, print)
        chains = stage_run.chains()
        with serial_cluster() as cluster:
            run_stage(stage_run, chains, cluster=cluster, bar=NoBar())
        upstream[stage.name] = results_of(stage, chains)
        kept = sum(store.item_bytes(stage.name, key) for key in store.keys(stage.name))
        said = sum(bytes_left(stage, chain, 0, settings, sizes) for chain in stage.plan(settings))
        assert said == pytest.approx(kept, rel=1 / 3), stage.name
        done = sum(bytes_left(stage, chain, chain.n_items, settings, sizes) for chain in stage.plan(settings))
        assert done == 0
    page = STAGES[-1].plan(settings)[0]
    assert bytes_left(STAGES[-1], page, 0, settings, sizes) > 2 * PAGE_BYTES
