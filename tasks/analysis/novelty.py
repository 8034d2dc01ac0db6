"""How far a state is from every state that was thrown: where members may agree and still know nothing.

Distances are taken in the networks' own space: the observation (a, y, cos θ, vx, vy, ω), each component divided by its
deviation over the throws, as the networks read it. No mirror images are added: slush is the same to the left and to
the right, but the networks are not told so, and know of ω < 0 only what was thrown with ω < 0.

A distance becomes a figure by what is usual: 1 is the distance within which 95 % of the states of fresh throws have a
state of other throws. Above 1, a link is where the throws have not been.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from tasks.analysis.uncertainty import Float64, Floats
from tasks.residual import OBSERVATION, observe
from tasks.world import LinkStates

FRESH_ONE_IN = 10
"""One throw in this many is taken out to see how far fresh throws are from the others."""
USUAL = 0.95
"""Share of the states of fresh throws that lie within one usual distance."""
MIN_SCALE = 1e-6
"""Stands in for the deviation of a component that never varies: any change of it is far away."""


@dataclass(frozen=True, eq=False)
class Thrown:
    """The states of the throws, to look for the nearest of."""

    tree: cKDTree
    """Of the standardised observations."""
    scale: Float64
    """(6,) deviation of each component."""
    usual: float | None
    """Standardised distance that counts as 1; None where the reason says why."""
    reason: str | None


@dataclass(frozen=True, eq=False)
class Novelty:
    """Distances of links from the throws, of the links' shape; NaN where a state is not finite."""

    distance: Float64
    """(...) to the nearest, in deviations of the throws."""
    novelty: Float64
    """(...) the same over the usual distance; NaN where that is unknown (see Thrown.reason)."""
    component: npt.NDArray[np.int64]
    """(...) of OBSERVATION, the one that contributes most to the distance; -1 where there is none."""


def thrown(observation: Floats, throw: npt.ArrayLike) -> Thrown:
    """Index the data set, or the part of it that the members were trained on.

    Args:
        observation: (n_transitions, 6) in the order of OBSERVATION; finite.
        throw: (n_transitions,) which throw each comes from.
    """
    rows = np.asarray(observation, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != len(OBSERVATION) or len(rows) == 0:
        raise ValueError(f"observation has shape {rows.shape}, expected (1 or more, {len(OBSERVATION)})")
    scale = np.maximum(rows.std(axis=0), MIN_SCALE)
    standard = rows / scale
    which = np.asarray(throw)
    fresh = np.isin(which, np.unique(which)[::FRESH_ONE_IN])
    usual, reason = None, None
    if fresh.all():
        reason = "all states are of one throw: there is no telling how far fresh throws are"
    else:
        distance, _ = cKDTree(standard[~fresh]).query(standard[fresh])
        usual = float(np.quantile(distance, USUAL))
        if usual == 0:
            usual, reason = None, "throws repeat each other exactly: there is no telling how far fresh throws are"
    return Thrown(cKDTree(standard), scale, usual, reason)


def novelty(links: LinkStates, throws: Thrown) -> Novelty:
    """Measure how far links of any one shape are from the throws."""
    rows = observe(
        length_scale=links.length_scale, y=links.y, cos=links.cos, vx=links.vx, vy=links.vy, omega=links.omega
    )
    shape = rows.shape[:-1]
    flat = rows.reshape(-1, len(OBSERVATION)).astype(np.float64) / throws.scale
    known = np.isfinite(flat).all(axis=1)
    distance = np.full(len(flat), np.nan)
    component = np.full(len(flat), -1)
    if known.any():
        distance[known], nearest = throws.tree.query(flat[known])
        component[known] = np.abs(flat[known] - throws.tree.data[nearest]).argmax(axis=1)
    usual = np.nan if throws.usual is None else throws.usual
    return Novelty(distance.reshape(shape), (distance / usual).reshape(shape), component.reshape(shape))
