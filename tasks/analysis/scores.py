"""Scores of a study's champions by its objective, one row for each trial, and the names of what they are."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np

from tasks.analysis.columns import SCORE, OfArm, OfTrial, ScoreUnit, column
from tasks.analysis.estimates import Sample, sample_of
from tasks.design import Designs
from tasks.residual.learner import arm_kind, in_order
from tasks.world import EnvironmentName

RowT = TypeVar("RowT", bound=OfArm)
Quantity = Literal["predicted", "zero_shot", "adapted"]
"""Score where a champion evolved; in the target; in the target with a controller that evolved there."""
QUANTITIES: Mapping[Quantity, str] = {"predicted": "predicted", "zero_shot": "zero-shot", "adapted": "adapted"}
"""Quantities as they are shown, in their usual order."""

ScoredArm = tuple[EnvironmentName, Quantity]  # champions of one environment, zero-shot or adapted


def arm_name(arm: ScoredArm) -> str:
    """Return an arm's label and its quantity."""
    return f"{arm_kind(arm[0]).label} {QUANTITIES[arm[1]]}"


@dataclass(frozen=True)
class ScoredTrial(OfTrial):
    """What is known of a trial's champion; NaN where it diverged, or there is none."""

    replicate: int = column("replicate", form="{}", shown=False, meaning="Of the throws and networks; 0 without any.")
    fitness: float = column(
        "fitness", ScoreUnit(), default=math.nan, meaning="Where it evolved: μ − kσ for an ensemble."
    )
    predicted: float = column(
        "predicted", SCORE, default=math.nan, meaning="Displacement of the root where it evolved: μ."
    )
    predicted_sd: float = column(
        "σ", SCORE, default=math.nan, meaning="Standard deviation over the members of an ensemble."
    )
    zero_shot: float = column("zero-shot", SCORE, default=math.nan, meaning="Displacement of the root in the target.")
    adapted: float = column("adapted", SCORE, default=math.nan, meaning="With a controller that evolved in the target.")
    passive: float = column("motors off", SCORE, default=math.nan, meaning="Zero-shot, with every motor off.")
    status: Literal["ok", "no champion", "not done"] = column(
        "status", form="{}", default="not done", meaning="ok, no champion (every design diverged), or not done."
    )


@dataclass(frozen=True, eq=False)
class Champion(ScoredTrial):
    """The champion of a trial, with what is known of it."""

    design: Designs = field(kw_only=True)


def sample(trials: Sequence[ScoredTrial], arm: ScoredArm, depth: float) -> Sample:
    """Return the finite values of an arm at a depth [m] by trial number, with their replicates."""
    of_arm = sorted(by_arm(trials).get((arm[0], depth), ()), key=lambda row: row.trial)
    values, replicate = ([getattr(row, name) for row in of_arm] for name in (arm[1], "replicate"))
    return sample_of(np.array(values, dtype=np.float64), np.array(replicate, dtype=np.int64))


def by_arm(rows: Iterable[RowT]) -> dict[tuple[EnvironmentName, float], list[RowT]]:
    """Group rows by environment and depth [m], in the order of their first rows."""
    groups: dict[tuple[EnvironmentName, float], list[RowT]] = {}
    for row in rows:
        groups.setdefault((row.environment, row.depth), []).append(row)
    return groups


def arms(trials: Sequence[ScoredTrial], target: EnvironmentName = "") -> list[tuple[EnvironmentName, float]]:
    """Return the environments and depths that there are, in the order of listings, the greatest depth first."""
    known = by_arm(trials)
    depths, names = sorted({depth for _, depth in known}, reverse=True), in_order((name for name, _ in known), target)
    return [(name, depth) for depth in depths for name in names if (name, depth) in known]
