"""Displacement of the root along x per mechanical work of the motors.

The work is that of all motors over the measured time, braking included (:class:`tasks.simulation.Rollouts`), in place
of a motor's electrical energy, which the simulation does not know. The robot floats or lies on the ground while it
works, so this is the inverse of its cost of transport up to its weight.

Robots without motors topple, slide or drift by up to 2 m and do no work at all: of 2,000 random designs 84 do none, and
some of them would have the best ratio of all. So the work counts as 58.8 J at least, which lifts the robot by a metre.
Below that nothing is gained by saving work, and the objective is displacement.
"""

import numpy as np

from tasks.arrays import Float64
from tasks.evolution.objectives.evaluation import Objective, register_objective
from tasks.simulation import Rollouts

LEAST_WORK = 58.8  # [J]: 6 kg · 9.8 m/s² · 1 m
_KILOJOULE = 1000.0  # [J]; per joule, most robots would have 0.0 m


def _displacement_per_energy(rollouts: Rollouts) -> Float64:
    assert rollouts.motor_work is not None
    return rollouts.displacement / (np.maximum(rollouts.motor_work, LEAST_WORK) / _KILOJOULE)


register_objective(
    Objective(
        "displacement_per_energy",
        "Displacement per mechanical energy",
        "m/kJ",
        _displacement_per_energy,
        motor_work=True,
    )
)
