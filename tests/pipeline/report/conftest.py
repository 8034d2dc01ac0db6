"""A replay of a real rollout, and a study with it and with numbers that are easy to check by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.report.data import StudyReport, TrialResult
from pipeline.report.drawing import Drawing, Missing
from pipeline.report.figures import draw_all
from pipeline.report.findings import (
    Accuracy,
    Ancestor,
    ChampionCoverageRow,
    ChampionRow,
    ExploiterRow,
    Family,
    Findings,
    Moved,
    ThrowPaths,
)
from pipeline.report.replay import Replay, replay_of
from tasks.analysis.against_paper import against_paper
from tasks.analysis.attribution import attribute, transfer_matrix
from tasks.analysis.comparison import sweep
from tasks.analysis.coverage import EVERYTHING, CoverageRow
from tasks.analysis.hallucination import rank_exploiters
from tasks.analysis.luck import Luck
from tasks.analysis.member_error import MemberError
from tasks.analysis.prediction import accuracy, aggregates, histograms, members, members_ranges
from tasks.analysis.scores import Scores
from tasks.analysis.uncertainty import Estimate, mean
from tasks.analysis.variance_split import variances
from tasks.design import random_designs
from tasks.residual import OBSERVATION
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
    return replay_of(
        design,
        trace,
        title="With residuals",
        environment="residual_slush",
        seen_in="True Slush",
        depth=2.0,
        surroundings="true slush",
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
        seen_in="Dry Land",
        depth=0.5,
        surroundings="air",
        n_settle=0,
    )


@pytest.fixture(scope="session")
def predicted_replay(slush_replay) -> Replay:
    """The same robot as a member predicts it: twice as far."""
    frames = slush_replay.frames.copy()
    frames[..., 0] += np.linspace(0.0, frames[-1, 0, 0] - frames[0, 0, 0], len(frames))[:, None]
    return replace(slush_replay, frames=frames, seen_in="Residual Slush (member 1)", surroundings="hallucinated slush")


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


ARMS = ("true_slush", "dry_land", "residual_slush", "single_member")


def _covered(share: float) -> list[CoverageRow]:
    """Shares of 1 to 6 times the given one for the components, which make 21 times in all."""
    rows = [CoverageRow(name, 1000, (k + 1) * share, -1.0, 1.0, 0.6, 1.2) for k, name in enumerate(OBSERVATION)]
    return [CoverageRow(EVERYTHING, 1000, 21 * share, np.nan, np.nan, 0.6, 1.2), *rows]


@pytest.fixture(scope="session")
def findings() -> Findings:
    """The analysis of random numbers: 4 members over 300 designs, and 4 arms of 5 trials at 1 and 9 m."""
    rng = np.random.default_rng(7)
    true = rng.normal(3.0, 3.0, 300)
    predicted = 0.6 * true + rng.normal(0.0, 2.0, (4, 300))
    means = {"true_slush": 13.0, "dry_land": 1.0, "residual_slush": 9.0, "single_member": 2.0}
    grid = [(arm, depth, n) for arm in ARMS for depth in (1.0, 9.0) for n in range(5)]
    evolved_in, depth, number = (np.array(column) for column in zip(*grid, strict=True))
    zero_shot = np.array([means[arm] for arm in evolved_in]) + rng.normal(0.0, 1.0, len(grid))
    adapted = np.where(evolved_in == "true_slush", np.nan, zero_shot + 2.0)
    scores = Scores(evolved_in, depth, number, zero_shot + 3.0, zero_shot, adapted)
    fits = accuracy(predicted, true, rng=rng)
    ranges = members_ranges(predicted, true, rng=rng)
    shown = members(predicted) | {"mean": aggregates(predicted)["mean"], "mean, designed_throws": 0.9 * true + 0.5}
    ranked = rank_exploiters(predicted[:, :6].max(axis=0), true[:6], predicted[:, :6].std(axis=0))
    moved, loss = Moved(5.0, 1.0, 4.0), mean(np.array([1.0, 2.0, 3.0]))
    retried = ChampionRow(0, True, moved, moved, Luck(60.0, 58.0, loss, 1.0, n_diverged=0, n_tries=3))
    time = np.linspace(0.0, 3.3, 60)
    start, speed = rng.uniform(-6, 6, (9, 1)), rng.uniform(-20, 20, (9, 1))
    paths = np.stack((speed * (1 - np.exp(-time)), start - time, 5 * time + start), axis=-1)
    return Findings(
        throws=ThrowPaths(np.repeat([1.0, 2.0, 3.0], 3), paths, 3.3, n_learned=8),
        coverage={
            group: {seen_in: _covered(share) for seen_in in ("dry_land", "residual_slush")}
            for group, share in (("throws", 0.01), ("designed_throws", 0.002))
        },
        champion_coverage={("residual_slush", 9.0): [ChampionCoverageRow(n, _covered(0.02 * n)[0]) for n in range(5)]},
        other_regressions=[replace(fit, learned_from="designed_throws") for fit in fits],
        accuracy=Accuracy(9.0, fits, histograms(shown, true, n_bins=24)),
        against_paper=against_paper(scores, fits, ranges, rng=rng),
        contrasts=sweep(scores, rng=rng),
        attributions=attribute(scores, rng=rng),
        transfer_matrices={
            "true_slush": transfer_matrix([1, 1, 9, 9], [1, 9, 1, 9], np.array([30.0, 1, 5, 12])),
            "residual_slush": transfer_matrix([1, 1, 9, 9], [1, 9, 1, 9], np.array([30.0, 2, 18, 9])),
        },
        exploiters=[
            ExploiterRow(
                row.rank,
                "champion",
                "residual_slush",
                9.0,
                row.design,
                -1,
                -1,
                row.predicted,
                row.true,
                row.excess,
                row.disagreement,
                row.ranked_by,
                row.reason,
                by_member=tuple(predicted[:, row.design].tolist()),
            )
            for row in ranked
        ],
        champions={"Dry Land, 1 m": [retried]},
        phantom_thrust=[mean(rng.normal(0.1 * n, 0.02, 9)) for n in range(3)] + [Estimate.missing("it is not finite")],
        member_errors=[
            MemberError(
                member, component, band, immersion, 9, 0.1, 0.1 * (member + 1), 0.0 if immersion == "dry" else 2.0
            )
            for member in range(2)
            for component in ("vx", "vy", "omega")
            for band in ("< 0.5", "0.5-2")
            for immersion in ("dry", "partly", "submerged")
        ],
        family=Family(
            "Residual Slush, 9 m, trial 0",
            [
                Ancestor(3, 0, 0, "random", (), 1.0, None),
                Ancestor(5, 0, 0, "random", (), 2.0, None),
                Ancestor(9, 1, 1, "mutation", (3,), 2.5, 4),
                Ancestor(21, 4, 4, "crossover", (9, 5), 4.0, 12),
            ],
        ),
    )


@pytest.fixture(scope="session")
def replicated(findings) -> Findings:
    """The analysis of six trials of two arms at 9 m; those of the ensemble are of two replicates that differ by 4 m."""
    rng, trial = np.random.default_rng(8), np.tile(np.arange(6), 2)
    learned = np.repeat([False, True], 6)
    evolved_in = np.where(learned, "residual_slush", "true_slush")
    replicate = np.where(learned, trial % 2, 0)
    zero_shot = np.where(learned, 7.0, 13.0) + 4.0 * replicate + rng.normal(0.0, 0.5, 12)
    scores = Scores(evolved_in, np.full(12, 9.0), trial, zero_shot + 1, zero_shot, np.full(12, np.nan), replicate)
    return replace(
        findings,
        against_paper=against_paper(scores, (), {}, rng=rng),
        contrasts=sweep(scores, rng=rng),
        attributions=attribute(scores, rng=rng),
        variances=variances(scores),
    )


@pytest.fixture(scope="session")
def study(slush_replay, dry_replay, predicted_replay, findings) -> StudyReport:
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
        MemberError(member, component, band, "all", 9, 0.0, 0.01 * (member + 1), 0.2)
        for member in range(2)
        for component in ("x", "vx", "vy", "omega")
        for band in ("< 0.5", "0.5-2")
    ]
    return StudyReport(
        name="small",
        title="A small study",
        created_with={"puddle": "0.1.0"},
        settings_yaml="depths: [1, 9]\n",
        trials=trials,
        residual_errors=errors,
        replays=[
            replace(slush_replay, title="Without", environment="dry_land", film="replay-dry_land-2m"),
            replace(slush_replay, film="replay-residual_slush-2m"),
            replace(slush_replay, depth=9.0, film="replay-residual_slush-9m", robot="robot-residual_slush-9m-trial-0"),
            replace(predicted_replay, depth=9.0, robot="robot-residual_slush-9m-trial-0"),
            dry_replay,
            replace(slush_replay, title="Without", environment="dry_land", depth=9.0, film="replay-dry_land-9m"),
        ],
        findings=findings,
        digests=[("evolve", "true_slush 9 m trial 0", "ab" * 32)],
    )


@pytest.fixture(scope="session")
def drawn(study) -> dict[str, Drawing | Missing]:
    """Its figures, drawn once because that takes seconds."""
    return draw_all(study)
