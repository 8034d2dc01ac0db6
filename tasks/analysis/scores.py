"""How champions fared: the table that the comparisons, the attribution and the paper's numbers are computed from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from tasks.arrays import Float64
from tasks.world.registry import EnvironmentName

EvolvedIn = EnvironmentName
"""The arm of a study that a champion is of."""
Quantity = Literal["predicted", "zero_shot", "adapted"]
"""Displacement in the world of its evolution; in True Slush; there with a controller that was evolved there."""


@dataclass(frozen=True, eq=False)
class Scores:
    """One row per trial, that is per champion."""

    evolved_in: npt.NDArray[np.str_]
    """(n_trials,) of EvolvedIn."""
    depth: Float64
    """(n_trials,) [m]"""
    trial: npt.NDArray[np.int64]
    """(n_trials,)"""
    predicted: Float64
    """(n_trials,) fitness where it evolved [m]; NaN where unknown, as in the other two."""
    zero_shot: Float64
    """(n_trials,) in True Slush [m]."""
    adapted: Float64
    """(n_trials,) in True Slush with an adapted controller [m]."""

    def __post_init__(self) -> None:
        shapes = {name: np.shape(array) for name, array in vars(self).items()}
        if len(set(shapes.values())) != 1 or len(shapes["depth"]) != 1:
            raise ValueError(f"scores have columns of shapes {shapes}, expected (n_trials,) for all")

    def rows(self, evolved_in: EvolvedIn, depth: float) -> npt.NDArray[np.int64]:
        """Find the trials of one environment and depth, in the order of their numbers."""
        chosen = np.flatnonzero((self.evolved_in == evolved_in) & (self.depth == depth))
        return chosen[np.argsort(self.trial[chosen], kind="stable")]

    def values(self, evolved_in: EvolvedIn, quantity: Quantity, depth: float) -> Float64:
        """Take one quantity of these trials, NaN included."""
        column: Float64 = getattr(self, quantity)
        return column[self.rows(evolved_in, depth)]

    def depths(self) -> list[float]:
        """List the depths, shallowest first."""
        return [float(depth) for depth in np.unique(self.depth)]
