"""Science that fails is named in the status, on the page and by the exit code, and the rest of the study completes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from command_line import call
from small_study import TINY, Terminal

from pipeline.commands import study
from pipeline.commands.terminal import INCOMPLETE
from pipeline.stages import STAGES
from pipeline.stages.collect import throws_among
from pipeline.stages.reader import read_transitions
from pipeline.store.store import Store
from pipeline.workflow.stage import AnyStage, Files, Inputs, Item
from tasks.residual.training import train_member

SETTINGS = (
    "grid={depths: [1.0], environments: [dry_land, residual_slush], single_member_depths: [], n_trials: 3}",
    "work={throws_per_item: 3, generations_per_item: 4, engine: reference}",
)


@pytest.fixture
def options(tmp_path, monkeypatch) -> tuple[str, ...]:
    monkeypatch.setattr(study, "Tracker", lambda *_, **__: Terminal())
    (tmp_path / "tiny.yaml").write_text(TINY)
    changes = [word for change in SETTINGS for word in ("--set", change)]
    return "--settings", str(tmp_path / "tiny.yaml"), "--store", str(tmp_path / "store"), *changes


def inject(monkeypatch: pytest.MonkeyPatch, **computes) -> None:
    """Replace what stages compute."""
    stages: tuple[AnyStage, ...] = tuple(
        dataclasses.replace(stage, compute=computes.get(stage.name, stage.compute)) for stage in STAGES
    )
    monkeypatch.setattr(study, "STAGES", stages)


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
    return STAGES[2].compute(item, inputs)


def test_failures_are_named_and_the_rest_completes(options, monkeypatch, tmp_path, capsys):
    inject(monkeypatch, train=train_one_on_a_nan, evolve=evolve_some_badly)
    assert call("study", *options, "--workers", "0") == INCOMPLETE
    said = capsys.readouterr().err
    call("status", *options)
    status = capsys.readouterr().out
    store = Store.open(tmp_path / "store", create=False)
    page = (store.export_path("tiny") / "index.html").read_text()
    for stage, label, why in (
        ("train", "residual_slush/member-01", "TrainingDiverged: member 1: the training loss is nan at iteration 1"),
        ("evolve", "dry_land/1m/trial-1", "ArithmeticError: a defect"),
        ("evolve", "dry_land/1m/trial-2", "MemoryError"),
        ("evolve", "residual_slush/1m/trial-0", "not possible: train of residual_slush/member-01"),
    ):
        assert any(line.startswith(f"{stage}: {label}: ") and why in line for line in said.splitlines())
        assert label in status and why in status
        assert label in page and why in page
    assert {"residual_slush/member-00#0", "dry_land/1m/trial-0#0", "index.html#0"} <= {
        item.label for item in store.read_study("tiny").items
    }
    inject(monkeypatch)  # the causes are removed: what failed is computed, and nothing else
    before = set(store.items())
    assert call("train", *options, "--workers", "0") == call("evolve", *options, "--workers", "0") == 0
    made = set(store.items()) - before
    assert sorted(stage for stage, _ in made) == ["evolve"] * 5 + ["train"]


def test_designs_that_diverge_are_named_and_end_a_command_with_its_code(options, monkeypatch, capsys):
    diverged = {
        "diverged": lambda settings, upstream, store: dict.fromkeys(upstream["evolve"].done, "3 designs diverged")
    }
    monkeypatch.setattr(study, "STAGES", tuple(dataclasses.replace(stage, **diverged) for stage in STAGES))
    assert call("evolve", *options, "--set", "grid.environments=[dry_land]", "--workers", "0") == INCOMPLETE
    assert "evolve: dry_land/1m/trial-2: 3 designs diverged" in capsys.readouterr().err
