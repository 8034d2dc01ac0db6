"""Displacement of the root along x: the paper's objective."""

from tasks.arrays import Float64
from tasks.evolution.objectives.evaluation import Objective, register_objective
from tasks.simulation import Rollouts


def _displacement(rollouts: Rollouts) -> Float64:
    return rollouts.displacement


register_objective(Objective("displacement", "Displacement", "m", _displacement))
