"""Science that fails is named in the status, on the page and by the exit code, and the rest of the study completes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from command_line import call

import pipeline.stages
import pipeline.tracking.mirror
from pipeline.commands.terminal import INCOMPLETE
from pipeline.stages import STAGES, environments
from pipeline.stages.collect import read_transitions, throws_among
from pipeline.store.store import Store
from pipeline.workflow.stage import AnyStage, Files, Inputs, Item
from tasks.residual.training import train_member
from tasks.world import Slush, TrueSlush

TINY = """
name: tiny
throws: {n_throws: 6, n_steps: 20}
network: {hidden_layers: 1, width: 4}
training: {n_iterations: 20, batch_size: 64}
ensemble: {n_members: 2}
grid: {depths: [1.0], environments: [dry_land, residual_slush], single_member_depths: [], n_trials: 3}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 4, afpo: {population_size: 4}}
transfer: {n_generations: 2}
assess: {n_designs: 10}
work: {throws_per_item: 3, generations_per_item: 4, engine: reference}
"""


class NoTracker:
    def mirror(self, *runs) -> None: ...

    def stop(self, study, status) -> None: ...


@pytest.fixture
def options(tmp_path, monkeypatch) -> tuple[str, ...]:
    monkeypatch.setattr(pipeline.tracking.mirror, "Tracker", lambda *_, **__: NoTracker())
    (tmp_path / "tiny.yaml").write_text(TINY)
    return "--settings", str(tmp_path / "tiny.yaml"), "--store", str(tmp_path / "store")


def inject(monkeypatch: pytest.MonkeyPatch, **computes) -> None:
    """Replace what stages compute."""
    stages: tuple[AnyStage, ...] = tuple(
        dataclasses.replace(stage, compute=computes.get(stage.name, stage.compute)) for stage in STAGES
    )
    monkeypatch.setattr(pipeline.stages, "STAGES", stages)


def train_one_on_a_nan(item: Item, inputs: Inputs) -> Files:
    """Train member 1 on measurements that are not numbers."""
    if item.spec.member != 1:
        return STAGES[1].compute(item, inputs)
    transitions = read_transitions(throws_among(inputs))
    transitions.residual[:] = np.nan
    train_member(transitions, item.spec.network, item.spec.training, seed=item.spec.seed, member=1)
    raise AssertionError("the training succeeded, expected it to diverge")


def evolve_some_badly(item: Item, inputs: Inputs) -> Files:
    """Let two trials on dry land fail."""
    trial = item.spec.trial.identity
    if (trial.environment, trial.index) == ("dry_land", 1):
        raise ArithmeticError("a defect")
    if (trial.environment, trial.index) == ("dry_land", 2):
        np.zeros(2**50)
    return STAGES[3].compute(item, inputs)


def test_failures_are_named_and_the_rest_completes(options, monkeypatch, tmp_path, capsys):
    inject(monkeypatch, train=train_one_on_a_nan, evolve=evolve_some_badly)
    assert call("study", *options, "--workers", "0") == INCOMPLETE
    said = capsys.readouterr().err
    call("status", *options)
    status = capsys.readouterr().out
    store = Store.open(tmp_path / "store", create=False)
    page = (store.export_path("tiny") / "index.html").read_text()
    for stage, label, why in (
        ("train", "member-01", "TrainingDiverged: member 1: the training loss is nan at iteration 1"),
        ("evolve", "dry_land/1m/trial-1", "ArithmeticError: a defect"),
        ("evolve", "dry_land/1m/trial-2", "MemoryError"),
        ("evolve", "residual_slush/1m/trial-0", "not possible: train of member-01"),
    ):
        assert any(line.startswith(f"{stage}: {label}: ") and why in line for line in said.splitlines())
        assert label in status and why in status
        assert label in page and why in page
    assert {"member-00#0", "dry_land/1m/trial-0#0", "index.html#0"} <= {
        item.label for item in store.read_study("tiny").items
    }
    inject(monkeypatch)  # the causes are removed: what failed is computed, and nothing else
    before = {(stage, key) for stage in store.stages() for key in store.keys(stage)}
    assert call("train", *options, "--workers", "0") == call("evolve", *options, "--workers", "0") == 0
    made = {(stage, key) for stage in store.stages() for key in store.keys(stage)} - before
    assert sorted(stage for stage, _ in made) == ["evolve"] * 5 + ["train"]


def test_designs_that_diverge_are_named_and_the_rest_completes(options, monkeypatch, tmp_path, capsys):
    """Slow designs are simulated in a medium whose drag is not a number."""
    real = environments.roll_out
    wild = Slush.model_construct(**{**Slush().model_dump(), "linear_drag": np.nan})

    def roll_out(simulation, execution, environment, designs, **options):
        sound = real(simulation, execution, environment, designs, **options)
        lost = designs.frequency < np.median(designs.frequency)  # [Hz]
        if not lost.any():
            return sound
        other = real(simulation, execution, TrueSlush(depth=environment.depth, slush=wild), designs, **options)
        names = ("displacement", "com_displacement", "status")
        return dataclasses.replace(
            sound, **{name: np.where(lost, getattr(other, name), getattr(sound, name)) for name in names}
        )

    monkeypatch.setattr(environments, "roll_out", roll_out)
    few = ("--set", "grid.environments=[dry_land]", "--set", "grid.n_trials=1")
    assert call("study", *options, *few, "--workers", "0") == INCOMPLETE
    said = capsys.readouterr().err
    (line,) = {line for line in said.splitlines() if line.startswith("evolve: ") and "diverged" in line}
    store = Store.open(tmp_path / "store", create=False)
    assert line in (store.export_path("tiny") / "index.html").read_text()
    call("status", *options, *few)
    assert line.removeprefix("evolve: ") in capsys.readouterr().out
