"""Displacement of the root along x: the paper's objective."""

from tasks.evolution.objectives.evaluation import Objective, register_objective

register_objective(Objective("displacement", "Displacement", "m", lambda rollouts: rollouts.displacement))
