from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from tasks.design import random_designs
from tasks.simulation import simulate
from tasks.world import LinkStates, Physics, ResidualSlush, Slush, TrueSlush, VelocityChange


@dataclass(frozen=True)
class Planted:
    """An ensemble that knows the slush, but for one member, which adds a thrust to +x to long links in the slush."""

    n_members: int = 4
    thrust: float = 3.0
    """[m/s²]"""

    def velocity_change(self, links: LinkStates, physics: Physics) -> VelocityChange:
        true = Slush().velocity_change(links, physics)
        liar = np.arange(self.n_members).reshape(-1, *[1] * (links.y.ndim - 1)) == 2
        lies = liar & (links.length_scale > 2.5) & (links.y < 0)
        false = np.where(lies, self.thrust * physics.time_step, 0).astype(links.y.dtype)
        return VelocityChange(vx=true.vx + false, vy=true.vy, omega=true.omega)


@pytest.fixture(scope="session")
def study():
    """Designs, of which number 3 alone has long links, in the planted ensemble and in True Slush, with their traces."""
    designs = random_designs(6, np.random.default_rng(0))
    length_scale = np.clip(designs.length_scale, 1.0, 2.0)
    length_scale[3, :3] = 2.9
    designs = replace(designs, length_scale=length_scale)
    planted, steps = Planted(), {"n_settle": 50, "n_measure": 200, "engine": "reference"}
    in_slush = simulate(designs, TrueSlush(depth=9.0), trace=True, **steps)
    predicted = simulate(designs, ResidualSlush(depth=9.0, ensemble=planted), **steps).displacement
    found = {"predicted": predicted, "true": in_slush.displacement, "trace": in_slush.trace}
    return SimpleNamespace(designs=designs, planted=planted, **found)
