from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.world import LinkStates, Physics, ResidualSlush, Slush, TrueSlush, VelocityChange


def long_and_sunken(links: LinkStates):
    """Tell whether a link is a long one whose centre is in the slush: a corner of the networks' own space."""
    return (links.length_scale > 2.5) & (links.y < 0)


@dataclass(frozen=True)
class Planted:
    """An ensemble that knows the slush, but for one member that adds a thrust to +x in one region of state space."""

    liar: int = 2
    n_members: int = 4
    thrust: float = 3.0
    """[m/s²]"""
    lies: Callable[[LinkStates], np.ndarray] = field(default=long_and_sunken)

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        true = Slush().velocity_change(links, physics)
        liar = np.arange(self.n_members).reshape(-1, *[1] * (links.y.ndim - 1)) == self.liar
        false = np.where(liar & self.lies(links), self.thrust * physics.time_step, 0).astype(links.y.dtype)
        return VelocityChange(vx=true.vx + false, vy=true.vy, omega=true.omega)


@dataclass(frozen=True)
class Study:
    """Designs in the planted ensemble and in True Slush."""

    designs: object
    planted: Planted
    predicted: np.ndarray
    """(n_members, n_designs) [m]"""
    true: np.ndarray
    """(n_designs,) [m]"""
    trace: np.ndarray
    """(n_designs, n_steps, n_links, 6) in True Slush."""


EXPLOITER = 3
"""The one design with long links; the ensemble's thrust is for it alone."""


@pytest.fixture(scope="session")
def study():
    designs = random_designs(6, np.random.default_rng(0))
    length_scale = np.clip(designs.length_scale, 1.0, 2.0)
    length_scale[EXPLOITER, :3] = 2.9
    designs = replace(designs, length_scale=length_scale)
    planted, steps = Planted(), {"n_settle": 50, "n_measure": 200, "engine": "reference"}
    in_slush = simulate(designs, TrueSlush(depth=9.0), trace=True, **steps)
    hallucinated = simulate(designs, ResidualSlush(depth=9.0, ensemble=planted), **steps)
    return Study(designs, planted, hallucinated.displacement, in_slush.displacement, in_slush.trace)
