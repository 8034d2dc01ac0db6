"""Mean displacement of the root along x over several depths of the ground: a generalist."""

from tasks.evolution.objectives.evaluation import Objective, register_objective

register_objective(
    Objective("mean_over_depths", "Mean displacement", "m", lambda rollouts: rollouts.displacement, over_depths=True)
)
