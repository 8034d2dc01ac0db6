"""How far champions get in the target: a row per trial, and a row per arm. Paper, "Evolution" and Fig. 4."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tasks.analysis import paper
from tasks.analysis.columns import SCORE, OfArm, ScoreUnit, column, percent
from tasks.analysis.estimates import Estimate, Mean, mean_of, ratio
from tasks.analysis.registry import analysis
from tasks.analysis.scores import Quantity, ScoredTrial, arms, by_arm, sample
from tasks.analysis.study import StudyData
from tasks.residual.learner import LEARNERS
from tasks.seeding import generator
from tasks.world import EnvironmentName


@analysis("scores", row=ScoredTrial, reads=("champions",), answers="How well does the champion of each trial do?")
def scores(study: StudyData) -> Sequence[ScoredTrial]:
    """List every trial."""
    return study.trials


@dataclass(frozen=True)
class TransferRow(OfArm):
    """The champions of one environment at one depth."""

    zero_shot: Mean = column("zero-shot", SCORE, meaning="Displacement of the root in the target, as it is.")
    zero_shot_share: Estimate = column("share", form=percent, meaning="Of the zero-shot mean of the target's own.")
    adapted: Mean = column("adapted", SCORE, meaning="With a controller that evolved in the target.")
    adapted_share: Estimate = column("share, adapted", form=percent, meaning="Of the same mean.")
    predicted: Mean = column("predicted", SCORE, meaning="Where it evolved: for an ensemble the mean μ over members.")
    sigma: float | None = column("σ", SCORE, meaning="Mean deviation over the members of an ensemble.")
    fitness: float | None = column("μ − kσ", ScoreUnit(), meaning="Mean of what evolution maximised, for an ensemble.")
    n: int = column("n", form="{}", meaning="Trials.")
    paper_zero_shot: float | None = column("paper", "m", meaning="The paper's mean over 10 trials, zero-shot.")
    paper_adapted: float | None = column("paper, adapted", "m", meaning="The same, adapted.")


TOO_WIDE = ("n", "adapted", "sigma", "fitness", "paper_zero_shot", "paper_adapted")
"""Columns without which the table fits a terminal."""


def transfer_rows(trials: Sequence[ScoredTrial], target: EnvironmentName, *, papers: bool = False) -> list[TransferRow]:
    """Average the trials of each arm, the greatest depth first; the paper's means are beside them if asked for."""
    rows, grouped = [], by_arm(trials)
    for arm in arms(trials, target):
        mean = {name: mean_of(np.array([getattr(trial, name) for trial in grouped[arm]])) for name in _AVERAGED}
        is_ensemble = mean["predicted_sd"].value is not None
        rows.append(
            TransferRow(
                *arm,
                mean["zero_shot"],
                _share(trials, arm, "zero_shot", target),
                mean["adapted"],
                _share(trials, arm, "adapted", target),
                mean["predicted"],
                mean["predicted_sd"].value,
                mean["fitness"].value if is_ensemble else None,
                len(grouped[arm]),
                papers_mean(arm[0], "zero_shot", arm[1]) if papers else None,
                papers_mean(arm[0], "adapted", arm[1]) if papers else None,
            )
        )
    return rows


_AVERAGED = ("fitness", "predicted", "predicted_sd", "zero_shot", "adapted")


def _share(
    trials: Sequence[ScoredTrial], arm: tuple[EnvironmentName, float], quantity: Quantity, target: EnvironmentName
) -> Estimate:
    """Estimate an arm's share of the zero-shot mean of the target's own champions at its depth."""
    part, whole = (sample(trials, of, arm[1]) for of in ((arm[0], quantity), (target, "zero_shot")))
    return ratio(part, whole, rng=generator(0, "share", *arm, quantity))


def papers_mean(environment: str, quantity: str, depth: float) -> float | None:
    """Return the paper's mean [m], from a share where it gives only that; None where it gives neither."""
    if depth != paper.DEPTH:
        return None
    means: dict[tuple[str, str], float] = {arm: mean for arm, (mean, _) in paper.MEANS.items()}
    means = {arm: share * means[paper.BEST] for arm, (share, _) in paper.RATIOS.items()} | means
    return means.get((environment, quantity))


def _metrics(rows: Sequence[TransferRow]) -> dict[str, float | None]:
    """Return displacements and shares at the greatest depth; MLflow shows the first ten characters of their names."""
    single = [name for name, learner in LEARNERS.items() if learner.single]
    found = [row for row in rows if row.depth == rows[0].depth and row.environment not in single]
    metres = {f"m.{row.environment}": row.zero_shot.value for row in found}
    return metres | {
        f"share.{row.environment}": row.zero_shot_share.value for row in found if row.zero_shot_share.value != 1
    }


@analysis(
    "transfer",
    row=TransferRow,
    reads=("champions",),
    answers="How well do champions do in the target, by where they evolved?",
    section="transfer",
    metrics=_metrics,
)
def transfer(study: StudyData) -> list[TransferRow]:
    """Average the trials of each arm."""
    return transfer_rows(study.trials, study.target, papers=study.has_papers_target)
