"""How far a state is from every state that was thrown: where members may agree and still know nothing.

The space is that of what a network reads of a link's motion: y, cos θ, vx, vy, ω. Velocities are taken as
asinh(v / v₀), linear below v₀ and logarithmic above, because drag is: half a metre per second is everything to a
floating link and nothing to a falling one. Then each component is divided by its deviation over the throws.

- No mirror images are added: slush is the same to the left and to the right, but the networks are not told so, and
  know of ω < 0 only what was thrown with ω < 0.
- A link's length is left out. Throws have three lengths and robots any between; the same gap in every step made up 80 %
  of the distance of most links, and hid what changes.

A distance becomes a figure by what is usual: 1 is the median over the states of fresh throws of the distance to the
other throws. A link at 5 is five times as far from what the members were trained on as what they were tested on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from tasks.arrays import Float64, Floats
from tasks.residual import OBSERVATION, observe
from tasks.world import LinkStates

SPACE = ("y", "cos_angle", "vx", "vy", "omega")
"""Components of OBSERVATION that make up the space."""
_COLUMNS = [OBSERVATION.index(name) for name in SPACE]
_VELOCITIES = slice(SPACE.index("vx"), None)
LOW_VELOCITY = 0.5
"""v₀ [m/s, rad/s]: the lowest band of speeds of the error report, in which swimmers mostly live."""
FRESH_ONE_IN = 10
"""One throw in this many is taken out to see how far fresh throws are from the others."""
MIN_SCALE = 1e-6
"""Stands in for the deviation of a component that never varies: any change of it is far away."""


@dataclass(frozen=True, eq=False)
class Thrown:
    """The states of the throws, to look for the nearest of."""

    tree: cKDTree
    """Of their places in the space."""
    scale: Float64
    """(5,) deviation of each component."""
    usual: float | None
    """Distance that counts as 1; None where the reason says why."""
    reason: str | None


@dataclass(frozen=True, eq=False)
class Novelty:
    """Distances of links from the throws, of the links' shape; NaN where a state is not finite."""

    distance: Float64
    """(...) to the nearest, in deviations of the throws."""
    novelty: Float64
    """(...) the same over the usual distance; NaN where that is unknown (see Thrown.reason)."""
    component: npt.NDArray[np.int64]
    """(...) of SPACE, the one that contributes most to the distance; -1 where there is none."""


def _places(observation: Floats) -> Float64:
    """Map (n_rows, 6) observations to the (n_rows, 5) space, before it is scaled."""
    rows = np.asarray(observation, dtype=np.float64)[:, _COLUMNS]
    rows[:, _VELOCITIES] = np.arcsinh(rows[:, _VELOCITIES] / LOW_VELOCITY)
    return rows


def thrown(observation: Floats, throw: npt.ArrayLike) -> Thrown:
    """Index the data set, or the part of it that the members were trained on.

    Args:
        observation: (n_transitions, 6) in the order of OBSERVATION; finite.
        throw: (n_transitions,) which throw each comes from.
    """
    if observation.ndim != 2 or observation.shape[1] != len(OBSERVATION) or len(observation) == 0:
        raise ValueError(f"observation has shape {observation.shape}, expected (1 or more, {len(OBSERVATION)})")
    places = _places(observation)
    scale = np.maximum(places.std(axis=0), MIN_SCALE)
    places = places / scale
    which = np.asarray(throw)
    fresh = np.isin(which, np.unique(which)[::FRESH_ONE_IN])
    usual, reason = None, None
    if fresh.all():
        reason = "all states are of one throw: there is no telling how far fresh throws are"
    else:
        distance, _ = cKDTree(places[~fresh]).query(places[fresh])
        usual = float(np.median(distance))
        if usual == 0:
            usual, reason = None, "throws repeat each other exactly: there is no telling how far fresh throws are"
    return Thrown(cKDTree(places), scale, usual, reason)


def novelty(links: LinkStates, throws: Thrown) -> Novelty:
    """Measure how far links of any one shape are from the throws; some 10,000 states a second."""
    rows = observe(
        length_scale=links.length_scale, y=links.y, cos=links.cos, vx=links.vx, vy=links.vy, omega=links.omega
    )
    shape = rows.shape[:-1]
    places = _places(rows.reshape(-1, len(OBSERVATION))) / throws.scale
    known = np.isfinite(places).all(axis=1)
    distance = np.full(len(places), np.nan)
    component = np.full(len(places), -1)
    if known.any():
        distance[known], nearest = throws.tree.query(places[known])
        component[known] = np.abs(places[known] - throws.tree.data[nearest]).argmax(axis=1)
    usual = np.nan if throws.usual is None else throws.usual
    return Novelty(distance.reshape(shape), (distance / usual).reshape(shape), component.reshape(shape))
