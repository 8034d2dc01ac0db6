"""A replay of a real rollout, and a study with it and with numbers that are easy to check by hand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scores_of import study_of

from pipeline.config.settings import Settings
from pipeline.report import page
from pipeline.report.replay import Replay, replay_of
from pipeline.report.study_page import FIGURES, StudyPage, ThrowPaths
from tasks.analysis.study import Assessed
from tasks.analysis.tables import ANALYSES
from tasks.analysis.tables.exploiters import Exploiter
from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.world import DryLand, TrueSlush

N_SETTLE, N_MEASURE = 60, 180


@pytest.fixture(scope="session")
def rollout():
    """One random design in True Slush of 2 m: design, trace (n_steps, n_links, 6), displacement [m]."""
    design = random_designs(1, np.random.default_rng(5))
    rollouts = simulate(design, TrueSlush(2.0), n_settle=N_SETTLE, n_measure=N_MEASURE, engine="reference", trace=True)
    return design, rollouts.trace[0], float(rollouts.displacement[0])


@pytest.fixture(scope="session")
def slush_replay(rollout) -> Replay:
    design, trace, _ = rollout
    seen = replay_of(design, trace, TrueSlush(2.0), title="With residuals", seen_in="True Slush", n_settle=N_SETTLE)
    return replace(seen, environment="residual_slush", command="true_slush", in_target=True)


@pytest.fixture(scope="session")
def dry_replay(rollout) -> Replay:
    design, _, _ = rollout
    land = DryLand(0.5)
    trace = simulate(design, land, n_settle=0, n_measure=120, engine="reference", trace=True).trace[0]
    seen = replay_of(design, trace, land, title="On dry land", seen_in="Dry Land", n_settle=0)
    return replace(seen, environment="dry_land")


@pytest.fixture(scope="session")
def predicted_replay(slush_replay) -> Replay:
    """The same robot as a member predicts it: twice as far."""
    frames = slush_replay.frames.copy()
    frames[..., 0] += np.linspace(0.0, frames[-1, 0, 0] - frames[0, 0, 0], len(frames))[:, None]
    return replace(slush_replay, frames=frames, seen_in="Residual Slush (member 1)", hallucinated=True, in_target=False)


SETTINGS = """name: small
grid: {depths: [1, 9], environments: [true_slush, dry_land, residual_slush], n_trials: 2, single_member_depths: [9]}
"""
ZERO_SHOT = {
    ("true_slush", 9.0): [11.0, 13.0],
    ("dry_land", 9.0): [-2.0, 0.0],
    ("residual_slush", 9.0): [8.0, 10.0],
    ("single_member", 9.0): [3.0],
    ("true_slush", 1.0): [30.0],
    ("dry_land", 1.0): [6.0],
}
ADAPTED = {("dry_land", 9.0): [4.0, 8.0], ("residual_slush", 9.0): [11.0, 11.0], ("dry_land", 1.0): [21.0]}
PREDICTED = {("residual_slush", 9.0): [7.0, 6.0], ("single_member", 9.0): [20.0]}


@pytest.fixture(scope="session")
def study(slush_replay, dry_replay, predicted_replay) -> StudyPage:
    """Two depths; at 9 m True Slush has the mean 12, Dry Land −1, Residual Slush 9, a single member 3."""
    rng = np.random.default_rng(7)
    true = rng.normal(3.0, 3.0, 300)
    predicted, trial = 0.6 * true + rng.normal(0.0, 2.0, (4, 300)), [f"{k % 5}" for k in range(300)]
    data = study_of(ZERO_SHOT, adapted=ADAPTED, predicted=PREDICTED)
    data.settings.data_sets = ("residual_slush", "designed_throws")
    assessed = {
        group: Assessed(k + predicted, true, trial, np.zeros(300, np.int64))
        for k, group in enumerate(data.settings.data_sets)
    }
    data.assessed = assessed.get
    tables = {name: ANALYSES[name].compute(data) for name in ("scores", "transfer", "paper", "regressions")}
    tables["exploiters"] = [Exploiter("residual_slush", 9.0, 0, 1, 7.0, 1.0, 0.2, 0.2, 6.0, 2.5)]
    time = np.linspace(0.0, 3.3, 60)
    start, speed = rng.uniform(-6, 6, (9, 1)), rng.uniform(-20, 20, (9, 1))
    paths = np.stack((speed * (1 - np.exp(-time)), start - time, 5 * time + start), axis=-1)
    robot = "robot-residual_slush-9m-trial-0"
    best = replace(slush_replay, depth=9.0, best=True, arm_mean=9.0)
    return StudyPage(
        settings=Settings.model_validate(yaml.safe_load(SETTINGS)),
        tables=tables,
        curves={arm: [np.linspace(0.0, value, 30) for value in values] for arm, values in ZERO_SHOT.items()},
        assessed=assessed,
        throws=ThrowPaths(np.repeat([1.0, 2.0, 3.0], 3), paths),
        replays=[
            replace(slush_replay, title="Without", environment="dry_land"),
            slush_replay,
            replace(best, robot=robot),
            replace(predicted_replay, depth=9.0, robot=robot),
            dry_replay,
            replace(best, title="Without", environment="dry_land", arm_mean=-1.0),
        ],
        created_with={"puddle": "0.1.0"},
        digests=[("evolve", "true_slush 9 m trial 0", "ab" * 32)],
    )


@pytest.fixture(scope="session")
def drawn(study):
    """Its figures, drawn once because that takes seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "FIGURES", FIGURES)
        return page.draw_all(study)


@pytest.fixture(scope="module", autouse=True)
def in_full() -> Iterator[None]:
    """Draw all figures here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "FIGURES", FIGURES)
        yield
