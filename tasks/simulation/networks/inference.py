"""Inference of many small multilayer perceptrons on a CPU, near the core's peak.

Samples are in lanes, N_LANES per vector, like the robots of the engine. A tile of the product of samples and weights
stays in the vector registers: TILE_VECTORS vectors of samples by TILE_UNITS outputs, or half as many at the end of a
layer. It is summed over the inputs in their order by fused multiply-adds. So the result of a sample depends neither on
the other samples, nor on their number, nor on the machine. The samples of a tile pass through all layers before those
of the next, and stay in the cache.
"""

# mypy: warn-return-any=False

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tasks.arrays import Float32, Int64
from tasks.compiled import compiled
from tasks.simd.lanes import aligned
from tasks.simulation.networks.panels import padded, to_panels
from tasks.simulation.networks.tiles import (
    N_LANES,
    NUMBER,
    TILE_ROWS,
    TILE_UNITS,
    TILE_VECTORS,
    Pointer,
    multiply_half_tile,
    multiply_tile,
)


def _forward(layers: Int64, sizes: Int64, n_vectors: int, x: Pointer, out: Pointer, between: Pointer) -> None:
    """Evaluate the networks of all members.

    Args:
        layers: (n_members, n_layers, 2) addresses of panels and biases.
        sizes: (n_layers + 1,) inputs of each layer and outputs of the last, padded.
        n_vectors: vectors of samples per member, a multiple of TILE_VECTORS.
        x: (n_members, n_vectors, sizes[0], N_LANES) inputs.
        out: (n_members, n_vectors, sizes[-1], N_LANES) outputs.
        between: (2, TILE_VECTORS, widest layer, N_LANES) scratch for the values between two layers.
    """
    n_members, n_layers, _ = layers.shape
    vector = NUMBER * N_LANES
    widest = sizes[1:].max()
    for member in range(n_members):
        for first in range(member * n_vectors, (member + 1) * n_vectors, TILE_VECTORS):
            rows = x + vector * first * sizes[0]
            for layer in range(n_layers):
                n_in, n_out = sizes[layer], sizes[layer + 1]
                last = layer == n_layers - 1
                inner = between + vector * (layer % 2) * TILE_VECTORS * widest
                result = out + vector * first * n_out if last else inner
                for unit in range(0, n_out, TILE_UNITS):
                    weight = layers[member, layer, 0] + NUMBER * unit * n_in
                    bias = layers[member, layer, 1] + NUMBER * unit
                    if n_out - unit >= TILE_UNITS:
                        multiply_tile(rows, weight, bias, result + vector * unit, n_in, n_out, not last)
                    else:
                        multiply_half_tile(rows, weight, bias, result + vector * unit, n_in, n_out, not last)
                rows = result


run_networks = compiled(_forward, seconds=1)


class PackedNetworks:
    """Networks of one shape, with their weights in the kernel's memory layout."""

    def __init__(
        self,
        weights: Sequence[Float32],
        biases: Sequence[Float32],
        read: Callable[..., Any] | None = None,
        act: Callable[..., Any] | None = None,
        reads_kicks: bool = False,
    ) -> None:
        """Pack the weights of networks with ReLU after every layer but the last.

        Args:
            weights: (n_members, n_in, n_out) of each layer.
            biases: (n_members, n_out) of each layer.
            read: formula of the inputs, by the links' :class:`tasks.world.LinkStates`; None if no robots are coupled.
            act: formula of the changes of vx, vy and ω, by the outputs and the inputs.
            reads_kicks: whether ``read`` reads the links' kicks.
        """
        self._source = tuple(weights), tuple(biases), read, act, reads_kicks
        self.read, self.act, self.reads_kicks = read, act, reads_kicks
        self.n_members, self.n_in, _ = weights[0].shape
        self.n_out = weights[-1].shape[2]
        sizes = [self.n_in, *(padded(weight.shape[2]) for weight in weights)]
        self.sizes = np.array(sizes, np.int64)
        self._panels = [
            to_panels(weight, n_in, n_out) for weight, n_in, n_out in zip(weights, sizes, sizes[1:], strict=False)
        ]
        self._biases = [np.zeros((self.n_members, n_out), np.float32) for n_out in sizes[1:]]
        for packed, bias in zip(self._biases, biases, strict=True):
            packed[:, : bias.shape[1]] = bias
        self.layers = np.array(
            [
                [
                    (panels[member].ctypes.data, bias[member].ctypes.data)
                    for panels, bias in zip(self._panels, self._biases, strict=True)
                ]
                for member in range(self.n_members)
            ],
            np.int64,
        )
        self.between = aligned((2, TILE_VECTORS, max(sizes[1:]), N_LANES))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the weights alone: addresses and alignment hold in one process only."""
        return PackedNetworks, self._source

    def forward(self, rows: Float32) -> Float32:
        """Evaluate the networks: (n_members, n_rows, n_in) to (n_members, n_rows, n_out)."""
        n_rows = rows.shape[1]
        x, out = self.allocate(n_rows)
        filled = np.zeros((self.n_members, x.shape[1] * N_LANES, self.n_in), np.float32)
        filled[:, :n_rows] = rows
        x[:] = filled.reshape(self.n_members, -1, N_LANES, self.n_in).swapaxes(2, 3)
        run_networks(self.layers, self.sizes, x.shape[1], x.ctypes.data, out.ctypes.data, self.between.ctypes.data)
        return out.swapaxes(2, 3).reshape(self.n_members, -1, out.shape[2])[:, :n_rows, : self.n_out]

    def allocate(self, n_rows: int) -> tuple[Float32, Float32]:
        """Allocate inputs (n_members, n_vectors, n_in, N_LANES) and padded outputs for n_rows samples per member."""
        n_vectors = -(-n_rows // TILE_ROWS) * TILE_VECTORS
        shape = self.n_members, n_vectors
        return aligned((*shape, self.n_in, N_LANES)), aligned((*shape, int(self.sizes[-1]), N_LANES))
