"""The states that robots pass through, estimated without the true world.

A robot's links have lengths within the bounds of the genes, and its motors decide how fast they move, mostly whatever
the medium. So random designs in the base simulator show the range of speeds: at the surface, where a fall adds little,
and after settling. Heights matter where the medium changes with height, at its surface, and a link touches the surface
only while its centre is closer to it than half its length: twice that is within the reach of a link.

A throw is worth following while it stays within these ranges. Without any medium, gravity alone takes a link from rest
to the greatest speed within max_speed / g, and that many steps are followed.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from tasks.design import GENES, random_designs
from tasks.seeding import generator
from tasks.simulation import simulate
from tasks.world import DryLand, Physics

_MOST_STEPS = 200  # where there is no gravity: those of the paper's throws
N_PILOTS = 256  # random designs whose links are observed
QUANTILE = 0.999  # share of their states within the greatest speeds
_QUANTILE_OF_KICKS = 0.99  # hard impacts are rare in water
_N_SETTLE = 200  # steps before states are observed, in which robots drop to the ground


@dataclass(frozen=True)
class RobotRanges:
    """The ranges of the states of a robot's links."""

    length_scale: tuple[float, float]  # least and greatest long axis [m]
    y_reach: float  # y lies within ± this [m]
    max_velocity: float  # vx and vy lie within ± this [m/s]
    max_omega: float  # ω lies within ± this [rad/s]
    n_steps: int  # steps that a throw is worth following
    max_kick: float  # what joints, motors and contacts change of vx in a step lies mostly within ± this [m/s]
    max_kick_omega: float  # the same of ω [rad/s]


@cache
def robot_ranges(physics: Physics) -> RobotRanges:
    """Estimate the ranges from the bounds of genes and from random designs in the base simulator.

    The designs are the same in every study, so the ranges depend on the base simulator alone. Many have links that
    overlap; if links collide, these would burst apart, which no robot that evolves does. So they do not collide here.
    """
    pilots = random_designs(N_PILOTS, generator(0, "robot ranges"))
    without_collisions = physics.model_copy(update={"link_collisions": False})
    rollouts = simulate(pilots, DryLand(depth=0.0), n_settle=_N_SETTLE, trace=True, physics=without_collisions)
    assert rollouts.trace is not None
    _, _, _, vx, vy, omega = np.moveaxis(rollouts.trace[:, _N_SETTLE:].astype(np.float64), -1, 0)
    speed, spin = np.hypot(vx, vy), np.abs(omega)
    max_velocity, max_omega = (float(np.quantile(values[np.isfinite(values)], QUANTILE)) for values in (speed, spin))
    kicks = (np.abs(np.diff(values, axis=1)) for values in (vx, omega))
    max_kick, max_kick_omega = (float(np.quantile(of[np.isfinite(of)], _QUANTILE_OF_KICKS)) for of in kicks)
    length = next(gene for gene in GENES if gene.name == "length_scale")
    gained = physics.gravity * physics.time_step  # by gravity in one step [m/s]
    n_steps = _MOST_STEPS if gained * _MOST_STEPS <= max_velocity else max(round(max_velocity / gained), 1)
    return RobotRanges(
        length_scale=(length.low, length.high),
        y_reach=length.high,
        max_velocity=round(max_velocity, 2),
        max_omega=round(max_omega, 2),
        n_steps=n_steps,
        max_kick=round(max_kick, 2),
        max_kick_omega=round(max_kick_omega, 2),
    )
