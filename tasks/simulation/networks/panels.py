"""Memory layout of a layer's weights: panels of TILE_UNITS outputs that follow one another.

A panel has (n_in, TILE_UNITS) numbers, so that a tile reads them in order. The last panel may be half as wide; outputs
are padded to half panels with weights of zero.
"""

import numpy as np

from tasks.arrays import Float32
from tasks.simulation.networks.tiles import TILE_UNITS


def padded(n: int) -> int:
    """Round a number of outputs up to whole panels, the last of which may be half a panel."""
    half = TILE_UNITS // 2
    return -(-n // half) * half


def to_panels(weight: Float32, n_in: int, n_out: int) -> Float32:
    """Cut weights into panels.

    The (n_networks, at most n_in, at most n_out) weights become (n_networks, n_in · n_out) panels; n_in and n_out
    include the padding, n_out to a multiple of half a panel.
    """
    n_networks = len(weight)
    filled = np.zeros((n_networks, n_in, n_out), np.float32)
    filled[:, : weight.shape[1], : weight.shape[2]] = weight
    panels = [filled[:, :, unit : unit + TILE_UNITS].reshape(n_networks, -1) for unit in range(0, n_out, TILE_UNITS)]
    return np.concatenate(panels, axis=1)


def from_panels(panels: Float32, n_in: int, n_out: int) -> Float32:
    """Join panels: the inverse of :func:`to_panels`."""
    n_networks = len(panels)
    cut = [panels[:, unit * n_in : (unit + TILE_UNITS) * n_in] for unit in range(0, n_out, TILE_UNITS)]
    return np.concatenate([panel.reshape(n_networks, n_in, -1) for panel in cut], axis=2)
