"""The virtual tank: whether a robot, once built, would cross it. Paper, "Manufacturing" and "Physical Validation".

The paper put its robot at one end of a tank of gel beads and water and waited until it reached the other end or 150 s
had passed, then drained the tank and repeated the test on the dry floor: 8 times in slush, 6 times on the floor. Here
the tank is scaled to the simulated robot: lengths by the scale of the build, times by Froude's law, the only one that
keeps weight, buoyancy, drag and inertia in proportion. At 70 mm per metre, 150 s are 567 s of simulation.

A simulation repeats itself exactly, so each further trial starts at another moment of the gait, with its joints shifted
by less than printing can hold. The simulated tank has no walls: two pontoons make a robot as wide as they are
apart.

The paper's robot did not move on the dry floor, "due to insufficient torque". So the dry floor is tried with the
simulation's limit and with the servo's torque, which scales as weight times length: as built, 1.96 N·m hold up as much
of a robot of 1.18 kg at 70 mm per metre as 143 N·m do in the simulation.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.random import Generator
from pydantic import Field, model_validator

from tasks.arrays import Bools, Float64
from tasks.design import Designs, jittered
from tasks.design.gait import TURN, begun_later
from tasks.parameters import Parameters
from tasks.simulation import Rollouts
from tasks.world import froude_time

_JITTER = dict.fromkeys(("parent_attachment", "child_attachment"), 1e-4)
"""Change of each attachment [half heights]: at most 0.01 mm if a metre is built as 70 mm."""


class Tank(Parameters):
    """The tank and the robot's scale; the paper's by default."""

    length: float = Field(default=1.17, gt=0.0, le=100.0)
    """Inner length of the tank [m]. [P]"""
    width: float = Field(default=0.33, gt=0.0, le=100.0)
    """Inner width of the tank [m]. [P]"""
    height: float = Field(default=0.27, gt=0.0, le=100.0)
    """Inner height of the tank [m]. [P]"""
    depth: float = Field(default=0.15, ge=0.0, le=100.0)
    """Depth of its filling [m]. [P]"""
    scale: float = Field(default=0.07, gt=0.0, le=10.0)
    """Built length of one simulated metre [m]. [P]"""
    seconds: float = Field(default=150.0, gt=0.0, le=10_000.0)
    """Time limit for a crossing [s]. [P]"""
    n_trials: int = Field(default=8, ge=1, le=1000)
    """Trials of each robot in the filled tank, and as many in the drained one with either torque. [P]: 8 and 6."""
    immobile: float = Field(default=0.05, ge=0.0, le=100.0)
    """Travel up to which a robot counts as immobile [m], as built. [P]: "a few centimeters"."""
    pontoon_pitch: float = Field(default=0.3, gt=0.0, le=10.0)
    """Distance from one pontoon of the robot to the other [m]. [P]"""
    pontoon_thickness: float = Field(default=0.025, gt=0.0, le=10.0)
    """Thickness of each pontoon [m]. [P]"""
    robot_density: float = Field(default=800.0, gt=0.0, le=20_000.0)
    """Mean density of the built robot, from which its mass follows [kg/m³]. The ratio to a fluid as dense as water is
    then that of a link to the slush, 1 to 1.25, and the robot floats as it does in the simulation."""
    servo_torque: float = Field(default=1.96, ge=0.0, le=1000.0)
    """Torque of the servo of a joint [N·m]. [P]: 20 kg·cm."""

    @model_validator(mode="after")
    def _walls_hold_the_filling(self) -> Self:
        if self.depth > self.height:
            raise ValueError(
                f"depth is {self.depth:g} m and height {self.height:g} m, and the filling overflows: "
                "expected a height of at least the depth"
            )
        return self

    @property
    def simulated_length(self) -> float:
        """Length in the simulation [m]."""
        return self.length / self.scale

    @property
    def simulated_depth(self) -> float:
        """Depth in the simulation [m]."""
        return self.depth / self.scale

    @property
    def robot_width(self) -> float:
        """Width of every robot, across both pontoons [m], as built."""
        return self.pontoon_pitch + self.pontoon_thickness

    def simulated_servo_torque(self, link_density: float) -> float:
        """Return the servo's torque at the scale of the simulation [N·m], for links of a density [kg/m²].

        Torques scale as weight times length, under the same gravity; see tasks/bench/fabrication/scaling.py.
        """
        mass_of_a_link = self.robot_density * self.scale**2 * 2 * self.pontoon_thickness  # of 1 m² when simulated [kg]
        return self.servo_torque * link_density / (mass_of_a_link * self.scale)

    def n_steps(self, time_step: float) -> int:
        """Return the time limit in steps of time_step [s]."""
        return max(1, round(self.seconds / froude_time(self.scale) / time_step))


class Crossings(NamedTuple):
    """How n_robots fared in the tank, in simulated metres; NaN where a robot diverged."""

    length: Float64  # (n_robots,) length of the settled robot along the tank [m]
    travelled: Float64  # (n_robots,) by its centre of mass until it crossed or time ran out [m]
    crossed: Bools  # (n_robots,) whether it crossed in time; False for a robot as long as the tank or wider


@dataclass(frozen=True)
class TankTrials:
    """How often one robot crossed."""

    n: int  # trials
    n_crossed: int  # in the time limit
    n_immobile: int  # trials that ended at most ``Tank.immobile`` from where they began


def restarted(design: Designs, n: int, rng: Generator) -> Designs:
    """Return a robot n times, to be tried again: first as it is, then begun at random moments of its gait.

    Every attachment is also moved up or down, or inwards at a gene's bound.
    """
    jitters = (jittered(design, rng, _JITTER) for _ in range(n - 1))
    return Designs.concatenate([design, *(begun_later(again, rng.uniform(0.0, TURN)) for again in jitters)])


def count_crossings(trials: Crossings, tank: Tank) -> TankTrials:
    """Count the trials of one robot that crossed in time, and those that went nowhere."""
    immobile = tank.scale * np.abs(trials.travelled) <= tank.immobile
    return TankTrials(len(immobile), int(trials.crossed.sum()), int(immobile.sum()))


def crossings(designs: Designs, rollouts: Rollouts, tank: Tank, *, n_settle: int) -> Crossings:
    """Return how each of n_designs robots crosses the tank.

    A settled robot starts with its rear at one end. It has crossed when its centre of mass has travelled the tank's
    length minus the robot's own. The front would be a poor criterion: a swinging link reaches metres ahead of a robot
    that stays in place. A robot that is wider than the tank does not cross it.

    Args:
        designs: n_designs designs.
        rollouts: their rollouts of ``n_settle`` + ``tank.n_steps(...)`` steps, with traces, without an ensemble.
        tank: the tank.
        n_settle: steps before the motors start, at least 1, because a trace starts after the first step.
    """
    assert rollouts.trace is not None and n_settle > 0
    trace = rollouts.trace[:, n_settle - 1 :].astype(np.float64)
    cos, sin = np.abs(np.cos(trace[:, 0, :, 2])), np.abs(np.sin(trace[:, 0, :, 2]))
    half, middle = (sin * designs.length_scale + cos / designs.length_scale) / 2, trace[:, 0, :, 0]
    length = (middle + half).max(axis=1) - (middle - half).min(axis=1)
    centre = trace[..., 0].mean(axis=2)  # every link has the same mass
    travelled, distance = centre - centre[:, :1], tank.simulated_length - length
    passes = (distance > 0) & (tank.robot_width <= tank.width)
    beyond = passes[:, None] & (travelled >= distance[:, None])
    crossed = beyond.any(axis=1)
    last = np.where(crossed, beyond.argmax(axis=1), travelled.shape[1] - 1)
    return Crossings(length, travelled[np.arange(len(last)), last], crossed)


def nearest_the_mean(scores: Float64) -> int | None:
    """Return the index of the score nearest the mean of (n_champions,) scores [m]: the champion that the paper builds.

    The first among equals is chosen; None is returned if no score is finite.
    """
    known = np.isfinite(scores)
    if not known.any():
        return None
    return int(np.argmin(np.where(known, np.abs(scores - scores[known].mean()), np.inf)))
