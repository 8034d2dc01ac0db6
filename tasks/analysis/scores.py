"""Scores: the displacements of a study's champions, one row for each trial, and the names of what they are."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from tasks.analysis.estimates import Sample, sample_of
from tasks.arrays import Float64, Int64
from tasks.world import ENVIRONMENTS, EnvironmentName

Quantity = Literal["predicted", "zero_shot", "adapted"]
"""Displacement where a champion evolved; in True Slush; in True Slush with a controller that evolved there."""
QUANTITIES: Mapping[Quantity, str] = {"predicted": "predicted", "zero_shot": "zero-shot", "adapted": "adapted"}
"""Quantities as they are shown, in their usual order."""

ScoredArm = tuple[EnvironmentName, Quantity]  # champions of one environment, zero-shot or adapted

BEST: ScoredArm = ("true_slush", "zero_shot")  # designs that evolved in True Slush, E: the paper's upper bound


def arm_name(arm: ScoredArm) -> str:
    """Return an arm's label; zero-shot designs of True Slush are at home there, so 'zero-shot' is left out."""
    label = ENVIRONMENTS[arm[0]].label
    return label if arm == BEST else f"{label} {QUANTITIES[arm[1]]}"


@dataclass(frozen=True)
class ScoredTrial:
    """What is known of a trial's champion [m]; NaN where it diverged, or there is none."""

    environment: EnvironmentName  # where it evolved
    depth: float  # [m]
    trial: int
    replicate: int  # of the throws and networks that it depends on; 0 where it evolved without networks
    fitness: float = np.nan  # where it evolved, in the objective's unit: μ - kσ for an ensemble
    predicted: float = np.nan  # displacement where it evolved: the mean over members for an ensemble, μ
    predicted_sd: float = np.nan  # its standard deviation over members, σ; NaN without an ensemble
    zero_shot: float = np.nan  # displacement of its root in True Slush
    zero_shot_com: float = np.nan  # displacement of its centre of mass there
    adapted: float = np.nan  # the same with a controller that evolved there
    adapted_com: float = np.nan
    status: Literal["ok", "no champion", "not done"] = "not done"


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores with one row for each trial, that is for each champion."""

    environment: npt.NDArray[np.str_]  # (n_trials,) where the champion evolved
    depth: Float64  # (n_trials,) [m]
    trial: Int64  # (n_trials,)
    predicted: Float64  # (n_trials,) displacement where it evolved [m]; NaN where unknown, as in the next two
    zero_shot: Float64  # (n_trials,) displacement in True Slush [m]
    adapted: Float64  # (n_trials,) displacement in True Slush with an adapted controller [m]
    replicate: Int64  # (n_trials,) data set and ensemble that the trial depends on

    @staticmethod
    def of(trials: "list[ScoredTrial]") -> "Scores":
        """Arrange trials as columns."""
        names: dict[str, type] = {"environment": np.str_, "depth": np.float64, "trial": np.int64}
        names |= dict.fromkeys(QUANTITIES, np.float64) | {"replicate": np.int64}
        return Scores(*(np.array([getattr(row, name) for row in trials], dtype=kind) for name, kind in names.items()))

    def rows(self, environment: EnvironmentName, depth: float) -> Int64:
        """Return the rows of one arm and depth [m], by trial number."""
        chosen = np.flatnonzero((self.environment == environment) & (self.depth == depth))
        return chosen[np.argsort(self.trial[chosen], kind="stable")]

    def sample(self, arm: ScoredArm, depth: float) -> Sample:
        """Return the finite values of an arm at a depth [m] by trial number, with their replicates."""
        rows = self.rows(arm[0], depth)
        return sample_of(getattr(self, arm[1])[rows], self.replicate[rows])

    def depths(self) -> list[float]:
        """Return the depths in ascending order [m]."""
        return [float(depth) for depth in np.unique(self.depth)]

    def arms(self) -> list[tuple[EnvironmentName, float]]:
        """Return the environments and depths that there are, in the order of listings, the greatest depth first."""
        known = set(zip(self.environment.tolist(), self.depth.tolist(), strict=True))
        return [(name, depth) for depth in self.depths()[::-1] for name in ENVIRONMENTS if (name, depth) in known]
