"""Mean displacement of the root along x over several depths of the ground: a generalist."""

from tasks.arrays import Float64
from tasks.evolution.objectives.evaluation import Objective, register_objective
from tasks.simulation import Rollouts


def _displacement(rollouts: Rollouts) -> Float64:
    return rollouts.displacement


register_objective(Objective("mean_over_depths", "Mean displacement", "m", _displacement, over_depths=True))
