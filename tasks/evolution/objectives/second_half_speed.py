"""Mean speed of the root along x over the second half of the measured time.

A robot gains nothing by a single leap or by unfolding at the start: what counts is how fast it still moves later.
"""

from tasks.arrays import Float64
from tasks.evolution.objectives.evaluation import Objective, register_objective
from tasks.simulation import Rollouts


def _second_half_speed(rollouts: Rollouts) -> Float64:
    return rollouts.second_half_speed


register_objective(Objective("second_half_speed", "Speed in the second half", "m/s", _second_half_speed))
