"""A replay of a real rollout, and a study made of it and of numbers that are easy to check by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.report.data import Digest, ResidualError, StudyReport, TrialResult
from pipeline.report.replay import Replay, replay_of
from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.world import DryLand, TrueSlush

N_SETTLE, N_MEASURE = 60, 180


@pytest.fixture(scope="session")
def rollout():
    """One random design in True Slush of 2 m: design, trace (n_steps, n_links, 6), displacement [m]."""
    design = random_designs(1, np.random.default_rng(5))
    rollouts = simulate(
        design, TrueSlush(2.0), n_settle=N_SETTLE, n_measure=N_MEASURE, engine="reference", trace=True
    )
    return design, rollouts.trace[0], float(rollouts.displacement[0])


@pytest.fixture(scope="session")
def slush_replay(rollout) -> Replay:
    design, trace, _ = rollout
    return replay_of(
        design,
        trace,
        title="With residuals",
        environment="residual_slush",
        world="True Slush",
        depth=2.0,
        has_medium=True,
        n_settle=N_SETTLE,
    )


@pytest.fixture(scope="session")
def dry_replay(rollout) -> Replay:
    design, _, _ = rollout
    trace = simulate(design, DryLand(0.5), n_settle=0, n_measure=120, engine="reference", trace=True).trace[0]
    return replay_of(
        design,
        trace,
        title="On dry land",
        environment="dry_land",
        world="Dry Land",
        depth=0.5,
        has_medium=False,
        n_settle=0,
    )


def trial(environment: str, depth: float, number: int, predicted: float, zero_shot: float, adapted=None) -> TrialResult:
    return TrialResult(
        environment=environment,
        depth=depth,
        trial=number,
        predicted=predicted,
        zero_shot=zero_shot,
        zero_shot_com=zero_shot - 0.5,
        adapted=adapted,
        adapted_com=adapted,
        curve=np.linspace(0.0, predicted, 30),
    )


@pytest.fixture(scope="session")
def study(slush_replay, dry_replay) -> StudyReport:
    """Two depths; at 9 m True Slush has the mean 12, Dry Land −1, Residual Slush 9, a single member 3."""
    trials = [
        trial("true_slush", 9.0, 0, 11.0, 11.0),
        trial("true_slush", 9.0, 1, 13.0, 13.0),
        trial("dry_land", 9.0, 0, 60.0, -2.0, 4.0),
        trial("dry_land", 9.0, 1, 62.0, 0.0, 8.0),
        trial("residual_slush", 9.0, 0, 7.0, 8.0, 11.0),
        trial("residual_slush", 9.0, 1, 6.0, 10.0, 11.0),
        trial("single_member", 9.0, 0, 20.0, 3.0, 5.0),
        trial("true_slush", 1.0, 0, 30.0, 30.0),
        trial("dry_land", 1.0, 0, 60.0, 6.0, 21.0),
    ]
    errors = [
        ResidualError(member, component, unit, f"{band} m/s", 0.01 * (member + 1), 0.2)
        for member in range(2)
        for component, unit in (("x", "m"), ("vx", "m/s"), ("vy", "m/s"), ("omega", "rad/s"))
        for band in ("< 0.5", "0.5-2")
    ]
    return StudyReport(
        name="small",
        title="A small study",
        created_with={"puddle": "0.1.0"},
        settings_yaml="depths: [1, 9]\n",
        trials=trials,
        residual_errors=errors,
        replays=[dry_replay, slush_replay, replace(slush_replay, depth=9.0)],
        digests=[Digest("evolve", "true_slush 9 m trial 0", "ab" * 32)],
        seconds={"evolve": 125.0},
    )
