"""The order of what a network reads and writes; every other module takes it from here.

Paper: o = (a, y, cos θ, vx, vy, ω). The horizontal position is left out, because the world is the same along x.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tasks.arrays import Float32

STATE = ("x", "y", "angle", "vx", "vy", "omega")
"""A link's state [m, m, rad, m/s, m/s, rad/s], and the residual of one step, component by component."""

OBSERVATION = ("a", "y", "cos_angle", "vx", "vy", "omega")
"""What a network reads [m, m, 1, m/s, m/s, rad/s]."""

OBSERVED = ("length_scale", "y", "cos", "vx", "vy", "omega")
"""The same, by the names of :class:`tasks.world.LinkStates`."""

VELOCITIES = slice(3, 6)
"""The components of a residual that are applied; positions follow by integration."""


def observe(
    *,
    length_scale: npt.NDArray[np.floating],
    y: npt.NDArray[np.floating],
    cos: npt.NDArray[np.floating],
    vx: npt.NDArray[np.floating],
    vy: npt.NDArray[np.floating],
    omega: npt.NDArray[np.floating],
) -> Float32:
    """Put (...) arrays together as (..., 6) observations.

    A state that is not finite, or too large for float32, gives an observation that is not finite, and no error: a
    rollout that blows up is a status.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack((length_scale, y, cos, vx, vy, omega), axis=-1, dtype=np.float32, casting="same_kind")
