"""The order of a network's inputs and outputs.

Paper: o = (a, y, cos θ, vx, vy, ω). The horizontal position is left out, because the dynamics do not depend on x.
Networks may observe sin θ too, which a medium that pushes a tilted plate sideways requires.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from tasks.arrays import Float32, Floats
from tasks.residual.wetted import WETTED, wetted_inputs

STATE = ("x", "y", "angle", "vx", "vy", "omega")  # of a link; also of a step's residual [m, m, rad, m/s, m/s, rad/s]

Observed = Literal["a", "y", "cos_angle", "vx", "vy", "omega", "sin_angle"]

OBSERVATION: tuple[Observed, ...] = ("a", "y", "cos_angle", "vx", "vy", "omega")
"""Components of a network's input in the paper [m, m, 1, m/s, m/s, rad/s]."""

INPUTS: Mapping[str, str] = {
    "a": "length_scale",
    "y": "y",
    "cos_angle": "cos",
    "vx": "vx",
    "vy": "vy",
    "omega": "omega",
    "sin_angle": "sin",
}
"""Every possible input of plain networks, and the field of LinkStates that it is."""

NUMBERED = tuple(dict.fromkeys((*INPUTS, "speed", "abs_omega", "abs_sin_angle", *WETTED)))
"""Inputs by the numbers that stored weights name them by; new ones are added at the end."""

VELOCITIES = slice(3, 6)  # components of a residual that are applied; positions follow by integration


def observe(quantities: Mapping[str, Floats], inputs: Sequence[str] = OBSERVATION) -> Float32:
    """Return (..., n_inputs) observations of link states.

    A state that is not finite, or too large for float32, gives an observation that is not finite and no error, because
    a diverged rollout is a status.

    Args:
        quantities: arrays of one shape (...) by the name of a field of :class:`tasks.world.LinkStates`.
        inputs: what to observe: any of INPUTS, or WETTED.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        if tuple(inputs) == WETTED:
            return wetted_inputs(quantities)
        return np.stack([np.asarray(quantities[INPUTS[name]]).astype(np.float32) for name in inputs], axis=-1)


def observe_states(length_scale: Floats, state: Floats, inputs: Sequence[str] = OBSERVATION) -> Float32:
    """Return (n, n_inputs) observations of links with (n,) long axes [m] and (n, 6) states in the order of STATE."""
    _, y, angle, vx, vy, omega = state.T
    quantities = {"length_scale": length_scale, "y": y, "cos": np.cos(angle), "sin": np.sin(angle)}
    return observe({**quantities, "vx": vx, "vy": vy, "omega": omega}, inputs)
