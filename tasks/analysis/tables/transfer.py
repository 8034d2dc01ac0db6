"""How far champions get in True Slush: a row per trial, and a row per arm. Paper, "Evolution" and Fig. 4."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tasks.analysis import paper
from tasks.analysis.estimates import RESOLUTION, Mean, mean_of
from tasks.analysis.registry import StudyData, analysis, column
from tasks.analysis.scores import BEST, ScoredTrial, Scores
from tasks.world import ENVIRONMENTS


def environment_name(name: str) -> str:
    """Write an environment with its symbol."""
    kind = ENVIRONMENTS[name]
    return f"{kind.label}, {kind.symbol}"


def percent(share: float) -> str:
    """Write a share in whole per cent."""
    return f"{100 * share:z.0f} %"


@dataclass(frozen=True)
class OfArm:
    """The first columns of a table about arms."""

    environment: str = column("evolved in", form=environment_name)
    depth: float = column("depth", "m", form="{:g}")


@dataclass(frozen=True)
class OfTrial(OfArm):
    """The first columns of a table about champions."""

    trial: int = column("trial", form="{}")


@dataclass(frozen=True)
class ScoreRow(OfTrial):
    """A champion; what is missing is None."""

    replicate: int = column("replicate", form="{}", shown=False, meaning="Of the throws and networks; 0 without any.")
    fitness: float | None = column("fitness", meaning="Where it evolved: μ − kσ for an ensemble.")
    predicted: float | None = column("predicted", "m", meaning="Displacement of the root where it evolved: μ.")
    predicted_sd: float | None = column("σ", "m", meaning="Standard deviation over the members of an ensemble.")
    zero_shot: float | None = column("zero-shot", "m", meaning="Displacement of the root in True Slush.")
    zero_shot_com: float | None = column("zero-shot CoM", "m", shown=False, meaning="Of the centre of mass.")
    adapted: float | None = column("adapted", "m", meaning="With a controller that evolved in True Slush.")
    adapted_com: float | None = column("adapted CoM", "m", shown=False, meaning="Of the centre of mass.")
    status: str = column("status", form="{}", meaning="ok, no champion (every design diverged), or not done.")


@analysis("scores", row=ScoreRow, reads=("transfer",), answers="How far does the champion of each trial get?")
def scores(study: StudyData) -> list[ScoreRow]:
    """List every trial."""
    return score_rows(study.trials)


def score_rows(trials: Sequence[ScoredTrial]) -> list[ScoreRow]:
    """Return the row of each trial; NaN becomes None."""
    known: Iterator[dict[str, Any]] = (
        {name: None if value != value else value for name, value in vars(trial).items()} for trial in trials
    )
    return [ScoreRow(**values) for values in known]


@dataclass(frozen=True)
class TransferRow(OfArm):
    """The champions of one environment at one depth."""

    n: int = column("n", form="{}", meaning="Trials.")
    predicted: Mean = column("predicted", "m", meaning="Where it evolved: for an ensemble the mean μ over its members.")
    sigma: float | None = column("σ", "m", meaning="Mean deviation over the members of an ensemble.")
    fitness: float | None = column("μ − kσ", meaning="Mean of what evolution maximised, for an ensemble.")
    zero_shot: Mean = column("zero-shot", "m", meaning="Displacement of the root in True Slush, as it is.")
    zero_shot_com: Mean = column("zero-shot CoM", "m", shown=False, meaning="Of the centre of mass.")
    zero_shot_share: float | None = column("of E", form=percent, meaning="Share of designs evolved in True Slush.")
    adapted: Mean = column("adapted", "m", meaning="With a controller that evolved in True Slush.")
    adapted_com: Mean = column("adapted CoM", "m", shown=False, meaning="Of the centre of mass.")
    adapted_share: float | None = column("of E", form=percent)
    adapted_share_of_adapted: float | None = column("of E adapted", form=percent, meaning="Both had a second search.")
    paper_zero_shot: float | None = column("paper", "m", meaning="The paper's mean over 10 trials, zero-shot.")
    paper_adapted: float | None = column("paper, adapted", "m", meaning="The same, adapted.")


TOO_WIDE = ("n", "sigma", "fitness", "adapted_share_of_adapted", "paper_zero_shot", "paper_adapted")
"""Columns without which the table fits a terminal."""


def transfer_rows(trials: Sequence[ScoredTrial]) -> list[TransferRow]:
    """Average the trials of each arm, the greatest depth first."""
    table = Scores.of(list(trials))
    means: dict[tuple[str, float], dict[str, Mean]] = {}
    for environment, depth in table.arms():
        own = [trial for trial in trials if (trial.environment, trial.depth) == (environment, depth)]
        means[environment, depth] = {
            name: mean_of(np.array([getattr(trial, name) for trial in own])) for name in _AVERAGED
        }
    rows = []
    for (environment, depth), of_arm in means.items():
        best = means.get((BEST[0], depth), {})
        n = sum((trial.environment, trial.depth) == (environment, depth) for trial in trials)
        is_ensemble = of_arm["predicted_sd"].value is not None
        rows.append(
            TransferRow(
                environment,
                depth,
                n,
                of_arm["predicted"],
                of_arm["predicted_sd"].value,
                of_arm["fitness"].value if is_ensemble else None,
                of_arm["zero_shot"],
                of_arm["zero_shot_com"],
                _share(of_arm["zero_shot"], best.get("zero_shot")),
                of_arm["adapted"],
                of_arm["adapted_com"],
                _share(of_arm["adapted"], best.get("zero_shot")),
                _share(of_arm["adapted"], best.get("adapted")),
                papers_mean(environment, "zero_shot", depth),
                papers_mean(environment, "adapted", depth),
            )
        )
    return rows


_AVERAGED = ("fitness", "predicted", "predicted_sd", "zero_shot", "zero_shot_com", "adapted", "adapted_com")


def _share(part: Mean, whole: Mean | None) -> float | None:
    if part.value is None or whole is None or whole.value is None or whole.value <= RESOLUTION:
        return None
    return part.value / whole.value


def papers_mean(environment: str, quantity: str, depth: float) -> float | None:
    """Return the paper's mean [m], from a share where it gives only that; None where it gives neither."""
    if depth != paper.DEPTH:
        return None
    means: dict[tuple[str, str], float] = {arm: mean for arm, (mean, _) in paper.MEANS.items()}
    means = {arm: share * means[BEST] for arm, (share, _) in paper.RATIOS.items()} | means
    return means.get((environment, quantity))


def _metrics(rows: Sequence[TransferRow]) -> dict[str, float | None]:
    return {
        f"ratio_to_true_slush.{quantity}.{row.environment}.{row.depth:g}m": getattr(row, f"{quantity}_share")
        for row in rows
        for quantity in ("zero_shot", "adapted")
        if row.environment != BEST[0]
    }


@analysis(
    "transfer",
    row=TransferRow,
    reads=("transfer",),
    answers="How far do champions get in True Slush, by where they evolved?",
    section="transfer",
    metrics=_metrics,
)
def transfer(study: StudyData) -> list[TransferRow]:
    """Average the trials of each arm."""
    return transfer_rows(study.trials)
