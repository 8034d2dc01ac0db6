"""Science that fails: it is named in the status, the report and the exit code, and the rest of the study completes.

The failures are real: a task of a stage diverges, runs out of memory or has a defect, and with --torture also hangs or
dies, which needs real workers. (tests/pipeline/cluster/test_cluster.py and tests/pipeline/workflow/test_dispatcher.py
have one task that dies and one that hangs in each `make test`.)
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
import signal
import sys
import time
from collections.abc import Sequence

import numpy as np
import pytest
import ray
import typer
from command_line import call
from small_study import labelled

import pipeline.stages
import pipeline.tracking.mirror
import pipeline.workflow.graph
from pipeline.cluster import Cluster, serial_cluster
from pipeline.commands.exit_codes import INCOMPLETE
from pipeline.commands.options import StudyOptions
from pipeline.commands.study import run_stages
from pipeline.commands.study_status import study_status
from pipeline.config.loading import load
from pipeline.config.settings import Settings
from pipeline.stages import STAGES, environments, segments
from pipeline.stages.collect import read_transitions, throws_among
from pipeline.stages.transfer import SCORE
from pipeline.store.encoding import decode_json, decode_table
from pipeline.store.manifest import Manifest
from pipeline.store.store import Store
from pipeline.workflow.dispatcher import Limits
from pipeline.workflow.stage import AnyStage, Files, Inputs, Job
from tasks.residual.training import train_member
from tasks.simulation.rollout import DIVERGED
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


def train_one_on_a_nan(job: Job, inputs: Inputs) -> Files:
    """Train member 1 on measurements that are not numbers."""
    if job.spec.member != 1:
        return STAGES[1].compute(job, inputs)
    transitions = read_transitions(throws_among(inputs))
    transitions.residual[:] = np.nan
    train_member(transitions, job.spec.network, job.spec.training, seed=job.spec.seed, member=1)
    raise AssertionError("the training succeeded, expected it to diverge")


def evolve_some_badly(job: Job, inputs: Inputs) -> Files:
    """Let four trials on dry land fail, each in a different way."""
    trial = job.spec.trial.identity
    match trial.environment, trial.index:
        case "dry_land", 1:
            raise ArithmeticError("a defect")
        case "dry_land", 2:
            hoard = [np.zeros(2**50)]
            while True:
                hoard.append(np.zeros(2**28))
        case "dry_land", 3:
            while True:
                time.sleep(1)
        case "dry_land", 4:
            crash()
    return STAGES[3].compute(job, inputs)


def crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def seconds_of_a_crash(cluster: Cluster) -> float:
    """Measure how long the death of a worker and the second attempt at its work take on a busy machine [s]."""
    for _ in range(2):  # the first also waits for workers to start
        begin = time.monotonic()
        cluster.submit(crash)
        assert cluster.next_done() is not None
    return time.monotonic() - begin


def injected(monkeypatch: pytest.MonkeyPatch, **computes) -> tuple[AnyStage, ...]:
    stages = tuple(dataclasses.replace(stage, compute=computes.get(stage.name, stage.compute)) for stage in STAGES)
    monkeypatch.setattr(pipeline.stages, "STAGES", stages)
    return stages


@pytest.mark.timeout(1200)  # patience with what hangs is a multiple of what workers take to start
def test_failures_are_named_and_the_rest_completes(torture, request, tmp_path, monkeypatch, capsys):
    injected(monkeypatch, train=train_one_on_a_nan, evolve=evolve_some_badly)
    (tmp_path / "tiny.yaml").write_text(TINY.replace("n_trials: 5", f"n_trials: {5 if torture.large else 3}"))
    open_cluster, limits = serial_cluster, None
    if torture.large:
        local_ray = request.getfixturevalue("local_ray")
        limits = Limits(factor=3.0, least_seconds=max(10.0, 8 * seconds_of_a_crash(local_ray)))
        open_cluster = functools.partial(contextlib.nullcontext, local_ray)
    chosen = StudyOptions(settings_file=tmp_path / "tiny.yaml", store=tmp_path / "store")
    options = ("--settings", str(chosen.settings_file), "--store", str(chosen.store))
    reasons = {
        "train: member-01": "TrainingDiverged: member 1: the training loss is nan at iteration 1",
        "evolve: dry_land/1m/trial-1": "ArithmeticError: a defect",
        "evolve: dry_land/1m/trial-2": "MemoryError",
        "evolve: residual_slush/1m/trial-0": "not possible: train of member-01",
    }
    if torture.large:
        reasons["evolve: dry_land/1m/trial-3"] = "it did not end within"
        reasons["evolve: dry_land/1m/trial-4"] = "WorkerCrashedError"
    for _ in torture.attempts(1, 3):
        with pytest.raises(typer.Exit) as ended:
            run_stages(chosen, open_cluster=open_cluster, limits=limits)
        assert ended.value.exit_code == INCOMPLETE
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
        n_lost = sum(line.count(" failed after 2 attempts") for line in said.splitlines())
        assert n_lost >= len(reasons) - 1
        done = {item.label for item in store.read_study("tiny").items}
        assert {"member-00#0", "dry_land/1m/trial-0#0", "index.html#0"} <= done
    # The causes are removed: what failed is computed, and nothing else. (Another page would show nothing new.)
    injected(monkeypatch)
    before = {(stage, key) for stage in store.stages() for key in store.keys(stage)}
    for stage in ("train", "evolve"):
        run_stages(chosen, (stage,), open_cluster=open_cluster)
    assert call("status", *options) == 0
    trained_and_evolved = capsys.readouterr().out.split("  transfer")[0]
    assert "  evolve" in trained_and_evolved and "failed" not in trained_and_evolved
    made = {(stage, key) for stage in store.stages() for key in store.keys(stage)} - before
    n_trials = 5 if torture.large else 3
    assert sorted(stage for stage, _ in made) == ["evolve"] * (2 * n_trials - 1) + ["train"]


SLOWEST = 0.15  # Hz

OF_SOUND_PHYSICS = "Rollouts in a sound world stay finite"


def some_in_a_wild_medium(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate all designs of trial 0, and slow ones of trial 1, in a medium whose drag is not a number."""
    real, current = environments.roll_out, list[int]()
    wild = Slush.model_construct(**{**Slush().model_dump(), "linear_drag": np.nan})

    def noted(stage: AnyStage):
        def compute(job: Job, inputs: Inputs) -> Files:
            current[:] = [job.spec.trial.identity.index]
            files = stage.compute(job, inputs)
            current.clear()
            return files

        return compute

    def roll_out(simulation, execution, environment, designs, **options):
        sound = real(simulation, execution, environment, designs, **options)
        trial = current[0] if current else 1
        lost = np.isfinite(designs.frequency) if trial == 0 else designs.frequency < SLOWEST
        if not lost.any():
            return sound
        other = real(simulation, execution, TrueSlush(depth=environment.depth, slush=wild), designs, **options)
        assert set(other.status) == {DIVERGED}
        chosen = {name: np.where(lost, getattr(other, name), getattr(sound, name)) for name in MEASURED}
        return dataclasses.replace(sound, **chosen)

    monkeypatch.setattr(environments, "roll_out", roll_out)
    injected(monkeypatch, evolve=noted(STAGES[3]), transfer=noted(STAGES[4]))


