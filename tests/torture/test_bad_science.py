"""Science that goes wrong on its own: set aside, named in status, report and exit code, and the rest completes.

What goes wrong is real: a task of the stage itself, on a real worker, that diverges, hangs, allocates or dies.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import sys
import time
from collections.abc import Mapping

import numpy as np
import pytest
import ray

import pipeline.cli
import pipeline.driver
import pipeline.stages
import pipeline.status
import pipeline.study
from pipeline.artifacts import decode_json
from pipeline.cli import main
from pipeline.cluster import Cluster, serial_cluster
from pipeline.configuration import parse
from pipeline.settings import Settings
from pipeline.stage import Files, Job, Stage
from pipeline.stages import STAGES, segments
from pipeline.stages.collect import read_transitions
from pipeline.stages.transfer import SCORE
from pipeline.store import Store
from tasks.residual import Architecture, Training
from tasks.residual.training import train_member
from tasks.world import Slush, TrueSlush

ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])  # the workers can't import a test

TINY = """
name: tiny
throws: {n_throws: 6, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 20, batch_size: 64}
ensemble: {n_members: 2}
grid: {depths: [1.0], environments: [dry_land, residual_slush], single_member_depths: [], n_trials: 5}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 4, afpo: {population_size: 4}}
transfer: {n_generations: 2}
assess: {n_designs: 10}
work: {throws_per_item: 3, generations_per_item: 4, engine: reference}
"""


def train_one_on_a_nan(job: Job, inputs: Mapping[str, Files]) -> Files:
    """Train member 1 on a measurement that is none."""
    if job.spec["member"] != 1:
        return STAGES[1].compute(job, inputs)
    transitions = read_transitions([inputs[name] for name in sorted(inputs)])
    transitions.residual[:] = np.nan
    network, training = Architecture(**job.spec["network"]), Training.model_validate(job.spec["training"])
    train_member(transitions, network, training, seed=job.spec["seed"], member=1)
    raise AssertionError("it can't have learned anything")


def evolve_some_badly(job: Job, inputs: Mapping[str, Files]) -> Files:
    """Let four trials on dry land go wrong, each in its way."""
    match job.spec["identity"]:
        case [_, _, "dry_land", 1]:
            hoard = []
            while True:
                hoard.append(np.zeros(2**28))
        case [_, _, "dry_land", 2]:
            while True:
                time.sleep(1)
        case [_, _, "dry_land", 3]:
            crash()
        case [_, _, "dry_land", 4]:
            raise ArithmeticError("a defect")
    return STAGES[2].compute(job, inputs)


def crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def seconds_of_a_crash(cluster: Cluster) -> float:
    """Measure how long a worker's death and its work's second try take, on a machine that may have much else to do."""
    begin = time.monotonic()
    cluster.submit(crash)
    assert cluster.next_done() is not None
    return time.monotonic() - begin


def injected(monkeypatch: pytest.MonkeyPatch, **computes) -> tuple[Stage, ...]:
    stages = tuple(
        dataclasses.replace(stage, compute=computes.get(stage.name, stage.compute)) for stage in STAGES
    )
    for module in (pipeline.stages, pipeline.driver, pipeline.status):
        monkeypatch.setattr(module, "STAGES", stages)
    return stages


def call(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    return int(ended.value.code or 0)


def test_what_goes_wrong_is_set_aside_and_named_and_the_rest_completes(
    torture, local_ray, tmp_path, monkeypatch, capsys
):
    injected(monkeypatch, train=train_one_on_a_nan, evolve=evolve_some_badly)
    monkeypatch.setattr(pipeline.cli, "_cluster", lambda *_: lambda: contextlib.nullcontext(local_ray))
    monkeypatch.setattr(pipeline.study, "LEAST_PATIENCE_SECONDS", max(10.0, 8 * seconds_of_a_crash(local_ray)))
    monkeypatch.setattr(pipeline.study, "PATIENCE", 3.0)
    (tmp_path / "tiny.yaml").write_text(TINY)
    options = ("--settings", str(tmp_path / "tiny.yaml"), "--store", str(tmp_path / "store"))
    reasons = {
        "train: member-01": "TrainingDiverged: member 1: the training loss is nan at iteration 1",
        "evolve: dry_land/1m/trial-1": "MemoryError",
        "evolve: dry_land/1m/trial-2": "it did not end within",
        "evolve: dry_land/1m/trial-3": "WorkerCrashedError",
        "evolve: dry_land/1m/trial-4": "ArithmeticError: a defect",
        "evolve: residual_slush/1m/trial-0": "train of member-01 is set aside",
    }
    for _ in torture.attempts(1, 3):
        assert call("study", *options) == 1
        said = capsys.readouterr().err
        assert call("status", *options) == 0
        status = capsys.readouterr().out
        store = Store.open(tmp_path / "store", create=False)
        page = (store.export_path("tiny") / "index.html").read_text()
        for where, why in reasons.items():
            stage, _, label = where.partition(": ")
            line = next(line for line in said.splitlines() if line.startswith(f"{where}: "))
            assert why in line
            listed = next(line for line in status.split(f"  {stage}")[1].splitlines() if line.strip().startswith(label))
            assert why in listed
            assert label in page and why in page
        assert "tried again by the next `puddle study`" in status
        n_lost = sum(line.count(" is set aside after") for line in said.splitlines())
        assert n_lost >= 5
        done = {item.label for item in store.read_study("tiny").items}
        assert {"member-00#0", "dry_land/1m/trial-0#0", "index.html#0"} <= done
    # The causes are mended: what was set aside is computed, and nothing else. (Another page would tell nothing new.)
    injected(monkeypatch)
    monkeypatch.setattr(pipeline.study, "LEAST_PATIENCE_SECONDS", 600.0)
    before = {(stage, key) for stage in store.stages() for key in store.keys(stage)}
    assert call("train", *options) == 0
    assert call("evolve", *options) == 0
    assert call("status", *options) == 0
    trained_and_evolved = capsys.readouterr().out.split("  transfer")[0]
    assert "  evolve" in trained_and_evolved and "set aside" not in trained_and_evolved
    made = {(stage, key) for stage in store.stages() for key in store.keys(stage)} - before
    assert sorted(stage for stage, _ in made) == ["evolve"] * 9 + ["train"]


def test_trials_whose_every_design_diverges_complete_and_say_so(monkeypatch, tmp_path):
    """A medium whose drag is no number: every rollout diverges, and only that."""
    wild = Slush.model_construct(**{**Slush().model_dump(), "linear_drag": np.nan})
    monkeypatch.setattr(segments, "world_of", lambda spec, inputs: TrueSlush(depth=spec["depth"], slush=wild))
    overrides = ("grid.environments=[dry_land]", "grid.n_trials=1")
    settings = parse(Settings, TINY, name="tiny", overrides=overrides)
    store = Store.open(tmp_path / "store", create=True)
    upstream = {}
    with serial_cluster() as cluster:
        for stage in STAGES:
            walks = pipeline.study.follow(stage, settings, store, upstream, say=print)
            pipeline.study.run_stage(
                settings, stage, walks, upstream, store=store, cluster=cluster, bar=NoBar(), say=print
            )
            upstream[stage.name] = pipeline.study.results_of(stage, walks)
            assert not upstream[stage.name].set_aside
    (scored,) = (done[-1] for done in upstream["transfer"].done.values())
    score = decode_json(store.read(scored, SCORE), SCORE)
    assert "diverged" in score["status"]
    page = store.read(upstream["report"].done["index.html"][0], "index.html").decode()
    assert "diverged" in page
    named = "dry_land/1m/trial-0: no champion: every design of the trial diverged"
    assert [line.strip() for line in pipeline.status.status_lines(settings, store)].count(named) == 1
    (path,) = store.root.glob(f"items/transfer/*/{scored.key}/{SCORE}")
    path.write_bytes(path.read_bytes()[:-1])
    noted = list(pipeline.status.status_lines(settings, store))
    assert SCORE in noted[-1] and not any(named in line for line in noted)


class NoBar:
    def advance(self, work: float) -> None: ...
