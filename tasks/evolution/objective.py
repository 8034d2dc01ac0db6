"""The objective: how far a design gets, and how much of it the ensemble agrees on. Paper, "Performance Evaluation"."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tasks.arrays import Float64
from tasks.simulation import Rollouts


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What evolution learns of n_designs designs; worlds without an ensemble have one member."""

    fitness: Float64
    """(n_designs,) [m]; -inf where any rollout diverged."""
    displacement: Float64
    """(n_designs, n_members) of the root [m]; NaN where diverged."""
    com_displacement: Float64
    """(n_designs, n_members) of the whole robot's centre of mass [m]; NaN where diverged."""


def penalised_mean(displacement: Float64, *, disagreement_penalty: float) -> Float64:
    """Aggregate over members: μ - k σ, σ the deviation of these members (not an estimate for others).

    Args:
        displacement: (n_designs, n_members) [m].
        disagreement_penalty: k; the paper's is 1.

    Returns:
        (n_designs,) fitness [m]; -inf where a member's rollout diverged.
    """
    finite = np.asarray(np.isfinite(displacement).all(axis=1))
    known = np.where(finite[:, None], displacement, 0.0)
    fitness = known.mean(axis=1) - disagreement_penalty * known.std(axis=1)
    return np.where(finite, fitness, -np.inf)


def evaluate(rollouts: Rollouts, *, disagreement_penalty: float) -> Evaluation:
    """Score rollouts; with a single world, the fitness is the displacement itself."""
    displacement = np.atleast_2d(rollouts.displacement).T
    return Evaluation(
        fitness=penalised_mean(displacement, disagreement_penalty=disagreement_penalty),
        displacement=displacement,
        com_displacement=np.atleast_2d(rollouts.com_displacement).T,
    )
