"""The virtual tank: would the robot that is built cross it? Paper, "Manufacturing" and "Physical Validation".

The paper put its robot at one end of a tank of gel beads and water, and waited until it reached the other end or 150 s
had passed; then it drained the tank and did the same on the dry floor. Here the tank is measured in the robot's own
scale, so that the robot stays as it was simulated: its metres by the scale of lengths, its seconds by Froude's law.
150 s beside a tank are 567 s of simulation at 70 mm per metre.

The paper tells the scale of lengths and not that of times, and compares whether a robot crosses, not how fast. Froude's
law is ours, as it is the kit's default (tasks/fabrication/scaling.py): under the same gravity it alone keeps weight,
buoyancy, drag and inertia in proportion, so that what the simulation does is a prediction of what the tank will show.
Under any other law a time in the simulation says nothing of one beside the tank.

The tank has no walls: what a robot does when it meets them is not asked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from tasks.arrays import Float64
from tasks.design import Designs
from tasks.parameters import Parameters
from tasks.simulation import Rollouts
from tasks.world import froude_time


class Tank(Parameters):
    """The tank and how the robot is scaled to it; the paper's by default."""

    length: float = Field(default=1.17, gt=0.0, le=100.0)
    """Of the tank, inside [m]. [P]"""
    depth: float = Field(default=0.15, ge=0.0, le=100.0)
    """Of what fills it [m]. [P]"""
    scale: float = Field(default=0.07, gt=0.0, le=10.0)
    """Metres that are built for a metre of simulation. [P]"""
    seconds: float = Field(default=150.0, gt=0.0, le=10_000.0)
    """How long a robot is given, by a clock beside the tank [s]. [P]"""

    @property
    def simulated_length(self) -> float:
        """Length in the simulation [m]."""
        return self.length / self.scale

    @property
    def simulated_depth(self) -> float:
        """Depth in the simulation [m]."""
        return self.depth / self.scale

    @property
    def simulated_seconds(self) -> float:
        """How long a robot is given in the simulation [s]."""
        return self.seconds / froude_time(self.scale)

    def n_steps(self, time_step: float) -> int:
        """Count the steps that a robot is given."""
        return max(1, round(self.simulated_seconds / time_step))

    def built_seconds(self, simulated: float) -> float:
        """Turn seconds of simulation into seconds beside the tank."""
        return simulated * froude_time(self.scale)

    def built_speed(self, simulated: float) -> float:
        """Turn a speed in the simulation into one in the tank [m/s]."""
        return simulated * self.scale / froude_time(self.scale)


@dataclass(frozen=True)
class Crossing:
    """How one robot fared in the tank, in the simulation's metres and seconds."""

    length: float
    """From end to end of the robot, along the tank, once it has settled [m]; NaN where it diverged."""
    distance: float
    """Its centre of mass has to travel to have crossed [m]; 0 or less if the robot is as long as the tank."""
    travelled: float
    """Of its centre of mass along the tank: until it had crossed, or in all the time it had [m]."""
    crossed: bool
    """Whether it got across in time; a robot as long as the tank does not."""
    seconds: float
    """Until it had crossed [s of simulation]; NaN if it did not."""
    speed: float
    """``travelled`` over the time that it took [m/s]."""


def crossings(designs: Designs, rollouts: Rollouts, tank: Tank, *, n_settle: int, time_step: float) -> list[Crossing]:
    """Say which robots cross the tank.

    A settled robot is put with its rear against one end. It has crossed when its centre of mass has travelled as far as
    its front then was from the other end, the tank's length less the robot's own. The front itself would be a poor
    judge: a link that swings reaches metres ahead of a robot that goes nowhere.

    Args:
        designs: n_designs designs.
        rollouts: theirs, of ``n_settle`` + ``tank.n_steps(time_step)`` steps with their trace, in a single world.
        tank: the tank.
        n_settle: steps before the robot is let go, 1 or more: a trace begins after the first.
        time_step: [s]

    Returns:
        n_designs crossings.
    """
    if n_settle < 1:
        raise ValueError(f"n_settle is {n_settle}, expected 1 or more: the trace lacks the state before the first step")
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
    """Find where (n_steps + 1,) distances, 0 at first, reach one [m]."""
    there = np.flatnonzero(travelled >= distance) if distance > 0 else np.array([], dtype=np.int64)
    last = int(there[0]) if there.size else len(travelled) - 1
    time = last * time_step
    return Crossing(
        length=length,
        distance=distance,
        travelled=float(travelled[last]),
        crossed=bool(there.size),
        seconds=time if there.size else np.nan,
        speed=float(travelled[last]) / max(time, time_step),
    )


def nearest_the_mean(scores: Float64) -> int | None:
    """Choose the champion that the paper builds: the one whose score is nearest the champions' mean; the first of two.

    Args:
        scores: (n_champions,) displacement in True Slush [m]; NaN where diverged.

    Returns:
        Its index; None if no score is finite.
    """
    known = np.isfinite(scores)
    if not known.any():
        return None
    return int(np.argmin(np.where(known, np.abs(scores - scores[known].mean()), np.inf)))
