"""How far champions get in the target: a row per trial, and a row per arm. Paper, "Evolution" and Fig. 4."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tasks.analysis import paper
from tasks.analysis.columns import SCORE, OfArm, ScoreUnit, column, percent
from tasks.analysis.estimates import RESOLUTION, Mean, mean_of
from tasks.analysis.registry import analysis
from tasks.analysis.scores import ScoredTrial, arms
from tasks.analysis.study import StudyData
from tasks.residual.learner import LEARNERS
from tasks.world import EnvironmentName


@analysis("scores", row=ScoredTrial, reads=("champions",), answers="How well does the champion of each trial do?")
def scores(study: StudyData) -> Sequence[ScoredTrial]:
    """List every trial."""
    return study.trials


@dataclass(frozen=True)
class TransferRow(OfArm):
    """The champions of one environment at one depth."""

    zero_shot: Mean = column("zero-shot", SCORE, meaning="Displacement of the root in the target, as it is.")
    zero_shot_share: float | None = column("share", form=percent, meaning="Of the zero-shot mean of the target's own.")
    adapted: Mean = column("adapted", SCORE, meaning="With a controller that evolved in the target.")
    adapted_share: float | None = column("share", form=percent)
    predicted: Mean = column("predicted", SCORE, meaning="Where it evolved: for an ensemble the mean μ over members.")
    sigma: float | None = column("σ", SCORE, meaning="Mean deviation over the members of an ensemble.")
    fitness: float | None = column("μ − kσ", ScoreUnit(), meaning="Mean of what evolution maximised, for an ensemble.")
    n: int = column("n", form="{}", meaning="Trials.")
    paper_zero_shot: float | None = column("paper", "m", meaning="The paper's mean over 10 trials, zero-shot.")
    paper_adapted: float | None = column("paper, adapted", "m", meaning="The same, adapted.")


TOO_WIDE = ("n", "sigma", "fitness", "paper_zero_shot", "paper_adapted")
"""Columns without which the table fits a terminal."""


def transfer_rows(trials: Sequence[ScoredTrial], target: EnvironmentName, *, papers: bool = False) -> list[TransferRow]:
    """Average the trials of each arm, the greatest depth first; the paper's means are beside them if asked for."""
    by_arm = {arm: [one for one in trials if (one.environment, one.depth) == arm] for arm in arms(trials, target)}
    means = {
        arm: {name: mean_of(np.array([getattr(one, name) for one in own])) for name in _AVERAGED}
        for arm, own in by_arm.items()
    }
    rows = []
    for (environment, depth), of_arm in means.items():
        best = means.get((target, depth), {})
        is_ensemble = of_arm["predicted_sd"].value is not None
        rows.append(
            TransferRow(
                environment,
                depth,
                of_arm["zero_shot"],
                _share(of_arm["zero_shot"], best.get("zero_shot")),
                of_arm["adapted"],
                _share(of_arm["adapted"], best.get("zero_shot")),
                of_arm["predicted"],
                of_arm["predicted_sd"].value,
                of_arm["fitness"].value if is_ensemble else None,
                len(by_arm[environment, depth]),
                papers_mean(environment, "zero_shot", depth) if papers else None,
                papers_mean(environment, "adapted", depth) if papers else None,
            )
        )
    return rows


_AVERAGED = ("fitness", "predicted", "predicted_sd", "zero_shot", "adapted")


def _share(part: Mean, whole: Mean | None) -> float | None:
    if part.value is None or whole is None or whole.value is None or whole.value <= RESOLUTION:
        return None
    return part.value / whole.value


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
    return metres | {f"share.{row.environment}": row.zero_shot_share for row in found if row.zero_shot_share != 1}


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
