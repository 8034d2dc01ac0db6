"""The wetted form of networks, which know what is under water.

A link is a rectangle, the waterline is y = 0, and a fluid acts on what is below it. So a network of this form observes
how much of the link that is, and its outputs f act along the link's own axes on that much,

    Δv = A_s (f_t t + f_n n + b ŷ),    Δω = J f_ω,    t = (-sin θ, cos θ),    n = (cos θ, sin θ)

with A_s the submerged area [of 1 m²] and J the submerged share of the second moment of area. A dry link feels nothing,
whatever the weights. Training minimises the squared error of Δv and Δω in the link's axes,

    A_s² (f_t + b cos θ - Δv_t / A_s)² + A_s² (f_n + b sin θ - Δv_n / A_s)² + J² (f_ω - Δω / J)²

so that a trainer has to know two things of a row: weights of squared errors, and shares of b in the other outputs.

Symmetries are copies of the training set. Half a turn makes the same rectangle, and the mirror image of a motion is a
motion unless the fluid flows.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks.arrays import Float32, Floats
from tasks.simulation.free_links import FreeLinks
from tasks.simulation.networks.wetted import WETTED_FIELDS, changes_by, inputs_of
from tasks.world.medium import Medium
from tasks.world.physics import Physics

WETTED = (
    "submerged_area",
    "submerged_share",
    "cos_angle",
    "sin_angle",
    "along",
    "across",
    "omega",
    "y",
    "a",
    "speed",
    "abs_omega",
    "along_squared",
    "across_squared",
)
"""Inputs, among them A_s, J, the velocities along and across the link, and these times their magnitudes."""

N_WETTED_OUTPUTS = 4  # f_t, f_n, f_ω and b
_CHANGES = ("along", "across", "omega", "along")  # what outputs are measured by: b as f_t
_TURNED = {"cos_angle", "sin_angle", "along", "across", "along_squared", "across_squared"}  # change sign by half a turn
_MIRRORED = {"sin_angle", "across", "omega", "across_squared"}  # change sign in the mirror image
_CHANGED: tuple[set[str], ...] = (set(), _TURNED, _MIRRORED, _TURNED ^ _MIRRORED)
_DRY = 1e-6  # A_s and J below which a link counts as dry in training


def acts_above_water(medium: Medium, physics: Physics) -> bool:
    """Return whether a medium changes the motion of dry links, which no network of this form can learn."""
    links = FreeLinks(np.linspace(1.0, 3.0, 9), physics)
    dry = np.tile(np.array([0.0, 2.0, 0.0, 3.0, -2.0, 4.0], np.float32), (9, 1))
    dry[:, 2] = np.linspace(0.0, 6.0, 9)
    return bool((links.step(dry, medium) != links.step(dry, None)).any())


def wetted_inputs(quantities: Mapping[str, Floats]) -> Float32:
    """Return (..., n_inputs) inputs in the order of WETTED.

    Args:
        quantities: arrays of one shape (...) by the name of a field of :class:`tasks.world.LinkStates`.
    """
    return np.stack(inputs_of(*(np.asarray(quantities[name]).astype(np.float32) for name in WETTED_FIELDS)), axis=-1)


def in_world_axes(inputs: Float32, outputs: Float32) -> Float32:
    """Return (..., 3) changes of vx, vy and ω by (..., 4) outputs f_t, f_n, f_ω and b."""
    return np.stack(changes_by(tuple(np.moveaxis(outputs, -1, 0)), tuple(np.moveaxis(inputs[..., :4], -1, 0))), axis=-1)


def in_link_axes(inputs: Float32, change: Float32) -> Float32:
    """Return (n_rows, 4) changes, each of which has the unit of an output, by (n_rows, 3) changes of vx, vy and ω."""
    cos, sin = inputs[:, 2], inputs[:, 3]
    vx, vy, omega = change.T
    along = cos * vy - sin * vx
    return np.stack((along, cos * vx + sin * vy, omega, along), axis=-1)


def symmetric_copies(inputs: Float32, change: Float32, weights: Float32) -> tuple[Float32, Float32, Float32]:
    """Return 4 n_rows rows: the given ones, turned by half a turn, mirrored, and both."""
    copies, copied = (
        np.concatenate([rows * np.array([1 - 2 * (name in odd) for name in names], np.float32) for odd in _CHANGED])
        for rows, names in ((inputs, WETTED), (change, _CHANGES))
    )
    return copies, copied, np.tile(weights, (len(_CHANGED), 1))


def training_targets(
    inputs: Float32, change: Float32, weights: Float32, deviation: Float32
) -> tuple[Float32, Float32, Float32]:
    """Return (n_rows, 3) targets of the outputs, weights of their squared errors, and shares of b in the outputs.

    Args:
        inputs: (n_rows, n_inputs) inputs.
        change: (n_rows, 4) changes in the link's axes, in units of their deviations.
        weights: (n_rows, 3) weights of the squared errors of these changes.
        deviation: (4,) deviations of the changes.
    """
    part = inputs[:, [0, 0, 1]]
    wet = part > _DRY
    targets = np.divide(change[:, :3], part, out=np.zeros_like(part), where=wet)
    shares = np.pad(inputs[:, 2:4] * (deviation[3] / deviation[:2]), ((0, 0), (0, 1)))
    return targets, wet * weights * part * part, shares


def lifted(outputs: Any, targets: Any) -> Any:
    """Add b to the other outputs by its shares, in the last columns of the targets; plain networks have none.

    Args:
        outputs: (n_rows, 4) outputs of wetted networks, or (n_rows, 6) of plain ones; arrays of NumPy or torch.
        targets: (n_rows, n_columns) targets of :func:`training_targets`, side by side.
    """
    if outputs.shape[1] != N_WETTED_OUTPUTS:
        return outputs
    return outputs[:, :3] + outputs[:, 3:] * targets[:, 6:]
