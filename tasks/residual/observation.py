"""The order of a network's inputs and outputs.

Paper: o = (a, y, cos θ, vx, vy, ω). The horizontal position is left out, because the dynamics do not depend on x.
"""

import numpy as np

from tasks.arrays import Float32, Floats

STATE = ("x", "y", "angle", "vx", "vy", "omega")  # of a link; also of a step's residual [m, m, rad, m/s, m/s, rad/s]

OBSERVATION = ("a", "y", "cos_angle", "vx", "vy", "omega")  # components of a network's input [m, m, 1, m/s, m/s, rad/s]

OBSERVED = ("length_scale", "y", "cos", "vx", "vy", "omega")  # the same as fields of LinkStates

VELOCITIES = slice(3, 6)  # components of a residual that are applied; positions follow by integration


def observe(*, length_scale: Floats, y: Floats, cos: Floats, vx: Floats, vy: Floats, omega: Floats) -> Float32:
    """Return (..., 6) observations of link states.

    A state that is not finite, or too large for float32, gives an observation that is not finite and no error, because
    a diverged rollout is a status.

    Args:
        length_scale: (...) long axis [m].
        y: (...) height of the centre [m].
        cos: (...) cosine of the angle.
        vx: (...) horizontal velocity of the centre [m/s].
        vy: (...) vertical velocity of the centre [m/s].
        omega: (...) angular velocity [rad/s].
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack((length_scale, y, cos, vx, vy, omega), axis=-1, dtype=np.float32, casting="same_kind")
