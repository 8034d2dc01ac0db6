"""Mean speed of the root along x over the second half of the measured time.

A robot gains nothing by a single leap or by unfolding at the start: what counts is how fast it still moves later.
"""

from tasks.evolution.objectives.evaluation import Objective, register_objective

register_objective(
    Objective("second_half_speed", "Speed in the second half", "m/s", lambda rollouts: rollouts.second_half_speed)
)
