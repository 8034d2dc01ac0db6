"""The contract of every stage (pipeline/workflow/stage.py), and what the stages of this study do beyond it."""

import json

import numpy as np
import polars
import pyarrow.parquet
import pytest
from pydantic_core import to_jsonable_python
from small_study import files_of, inputs_of, labelled

from pipeline.config.loading import load, preset_path
from pipeline.config.settings import Settings
from pipeline.stages import STAGES
from pipeline.stages.segments import mean_and_deviation
from pipeline.store.encoding import canonical_json
from pipeline.workflow.stage import Failure, Item, Results


def items_of(stage, settings, upstream) -> list[Item]:
    """Specify every item of a finished stage again."""
    items = []
    for chain in stage.plan(settings):
        manifests = upstream[stage.name].done[chain.identity]
        for index in range(chain.n_items):
            previous = manifests[index - 1] if index else None
            items.append(stage.item(settings, chain, index, previous, upstream))
    return items


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_contract(stage, settings, study):
    store, upstream = study
    names = [other.name for other in STAGES]
    assert all(names.index(name) < names.index(stage.name) for name in stage.reads(settings))
    chains = stage.plan(settings)
    assert chains == stage.plan(settings)
    assert len({chain.label for chain in chains}) == len(chains)
    items = items_of(stage, settings, upstream)
    assert len({item.key for item in items}) == len(items)
    for item in items:
        canonical_json(item.identity)  # plain JSON, or it raises
        assert item.stage == stage.name and item.version == stage.version
        spec = to_jsonable_python(item.spec)
        assert any(
            to_jsonable_python(chain.spec) in (spec, *spec.values()) for chain in chains
        )  # `puddle gc` relies on it
        assert {source.manifest.stage for source in item.inputs.values()} <= {stage.name, *stage.reads(settings)}
        manifest = store.manifest(item.stage, item.key)
        assert files_of(store, manifest) == stage.compute(item, inputs_of(store, item))  # pure: the same bytes again
    summary = stage.summarise(settings, upstream, store)
    lines = [line.replace(str(store.root), "store") for line in summary.lines]
    assert lines and max(map(len, lines)) <= 78  # it fits a terminal, with an indentation of two
    assert all(np.isfinite(value) for value in summary.metrics.values())


def test_trials_are_summarised_by_their_sample_deviation():
    """The deviation of 1 and 3 is √2, as on the page; one trial has none."""
    assert mean_and_deviation([1.0, 3.0]).split() == ["2.00", "±", "1.41"]
    assert mean_and_deviation([1.0]).split() == ["1.00"]
    assert mean_and_deviation([]) == "-"


def test_histories_hold_every_design_and_other_readers_read_them(settings, study, tmp_path):
    store, upstream = study
    frames = []
    for segment in labelled(upstream["evolve"].done)["residual_slush/1m/trial-1"]:
        path = tmp_path / f"{segment.key}.parquet"
        path.write_bytes(store.read(segment, "history.parquet"))
        frames.append(polars.read_parquet(path))
    history = polars.concat(frames)
    n_generations, n_designs = settings.evolution.n_generations, settings.evolution.afpo.population_size
    assert history["generation"].to_list() == [g for g in range(n_generations) for _ in range(n_designs)]
    assert history["identity"].to_list() == list(range(n_generations * n_designs))
    said = json.loads(pyarrow.parquet.read_schema(path).metadata[b"puddle"])
    assert said["units"]["operator"] == "0 random, 1 mutation, 2 crossover"  # so that a reader needs no source
    for name in ("displacement", "com_displacement"):
        assert history[name].to_numpy().shape == (len(history), 2)  # of each member


def test_paper_preset_is_the_paper():
    paper = load(Settings, preset_path("paper"))
    assert paper.grid.depths == (0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4, 9)
    assert paper.grid.environments == ("true_slush", "dry_land", "residual_slush")
    assert (paper.grid.n_trials, paper.grid.single_member_depths) == (10, (9.0,))
    assert (paper.evolution.n_generations, paper.transfer.n_generations) == (1000, 1000)
    afpo = paper.evolution.afpo
    assert (afpo.population_size, *afpo.shares) == (64, 0.15, 0.65, 0.20)
    assert (paper.throws.n_throws, paper.throws.n_steps, paper.throws.length_scales) == (500, 200, (1, 2, 3))
    assert (paper.network.hidden_layers, paper.network.width, paper.network.dropout) == (4, 256, 0.001)
    training = paper.training
    assert (training.n_iterations, training.batch_size) == (50_000, 262_144)
    assert (training.learning_rate, training.min_learning_rate) == (1e-3, 1e-6)
    assert (training.loss, training.focal_alpha, training.focal_s, training.focal_gamma) == ("focal", 1, 100, 2)
    assert (paper.ensemble.n_members, paper.ensemble.disagreement_penalty) == (8, 1)
    assert (paper.assessed_depth, paper.assess.n_designs) == (9, 2376)
    assert (paper.rollout.n_settle, paper.rollout.n_measure) == (200, 1200)
    assert (paper.physics.max_motor_torque, paper.physics.gravity) == (100, 9.8)
    assert (paper.slush.density, paper.slush.linear_drag, paper.slush.angular_drag) == (1.25, 10, 20)


def test_no_network_is_called_unneeded_because_it_failed(settings):
    (train,) = (stage for stage in STAGES if stage.name == "train")
    failed = Results("train", {}, {train.plan(settings)[0].identity: Failure("out of memory")})
    assert not train.summarise(settings, {"train": failed}, None).lines
