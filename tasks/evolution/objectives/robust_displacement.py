"""Mean displacement of the root along x over starts and time steps: what is not luck, nor the integrator's error.

It is the mean over two rollouts: that of displacement, and one from another start, with half the time step. A mean, and
not the least, so that it remains a displacement that can be expected. It takes three times as long as displacement, and
the table ``robustness`` tests it with a quarter of the time step. Under networks, which predict the change in a step of
their throws, shorter steps change in proportion.
"""

from tasks.evolution.objectives.evaluation import Objective, register_objective
from tasks.simulation import Conditions

register_objective(
    Objective(
        "robust_displacement",
        "Robust displacement",
        "m",
        lambda rollouts: rollouts.displacement,
        conditions=(Conditions(), Conditions(n_substeps=2, start=1)),
    )
)
