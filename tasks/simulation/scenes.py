"""What is seen of a medium along a recorded rollout, and the links there as media see them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tasks.arrays import Floats
from tasks.design import Designs, kinematic_trees
from tasks.world import Environment, LinkStates, Physics
from tasks.world.medium import Scene


def links_along(designs: Designs, trace: Floats, physics: Physics) -> LinkStates:
    """Return the links of n_designs designs along their (n_designs, n_steps, n_links, 6) trace, in its shape."""
    trees = kinematic_trees(designs, density=physics.link_density)
    bodies = (array.astype(trace.dtype)[:, None] for array in (designs.length_scale, trees.mass, trees.inertia))
    x, y, angle, vx, vy, omega = np.moveaxis(trace, -1, 0)
    states = (*bodies, y, np.cos(angle), np.sin(angle), vx, vy, omega, x)
    return LinkStates(*(np.broadcast_to(array, y.shape) for array in states))


def scenes_along(design: Designs, trace: Floats, environment: Environment, physics: Physics) -> Sequence[Scene]:
    """Return what is seen of the medium of one design after each step but the first; none if it has nothing to show.

    A medium with memory goes through the rollout once more, on the (n_steps, n_links, 6) trace.
    """
    medium: Any = environment.medium
    if not hasattr(medium, "scenes"):
        return []
    links = vars(links_along(design, trace[None], physics))
    states = [LinkStates(**{name: array[0, step] for name, array in links.items()}) for step in range(len(trace) - 1)]
    return list(medium.scenes(states, physics, environment.depth))
