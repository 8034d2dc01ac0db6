"""Scores: the displacements of a study's champions, one row for each trial, and the names of what they are."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from tasks.analysis.replicates import NestedSample, nested_sample
from tasks.arrays import Float64, Int64
from tasks.world.registry import EnvironmentName

EvolvedIn = EnvironmentName  # the arm of a study: where a champion evolved
Quantity = Literal["predicted", "zero_shot", "adapted"]
"""Displacement where a champion evolved; in True Slush; in True Slush with a controller that evolved there."""
QUANTITY_WORDS: Mapping[Quantity, str] = {"predicted": "predicted", "zero_shot": "zero-shot", "adapted": "adapted"}
"""Quantities as they are shown, in their usual order."""

ScoredArm = tuple[EvolvedIn, Quantity]  # champions of one environment, zero-shot or adapted

BEST: ScoredArm = ("true_slush", "zero_shot")  # designs that evolved in True Slush, E: the paper's upper bound


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores with one row for each trial, that is for each champion."""

    evolved_in: npt.NDArray[np.str_]  # (n_trials,) values of EvolvedIn
    depth: Float64  # (n_trials,) [m]
    trial: Int64  # (n_trials,)
    predicted: Float64  # (n_trials,) displacement where the champion evolved [m]; NaN where unknown, as in the next two
    zero_shot: Float64  # (n_trials,) displacement in True Slush [m]
    adapted: Float64  # (n_trials,) displacement in True Slush with an adapted controller [m]
    replicate: Int64 = field(default_factory=lambda: np.zeros(0, np.int64))
    """(n_trials,) data set and ensemble that the trial depends on; if left out, the same for all."""

    def __post_init__(self) -> None:
        if len(self.replicate) == 0:
            object.__setattr__(self, "replicate", np.zeros(np.shape(self.trial), np.int64))
        shapes = {name: np.shape(array) for name, array in vars(self).items()}
        if len(set(shapes.values())) != 1 or len(shapes["depth"]) != 1:
            raise ValueError(f"scores have columns of shapes {shapes}, expected (n_trials,) for all")

    def rows(self, evolved_in: EvolvedIn, depth: float) -> Int64:
        """Return the rows of one arm and depth [m], by trial number."""
        chosen = np.flatnonzero((self.evolved_in == evolved_in) & (self.depth == depth))
        return chosen[np.argsort(self.trial[chosen], kind="stable")]

    def values(self, evolved_in: EvolvedIn, quantity: Quantity, depth: float) -> Float64:
        """Return one quantity of the trials of an arm and depth by trial number, NaN included: (n_trials,) [m].

        Args:
            evolved_in: the arm.
            quantity: the column.
            depth: depth where the champions evolved [m].
        """
        column: Float64 = getattr(self, quantity)
        return column[self.rows(evolved_in, depth)]

    def sample(self, evolved_in: EvolvedIn, quantity: Quantity, depth: float) -> NestedSample:
        """Return the finite values of one quantity of an arm and depth by trial number, with their replicates.

        Args:
            evolved_in: the arm.
            quantity: the column.
            depth: depth where the champions evolved [m].
        """
        values = self.values(evolved_in, quantity, depth)
        return nested_sample(values, self.replicate[self.rows(evolved_in, depth)])

    def depths(self) -> list[float]:
        """Return the depths in ascending order [m]."""
        return [float(depth) for depth in np.unique(self.depth)]
