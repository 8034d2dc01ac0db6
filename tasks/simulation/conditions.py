"""Conditions of a rollout that differ from a study's: another depth, finer steps, another start.

A rollout repeats itself exactly, so a score may be that of a lucky start, or of an integrator's error at one time step.
"""

from dataclasses import dataclass, replace

import numpy as np

from tasks.design import Designs, jittered
from tasks.seeding import generator
from tasks.world import Environment, Physics

_SHIFT, _TURN = 1e-3, 1e-3  # of every joint along its links [m], and of its angle [rad]


@dataclass(frozen=True)
class Conditions:
    """What differs from a study's rollouts; by default nothing."""

    depth: float | None = None  # of the ground [m]; None: the environment's own
    n_substeps: int = 1  # steps in place of each: the time step is shorter, and the duration the same
    start: int = 0  # every number but 0 is another start: all joints are a millimetre and a milliradian off
    continuous_collision: bool = False  # whether to turn Box2D's continuous collision on, in the reference engine

    def of_designs(self, designs: Designs) -> Designs:
        """Return the designs as they start; what becomes of one doesn't depend on the others."""
        if self.start == 0:
            return designs
        length = np.maximum(designs.length_scale, 1.0)  # the shortest; 0 of a link that a design lacks
        of_parent = np.take_along_axis(length, np.maximum(designs.parent, 0), axis=1)
        shifts = {
            "parent_attachment": _SHIFT / (of_parent / 2),
            "child_attachment": _SHIFT / (length / 2),
            "rest_angle": np.full_like(length, _TURN),
        }
        return jittered(designs, generator(0, "start", self.start), shifts)

    def of_environment(self, environment: Environment) -> Environment:
        """Return the environment; its networks follow the time step of the physics."""
        return environment if self.depth is None else replace(environment, depth=self.depth)

    def of_physics(self, physics: Physics) -> Physics:
        """Return the constants of the simulator."""
        continuous = physics.continuous_collision or self.continuous_collision
        shorter = physics.time_step / self.n_substeps
        return physics.model_copy(update={"time_step": shorter, "continuous_collision": continuous})
