"""The virtual tank: whether a robot, once built, would cross it. Paper, "Manufacturing" and "Physical Validation".

The paper put its robot at one end of a tank of gel beads and water and waited until it reached the other end or 150 s
had passed. It then drained the tank and repeated the test on the dry floor. Here the tank is scaled to the simulated
robot: lengths by the scale of the build, times by Froude's law. At 70 mm per metre, 150 s are 567 s of simulation.

The paper states the scale of lengths but not of times, and compares whether a robot crosses, not how fast. Froude's law
is our choice, and the kit's default (tasks/fabrication/scaling.py). Under the same gravity it is the only law that
keeps weight, buoyancy, drag and inertia in proportion, so only under it does the simulation predict times in the tank.
The speed of the paper's servos suggests that it kept the simulation's frequencies instead: then a simulated second is
one second in the tank, and the same robot has 150 s of the simulation and not 567 s.

The paper repeats each test, 8 times in slush and 6 times on the dry floor. A simulation repeats itself exactly, so each
further trial here starts at another moment of the gait, with its joints shifted by less than printing can hold.

The tank has no walls.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from pydantic import Field

from tasks.analysis.luck import jittered
from tasks.arrays import Float64
from tasks.design import Designs, concatenate
from tasks.parameters import Parameters
from tasks.simulation import Rollouts
from tasks.world import froude_time


class Tank(Parameters):
    """The tank and the robot's scale; the paper's by default."""

    length: float = Field(default=1.17, gt=0.0, le=100.0)
    """Inner length of the tank [m]. [P]"""
    depth: float = Field(default=0.15, ge=0.0, le=100.0)
    """Depth of its filling [m]. [P]"""
    scale: float = Field(default=0.07, gt=0.0, le=10.0)
    """Built length of one simulated metre [m]. [P]"""
    seconds: float = Field(default=150.0, gt=0.0, le=10_000.0)
    """Time limit for a crossing [s]. [P]"""
    n_trials: int = Field(default=8, ge=1, le=1000)
    """Trials of each robot in the filled tank, and as many in the drained one. [P]: 8 and 6."""

    @property
    def simulated_length(self) -> float:
        """Length in the simulation [m]."""
        return self.length / self.scale

    @property
    def simulated_depth(self) -> float:
        """Depth in the simulation [m]."""
        return self.depth / self.scale

    def n_steps(self, time_step: float) -> int:
        """Return the time limit in steps of time_step [s]."""
        return max(1, round(self.seconds / froude_time(self.scale) / time_step))

    def built_seconds(self, simulated: float) -> float:
        """Convert a simulated time to one of the built robot [s]."""
        return simulated * froude_time(self.scale)

    def built_speed(self, simulated: float) -> float:
        """Convert a simulated speed to one of the built robot [m/s]."""
        return simulated * self.scale / froude_time(self.scale)


@dataclass(frozen=True)
class Crossing:
    """Result of one robot in the tank, in simulated metres and seconds."""

    length: float  # length of the settled robot along the tank [m]; NaN where it diverged
    distance: float  # distance that its centre of mass must travel [m]; at most 0 if the robot is as long as the tank
    travelled: float  # distance that its centre of mass travelled until it crossed or time ran out [m]
    crossed: bool  # whether it crossed in time; False for a robot as long as the tank
    seconds: float  # simulated time until it crossed [s]; NaN if it did not
    speed: float  # mean speed over ``travelled`` [m/s]


@dataclass(frozen=True)
class TankTrials:
    """How often one robot crossed."""

    n: int  # trials
    n_crossed: int  # in the time limit, by Froude's law
    n_crossed_at_kept_frequencies: int  # in the time limit, if the simulation's frequencies are kept


def restarted(design: Designs, n: int, rng: Generator) -> Designs:
    """Return a robot n times, to be tried again: first as it is, then begun at random moments of its gait.

    Joints are also shifted by 1e-4 of half a link, as in :func:`tasks.analysis.luck.jittered`.

    Args:
        design: a single design.
        n: number of trials, at least 1.
        rng: source of randomness.
    """
    begun = [
        replace(again, phase=(again.phase + rng.uniform(0.0, 2 * np.pi)) % (2 * np.pi))
        for again in (jittered(design, rng) for _ in range(n - 1))
    ]
    return concatenate([design, *begun])


def count_crossings(trials: Sequence[Crossing], tank: Tank) -> TankTrials:
    """Count the trials of one robot that crossed in time, by either law of scaling."""
    # At kept frequencies the tank's limit is as many simulated seconds. A trial that did not cross has NaN seconds.
    in_time = [trial.crossed and trial.seconds <= tank.seconds for trial in trials]
    return TankTrials(len(trials), sum(trial.crossed for trial in trials), sum(in_time))


def crossings(designs: Designs, rollouts: Rollouts, tank: Tank, *, n_settle: int, time_step: float) -> list[Crossing]:
    """Return how each of n_designs robots crosses the tank.

    A settled robot starts with its rear at one end. It has crossed when its centre of mass has travelled the tank's
    length minus the robot's own. The front would be a poor criterion: a swinging link reaches metres ahead of a robot
    that stays in place.

    Args:
        designs: n_designs designs.
        rollouts: their rollouts of ``n_settle`` + ``tank.n_steps(time_step)`` steps, with traces, without an ensemble.
        tank: the tank.
        n_settle: steps before the motors start, at least 1, because a trace starts after the first step.
        time_step: length of a step [s].

    Raises:
        ValueError: n_settle is 0, or the trace is missing or of another shape.
    """
    if n_settle < 1:
        raise ValueError(f"n_settle is {n_settle}, expected at least 1: traces lack the initial state")
    if rollouts.trace is None:
        raise ValueError("the rollouts have no trace, expected one")
    n_expected = n_settle + tank.n_steps(time_step)
    if rollouts.trace.shape[:2] != (len(designs), n_expected):
        raise ValueError(f"the trace has shape {rollouts.trace.shape}, expected ({len(designs)}, {n_expected}, ...)")
    trace = rollouts.trace[:, n_settle - 1 :].astype(np.float64)
    x, angle = trace[..., 0], trace[:, 0, :, 2]
    half = (np.abs(np.sin(angle)) * designs.length_scale + np.abs(np.cos(angle)) / designs.length_scale) / 2
    length = (x[:, 0] + half).max(axis=1) - (x[:, 0] - half).min(axis=1)
    centre = x.mean(axis=2)  # every link has the same mass
    return [
        _crossing(float(own), along - along[0], tank.simulated_length - float(own), time_step)
        for own, along in zip(length, centre, strict=True)
    ]


def _crossing(length: float, travelled: Float64, distance: float, time_step: float) -> Crossing:
    """Find when (n_steps + 1,) distances travelled, 0 at first, reach the distance to travel [m]."""
    reached = np.flatnonzero(travelled >= distance) if distance > 0 else np.array([], dtype=np.int64)
    last = int(reached[0]) if reached.size else len(travelled) - 1
    time = last * time_step
    return Crossing(
        length=length,
        distance=distance,
        travelled=float(travelled[last]),
        crossed=bool(reached.size),
        seconds=time if reached.size else np.nan,
        speed=float(travelled[last]) / max(time, time_step),
    )


def nearest_the_mean(scores: Float64) -> int | None:
    """Return the index of the score nearest the mean of (n_champions,) scores [m]: the champion that the paper builds.

    The first among equals is chosen; None is returned if no score is finite.
    """
    known = np.isfinite(scores)
    if not known.any():
        return None
    return int(np.argmin(np.where(known, np.abs(scores - scores[known].mean()), np.inf)))
