"""The current of a fluid, as throws show it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tasks.arrays import Float64
from tasks.world.slush import submerged_part

if TYPE_CHECKING:
    from tasks.residual.throws import Transitions


def current(transitions: Transitions) -> tuple[float, float]:
    """Estimate the flow of a fluid along x from throws: the velocity c at which it slows nothing down.

    Drag along x is taken as -A_s (k_1 + k_2 |u|) u_x with u = v - c.

    Returns:
        c and its standard deviation, by the jackknife over ten groups of throws [m/s].
    """
    from scipy.optimize import least_squares  # takes long to import

    _, y, angle, vx, vy, _ = transitions.state.T.astype(np.float64)
    area, _ = submerged_part(transitions.length_scale, y, np.cos(angle), np.sin(angle))
    change = transitions.residual[:, 3]
    group = np.unique(transitions.throw, return_inverse=True)[1] % 10

    def flow_without(left_out: int) -> float:
        own = group != left_out

        def off(c_and_k: Float64) -> Float64:
            c, k_1, k_2 = c_and_k
            u = vx[own] - c
            missed: Float64 = change[own] + area[own] * (k_1 + k_2 * np.hypot(u, vy[own])) * u
            return missed

        return float(least_squares(off, (0.0, 0.0, 0.1)).x[0])

    without = np.array([flow_without(k) for k in range(10)])
    return flow_without(-1), float(np.sqrt(0.9 * np.square(without - without.mean()).sum()))


def is_current(flow: float, sd: float) -> bool:
    """Return whether an estimate of a flow and its standard deviation [m/s] show that a fluid is not at rest."""
    return abs(flow) > max(4 * sd, 0.05)
