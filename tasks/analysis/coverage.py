"""Coverage: how much of what robots do lies within the throws that networks learned from.

A state of a link is compared with the nearest state of the throws, in the space of the paper's observation
(a, y, cos θ, vx, vy, ω). Each component is divided by its deviation over the states of robots, so that a distance of 1
is as far as such states typically are from their mean. A state is outside the throws if its distance is above 1: there
the networks extrapolate, all in the same way, and their disagreement may not show it. Each state outside is counted for
the component that separates it most from its nearest neighbour, so that a hole in the data is found by name.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.random import Generator

from tasks.arrays import Float32, Float64, Floats
from tasks.design import Designs
from tasks.residual import OBSERVATION, observe
from tasks.simulation.rollout import Rollouts

_MOST_STATES = 10_000  # states that are compared; shares are then known to half a percent
_EVERY = 20  # steps between two states of a robot that are compared
_LEAST_DEVIATION = 1e-6  # of a component that does not vary
EVERYTHING = "all"


@dataclass(frozen=True)
class CoverageRow:
    """How far the states of robots are from the throws, in all or because of one component."""

    component: str  # of OBSERVATION, or EVERYTHING
    n: int  # states
    share_outside: float  # share of the states that are outside the throws, chiefly because of this component
    low: float  # of the component, 5th percentile of the states outside because of it; NaN for EVERYTHING or no state
    high: float  # 95th percentile
    median: float  # median distance of all states from the throws; the same for all components
    far: float  # 95th percentile of the distance


def observed_states(designs: Designs, rollouts: Rollouts, *, n_settle: int, rng: Generator) -> Float32:
    """Return (n_states, 6) finite observations of links, a random choice, from rollouts with traces after settling."""
    assert rollouts.trace is not None
    trace = rollouts.trace.reshape(-1, *rollouts.trace.shape[-4:])[:, :, n_settle::_EVERY]
    length_scale = np.broadcast_to(designs.length_scale[None, :, None, :], trace.shape[:-1])
    _, y, angle, vx, vy, omega = np.moveaxis(trace, -1, 0)
    rows = observe({"length_scale": length_scale, "y": y, "cos": np.cos(angle), "vx": vx, "vy": vy, "omega": omega})
    rows = rows.reshape(-1, len(OBSERVATION))
    rows = rows[np.isfinite(rows).all(axis=1)]
    return rows[np.sort(rng.permutation(len(rows))[:_MOST_STATES])]


def deviations(robots: Floats) -> Float64:
    """Return the deviation of each component over (n_states, 6) observations of robots' links: (6,)."""
    scale: Float64 = np.maximum(robots.std(axis=0, dtype=np.float64), _LEAST_DEVIATION)
    return scale


def coverage(robots: Floats, throws: Floats, scale: Float64) -> tuple[CoverageRow, ...]:
    """Tabulate how far the states of robots are from those of throws: a row for all components, and one for each.

    Args:
        robots: (n_states, 6) finite observations of robots' links.
        throws: (n_transitions, 6) finite observations of thrown links.
        scale: (6,) unit of each component, from :func:`deviations`.

    Raises:
        ValueError: there are no states of one of them.
    """
    if min(len(robots), len(throws)) == 0:
        raise ValueError(f"{len(robots)} states of robots and {len(throws)} of throws, expected at least 1 of both")
    points, thrown = robots / scale, throws / scale
    distance, nearest = scipy.spatial.cKDTree(thrown).query(points)
    component = np.abs(points - thrown[nearest]).argmax(axis=1)
    outside = distance > 1
    n, median, far = len(robots), float(np.median(distance)), float(np.quantile(distance, 0.95))
    rows = [CoverageRow(EVERYTHING, n, float(outside.mean()), np.nan, np.nan, median, far)]
    for k, name in enumerate(OBSERVATION):
        because = outside & (component == k)
        low, high = np.quantile(robots[because, k], (0.05, 0.95)) if because.any() else (np.nan, np.nan)
        rows.append(CoverageRow(name, n, float(because.mean()), float(low), float(high), median, far))
    return tuple(rows)
