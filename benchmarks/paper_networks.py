"""Robots under the paper's own networks: `python -m benchmarks.paper_networks`, then `puddle study`.

A GPU trained the networks of docs/results/paper-networks on the throws of the preset `paper`. This commits them to a
store as the results of `train`, once `puddle collect` with the same options has made the throws; and, with
`--evolved FOLDER`, the trials that evolve.py wrote there as the results of `evolve`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow.parquet as pq
from safetensors import safe_open

from pipeline.commands.terminal import exit_with
from pipeline.config.loading import load, preset_path
from pipeline.config.settings import Settings
from pipeline.errors import PuddleError
from pipeline.stages import STAGES, environments
from pipeline.stages.collect import throws_among, throws_inputs
from pipeline.stages.data_sets import NetworkId
from pipeline.stages.reader import read_transitions
from pipeline.stages.segments import SegmentSpec, compute_segment, population_of
from pipeline.stages.train import member_files
from pipeline.store.store import Store
from pipeline.workflow.graph import ChainProgress, StageRun, survey
from pipeline.workflow.identity import TrialId
from pipeline.workflow.stage import Files, Item
from tasks.analysis import paper
from tasks.arrays import Float64
from tasks.design import Designs
from tasks.evolution import Evaluation, penalised_mean
from tasks.residual.error_report import error_rows
from tasks.residual.forms import observe
from tasks.residual.forms.plain import PLAIN
from tasks.residual.network import Standardisation
from tasks.residual.throws import Transitions
from tasks.residual.training import TrainedMember

FOLDER = Path(__file__).resolve().parents[1] / "docs/results/paper-networks"
COLLECT, TRAIN, EVOLVE = STAGES[:3]
SURVIVORS = {"residual_slush": "ensemble_table", "single_member": "single_table"}  # genes of the last, by environment


def networks(data_set: int, transitions: Transitions) -> Iterator[TrainedMember]:
    """Read the networks of a data set, which must be the one that they learned from."""
    with safe_open(FOLDER / f"data-set-{data_set}.safetensors", "np") as file:
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    standard = Standardisation(**{one.name: arrays.pop(one.name) for one in fields(Standardisation)})
    observed, residual = observe(PLAIN, transitions.links), transitions.residual
    of_throws = Standardisation.of(observed, residual, standardise_targets=True)
    for one in fields(Standardisation):
        np.testing.assert_allclose(getattr(standard, one.name), getattr(of_throws, one.name), rtol=1e-5, atol=1e-7)
    curves = pq.read_table(FOLDER / "learning.parquet", filters=[("data_set", "=", data_set)])
    speed = np.hypot(*transitions.state[:, 3:5].T)
    for member in range(len(arrays["bias_0"])):
        weights = {name: array[member] for name, array in arrays.items()}
        hidden = standard.standard_observation(observed)
        for layer in range(last := len(weights) // 2 - 1):
            hidden = np.maximum(hidden @ weights[f"weight_{layer}"] + weights[f"bias_{layer}"], 0)
        predicted = standard.residual(hidden @ weights[f"weight_{last}"] + weights[f"bias_{last}"])
        points = curves.filter(np.equal(curves["member"], member)).select(["iteration", "training_loss", "loss"])
        curve = np.column_stack([points[name].to_numpy() for name in points.column_names])
        yield TrainedMember(weights, standard, PLAIN, curve, error_rows(predicted, residual, speed))


def commit_networks(run: StageRun) -> None:
    """Commit the networks of every data set."""
    trained: dict[int, list[TrainedMember]] = {}
    for progress in run.chains():
        if progress.finished:
            continue
        item, network = run.next_item(progress), progress.chain.identity
        assert isinstance(network, NetworkId)
        replicate = network.data_set.replicate
        if replicate not in trained:
            thrown = throws_inputs(run.upstream[COLLECT.name], network.data_set)
            inputs = {name: source.read(run.store) for name, source in thrown.items()}
            trained[replicate] = list(networks(replicate, read_transitions(throws_among(inputs))))
        _commit(run, progress, item, member_files(trained[replicate][network.index]))


def commit_trials(run: StageRun, folder: Path) -> None:
    """Commit the trials under networks: the search, told what the GPU told it, asks for the same designs again."""
    for progress in run.chains():
        trial = progress.chain.identity
        assert isinstance(trial, TrialId)
        if trial.environment not in SURVIVORS or trial.depth != paper.DEPTH:
            continue
        if trial.replicate != trial.index:
            raise PuddleError(f"{trial.label} is of data set {trial.replicate}: set grid.n_trials to replicates")
        evolved = np.load(folder / f"evolution-{trial.index}.npz")
        by_members = evolved["displacement"].astype(np.float64)
        scores = by_members[:, :, -1:] if trial.environment == "single_member" else by_members[:, :, :-1]
        if len(scores) < (expected := run.settings.evolution.n_generations):
            raise PuddleError(f"evolution-{trial.index}.npz: expected {expected} generations, got {len(scores)}")
        while not progress.finished:
            item = run.next_item(progress)
            generations, spec = iter(scores[item.spec.first_generation :]), item.spec

            def score(_: Designs, generations: Iterator[Float64] = generations, of: SegmentSpec = spec) -> Evaluation:
                root, whole = np.moveaxis(next(generations), 2, 0)
                fitness = penalised_mean(root, disagreement_penalty=of.trial.disagreement_penalty)
                return Evaluation(fitness, root, whole, scores=root)

            inputs = {name: source.read(run.store) for name, source in item.inputs.items()}
            with patch.object(environments, "scorer", lambda *_, score=score: score):  # in place of a simulation
                files = compute_segment(item, inputs)
            if spec.first_generation + spec.n_generations == len(scores):
                np.testing.assert_array_equal(population_of(files).table, evolved[SURVIVORS[trial.environment]])
            _commit(run, progress, item, files)


def _commit(run: StageRun, progress: ChainProgress, item: Item[Any], files: Files) -> None:
    record = {"label": item.label, "made_by": f"{item.stage}.py on a GPU"}
    run.store.commit(item.stage, item.identity, files, record=record)
    run.advance(progress)
    print(f"{item.label}: {item.key[:12]}")


def main() -> None:
    """Commit the networks, and the trials."""
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("--store", type=Path, default=Path("store"))
    parser.add_argument("--set", action="append", default=[], help="as for puddle collect")
    parser.add_argument("--evolved", type=Path, help="what evolve.py wrote; without it, `puddle study` evolves")
    options = parser.parse_args()
    settings = load(Settings, preset_path("paper"), options.set)
    store = Store.open(options.store, create=False)
    commit_networks(StageRun(TRAIN, settings, survey(settings, [COLLECT], store).upstream, store, print))
    if options.evolved is not None:
        upstream = survey(settings, [COLLECT, TRAIN], store).upstream
        commit_trials(StageRun(EVOLVE, settings, upstream, store, print), options.evolved)


if __name__ == "__main__":
    try:
        main()
    except (OSError, PuddleError) as error:
        exit_with(error)
