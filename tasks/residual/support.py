"""Support of a data set: how far states of robots' links are from the states of the throws.

Far away, all networks extrapolate. The space is that of the paper's observation, (a, y, cos θ, vx, vy, ω), and each
component is divided by its deviation over the states of robots.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from tasks.arrays import Float64, Floats, Int64

_LEAST_DEVIATION = 1e-6  # of a component that does not vary


@dataclass(frozen=True, eq=False)
class Distances:
    """Distance of each state from the throws, and the component that contributes most."""

    distance: Float64  # (n_states,) in deviations of the robots' states
    component: Int64  # (n_states,) index into OBSERVATION


def deviations(robots: Floats) -> Float64:
    """Return the deviation of each component over (n_states, 6) observations of robots' links: (6,)."""
    scale: Float64 = np.maximum(robots.std(axis=0, dtype=np.float64), _LEAST_DEVIATION)
    return scale


def distances(robots: Floats, throws: Floats, scale: Float64) -> Distances:
    """Measure how far the states of robots are from those of throws.

    Args:
        robots: (n_states, 6) finite observations of robots' links.
        throws: (n_transitions, 6) finite observations of thrown links.
        scale: (6,) unit of each component, from :func:`deviations`.

    Returns:
        Distance and component of each state.

    Raises:
        ValueError: there are no states of one of them.
    """
    if min(len(robots), len(throws)) == 0:
        raise ValueError(f"{len(robots)} states of robots and {len(throws)} of throws, expected at least 1 of both")
    points, thrown = robots / scale, throws / scale
    distance, nearest = scipy.spatial.cKDTree(thrown).query(points)
    return Distances(distance, np.abs(points - thrown[nearest]).argmax(axis=1))
