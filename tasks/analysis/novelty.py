"""Novelty: the distance of a state from the thrown states. Far away, members may agree and still be wrong.

The space consists of a network's observations of a link's motion: y, cos θ, vx, vy, ω. Velocities enter as
asinh(v / v₀), which is linear below v₀ and logarithmic above, because 0.5 m/s matters to a floating link and not to a
falling one. Each component is divided by its deviation over the throws.

- No mirror images are added. Slush is symmetric in x, but the networks do not know that: what they know of ω < 0 comes
  from throws with ω < 0.
- A link's length is left out. Throws have three lengths, robots any between. That gap, the same in every step, made up
  80 % of most links' distance and hid changes.

The unit of novelty is the usual distance: the median distance of the states of held-back throws from the other throws.
A link at 5 is five times as far from the training data as fresh throws are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from tasks.arrays import Float64, Floats
from tasks.residual import OBSERVATION, observe
from tasks.world import LinkStates

SPACE = ("y", "cos_angle", "vx", "vy", "omega")  # components of OBSERVATION that span the space
_COLUMNS = [OBSERVATION.index(name) for name in SPACE]
_VELOCITIES = slice(SPACE.index("vx"), None)
_LOW_VELOCITY = 0.5  # v₀ [m/s, rad/s]: end of the lowest speed band, in which swimmers spend most of their time
_FRESH_EVERY = 10  # every tenth throw is held back to measure the usual distance
_MIN_SCALE = 1e-6  # lower bound of a component's deviation, for components that do not vary over the throws


@dataclass(frozen=True, eq=False)
class Thrown:
    """An index of the thrown states."""

    tree: scipy.spatial.cKDTree  # points of the states in the scaled space
    scale: Float64  # (5,) deviation of each component
    usual: float  # usual distance; NaN where all states come from one throw, or throws repeat each other


def _points(observation: Floats) -> Float64:
    """Map (n_rows, 6) observations to (n_rows, 5) points of the space before scaling."""
    rows = np.asarray(observation, dtype=np.float64)[:, _COLUMNS]
    rows[:, _VELOCITIES] = np.arcsinh(rows[:, _VELOCITIES] / _LOW_VELOCITY)
    return rows


def thrown(observation: Floats, throw: npt.ArrayLike) -> Thrown:
    """Index (n_transitions, 6) finite observations, in the order of OBSERVATION, of (n_transitions,) throws.

    Raises:
        ValueError: the observations have another shape, or there are none.
    """
    if observation.ndim != 2 or observation.shape[1] != len(OBSERVATION) or len(observation) == 0:
        raise ValueError(f"observation has shape {observation.shape}, expected (at least 1, {len(OBSERVATION)})")
    points = _points(observation)
    scale = np.maximum(points.std(axis=0), _MIN_SCALE)
    points = points / scale
    which = np.asarray(throw)
    fresh = np.isin(which, np.unique(which)[::_FRESH_EVERY])
    usual = np.nan
    if not fresh.all():
        distance, _ = scipy.spatial.cKDTree(points[~fresh]).query(points[fresh])
        usual = float(np.median(distance)) or np.nan
    return Thrown(scipy.spatial.cKDTree(points), scale, usual)


def novelty(links: LinkStates, throws: Thrown) -> Float64:
    """Return the distance of links of shape (...) from the throws, in usual distances; NaN where it is unknown."""
    rows = observe(vars(links))
    points = _points(rows.reshape(-1, len(OBSERVATION))) / throws.scale
    known = np.isfinite(points).all(axis=1)
    distance = np.full(len(points), np.nan)
    if known.any():
        distance[known], _ = throws.tree.query(points[known])
    return (distance / throws.usual).reshape(rows.shape[:-1])
