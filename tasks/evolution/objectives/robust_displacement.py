"""Mean displacement of the root along x over starts and time steps: what is not luck, nor the integrator's error.

It is the mean over three rollouts, each from another start (:class:`tasks.simulation.Conditions`) and with another time
step: the study's, a half and a quarter of it. A mean, and not the least, so that it remains a displacement that can be
expected. It takes seven times as long as displacement. Under networks, which predict the change in a step of their
throws, shorter steps change in proportion.
"""

from tasks.evolution.objectives.evaluation import Objective, register_objective
from tasks.simulation import Conditions

register_objective(
    Objective(
        "robust_displacement",
        "Robust displacement",
        "m",
        lambda rollouts: rollouts.displacement,
        conditions=(Conditions(), Conditions(n_substeps=2, start=1), Conditions(n_substeps=4, start=2)),
    )
)