MEASURED = ("displacement", "com_displacement", "status")


def test_divergence_is_named_and_the_rest_completes(monkeypatch, tmp_path, capsys):
    """All designs of one trial diverge, and some of another one, in evolution and in the adaptation."""
    some_in_a_wild_medium(monkeypatch)
    monkeypatch.setattr(pipeline.tracking.mirror, "Tracker", lambda *_, **__: NoTracker())
    (tmp_path / "tiny.yaml").write_text(TINY)
    options = ("--settings", str(tmp_path / "tiny.yaml"), "--store", str(tmp_path / "store"))
    options += ("--set", "grid.environments=[dry_land]", "--set", "grid.n_trials=2")
    assert call("study", *options, "--workers", "0") == 1
    said = capsys.readouterr().err
    assert call("status", *options) == 0
    status = capsys.readouterr().out
    store = Store.open(tmp_path / "store", create=False)
    settings = load(Settings, tmp_path / "tiny.yaml", [option for option in options if "grid." in option])
    upstream = pipeline.workflow.graph.survey(settings, STAGES, store, say=print)
    assert not any(found.failed or found.unfinished for found in upstream.values())
    one = "dry_land/1m/trial-1"
    evolved, (*adapted, scored) = labelled(upstream["evolve"].done)[one], labelled(upstream["transfer"].done)[one]
    named = {
        "evolve: dry_land/1m/trial-0": "no champion: every design of the trial diverged",
        f"evolve: {one}": some_of(store, evolved, "designs"),
        f"transfer: {one}": some_of(store, adapted, "designs of the adaptation"),
    }
    page = (store.export_path("tiny") / "index.html").read_text()
    for where, what in named.items():
        assert said.splitlines().count(f"{where}: {what}") == 1
        assert f"<li>{where}: {what}</li>" in page
        stage, _, label = where.partition(": ")
        of_stage = status.split(f"  {stage} ")[1].split(" core-seconds\n")[1]
        assert f"    {label}: {what}\n" in of_stage
    assert status.count("diverged and w") == 2 and status.count("no champion") == 1
    assert OF_SOUND_PHYSICS in said
    score = decode_json(store.read(scored, SCORE), SCORE)
    assert score["status"] == "ok" and np.isfinite([score["predicted"], score["zero_shot"], score["adapted"]]).all()
    # It is said each time, also when nothing is left to compute, for the stages up to the requested one.
    assert call("evolve", *options, "--workers", "0") == 1
    again = capsys.readouterr().err.splitlines()
    assert [f"{where}: {what}" in again for where, what in named.items()] == [True, True, False]
    (path,) = store.root.glob(f"items/evolve/*/{evolved[0].key}/{segments.CURVE}")
    path.write_bytes(path.read_bytes()[:-1] + b"?")  # the same size: only reading it reveals the damage
    noted = study_status(settings, store, store.read_study("tiny"), with_diverged=True)
    assert segments.CURVE in noted.notes[-1]
    assert sum("diverged and w" in what for stage in noted.stages for what in stage.diverged.values()) == 1


def some_of(store: Store, trial: Sequence[Manifest], designs: str) -> str:
    """Say what must be said of a trial, counted in its history, where that is two or more of them."""
    read = [(part.key, store.read(part, segments.HISTORY)) for part in trial]
    parts = [decode_table(data, schema="history", version=1, source=key) for key, data in read]
    fitness, generation = (np.concatenate([part[name] for part in parts]) for name in ("fitness", "generation"))
    lost = np.isneginf(fitness)
    assert 2 <= lost.sum() < len(lost)
    when = generation[lost].min()
    return f"{lost.sum()} of {len(lost)} {designs} diverged and were discarded; the first in generation {when}"


class NoTracker:
    def mirror(self, *runs) -> None: ...

    def stop(self, study, status) -> None: ...
